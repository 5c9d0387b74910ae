// Numbers: packed ones, quantiles, and as people read them.

/** Bytes of a base64 text, as the given typed array (little-endian). @template T @param {string} text @param {new (bytes: ArrayBuffer) => T} Type @returns {T} */
export function unpack(text, Type) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return new Type(bytes.buffer);
}

/** A number with about three figures; a dash for none. @param {number | null} value */
export function figures(value) {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1000) return Math.round(value).toLocaleString("en");
  if (size >= 100) return value.toFixed(0);
  if (size >= 10) return value.toFixed(1);
  if (size >= 1 || size === 0) return value.toFixed(2);
  return value.toPrecision(2);
}

/** @param {string} text */
const milliseconds = (text) => `${figures(Number(text) * 1e3)} ms`;
/** What maps keep of the sensor, in words of people. @type {Record<string, [label: string, words: (text: string) => string]>} */
const SENSOR = {
  lens: ["distortion beyond the calibration", (text) => text.replace(/-?\d+\.\d+(e-?\d+)?/g, (number) => figures(Number(number)))],
  "readout columns": ["rolling shutter, first to last column", milliseconds],
  "readout rows": ["rolling shutter, first to last row", milliseconds],
};

/** An entry of a map's provenance, as people read it. @param {[string, string]} entry @returns {[string, string]} */
export function provenanceInWords([key, text]) {
  const [label, words] = SENSOR[key] ?? [key, (same) => same];
  return [label, words(text)];
}

/** The `share` quantile of sorted numbers. @param {ArrayLike<number>} sorted @param {number} share */
export const quantile = (sorted, share) => sorted[Math.round((sorted.length - 1) * share)];

/** Spans of equal length that cover so many values, `most` or one for each. @param {number} count @returns {[number, number][]} */
export function parts(count, most = 24) {
  const number = Math.min(count, most);
  const begin = (/** @type {number} */ i) => Math.floor((i * count) / number);
  return Array.from({ length: number }, (_, i) => [begin(i), begin(i + 1)]);
}

/** The median of the finite numbers in a span; NaN where there are none. @param {Float32Array} values @param {[number, number]} span */
export function medianOf(values, [first, end]) {
  const sorted = Array.from(values.slice(first, end)).filter(Number.isFinite).sort((a, b) => a - b);
  return sorted.length ? quantile(sorted, 0.5) : NaN;
}

/** The largest of 1, 2, 5 · 10ⁿ that is at most `value`. @param {number} value */
export function roundStep(value) {
  const power = Math.pow(10, Math.floor(Math.log10(value)));
  return [5, 2, 1].map((m) => m * power).find((v) => v <= value * 1.0001) || power;
}
