// Messages of the WebSocket as `web/encode.rs` writes them: little-endian words, of which the first is the kind.

/** Words of a keyframe, of a step of the trajectory, and before a chunk's points and a picture's pixels. */
const WORDS = { keyframe: 16, step: 11, chunk: 12, picture: 7 };

/**
 * A keyframe in the world: the axes of its camera and its centre, and the world's units in one of its own.
 * @typedef {{ id: number, agent: number, frame: number, scale: number, pose: Float32Array }} PlacedKeyframe
 */
/**
 * Steps of the trajectory from one on. Of each the agent, the frame, seconds, the centre (3) and the rotation as a
 * quaternion x, y, z, w (4).
 * @typedef {{ from: number, count: number, agent: Uint32Array, frame: Float64Array, timestamp: Float64Array,
 *   position: Float32Array, rotation: Float32Array }} Steps
 */
/**
 * Points of a keyframe: pixel and inverse depth as shares of 65535 (`words`, 4 a point), intensity and code of the
 * relative σ (the last two of each 8 `bytes`); red, green and blue of each, where the image has colours.
 * @typedef {{ id: number, agent: number, count: number, camera: { width: number, height: number, fx: number, fy: number,
 *   cx: number, cy: number }, depth: [number, number], bytes: Uint8Array, words: Uint16Array, colours: Uint8Array | null }} Chunk
 */
/**
 * An image with depths over it: pixels as x and y, codes of their colours, the range of inverse depth.
 * @typedef {{ frame: number, width: number, height: number, count: number, range: [number, number], pixels: Uint16Array,
 *   codes: Uint8Array, grey: Uint8Array }} LivePictureMessage
 */

/** @param {Uint32Array} words @param {Float32Array} floats @returns {PlacedKeyframe[]} */
function decodeKeyframes(words, floats) {
  return Array.from({ length: words[1] }, (_, i) => {
    const at = 2 + i * WORDS.keyframe;
    return { id: words[at], agent: words[at + 1], frame: words[at + 2], scale: floats[at + 3], pose: floats.slice(at + 4, at + 16) };
  });
}

/** @param {Uint32Array} words @param {Float32Array} floats @returns {Steps} */
function decodeSteps(words, floats) {
  const [, from, count] = words, view = new DataView(words.buffer);
  const steps = {
    from, count, agent: new Uint32Array(count), frame: new Float64Array(count), timestamp: new Float64Array(count),
    position: new Float32Array(count * 3), rotation: new Float32Array(count * 4),
  };
  for (let i = 0, at = 3; i < count; i++, at += WORDS.step) {
    steps.agent[i] = words[at];
    steps.frame[i] = words[at + 1];
    steps.timestamp[i] = view.getFloat64((at + 2) * 4, true);
    steps.position.set(floats.subarray(at + 4, at + 7), i * 3);
    steps.rotation.set(floats.subarray(at + 7, at + 11), i * 4);
  }
  return steps;
}

/** @param {Uint32Array} words @param {Float32Array} floats @returns {Chunk} */
function decodeChunk(words, floats) {
  const [, id, agent, count, width, height] = words;
  const [fx, fy, cx, cy, low, high] = floats.subarray(6, 12);
  const start = WORDS.chunk * 4, end = start + count * 8;
  return {
    id, agent, count, camera: { width, height, fx, fy, cx, cy }, depth: [low, high],
    bytes: new Uint8Array(words.buffer, start, count * 8), words: new Uint16Array(words.buffer, start, count * 4),
    colours: words.buffer.byteLength >= end + count * 3 && count ? new Uint8Array(words.buffer, end, count * 3) : null,
  };
}

/** @param {Uint32Array} words @param {Float32Array} floats @returns {LivePictureMessage} */
function decodePicture(words, floats) {
  const [, frame, width, height, count] = words, { buffer } = words, start = WORDS.picture * 4;
  return {
    frame, width, height, count, range: [floats[5], floats[6]],
    pixels: new Uint16Array(buffer, start, count * 2), codes: new Uint8Array(buffer, start + count * 4, count),
    grey: new Uint8Array(buffer, start + count * 5, width * height),
  };
}

/** `from, to, kind` of every edge. @param {Uint32Array} words */
const decodeEdges = (words) => words.slice(2, 2 + words[1] * 3);

/**
 * What each kind of message is called, the bytes that one of its counts needs, and how it is read.
 * @type {([string, (words: Uint32Array) => number, (words: Uint32Array, floats: Float32Array) => any] | undefined)[]}
 */
const KINDS = [
  undefined,
  ["keyframes", (words) => 8 + words[1] * WORDS.keyframe * 4, decodeKeyframes],
  ["trajectory", (words) => 12 + words[2] * WORDS.step * 4, decodeSteps],
  ["chunk", (words) => WORDS.chunk * 4 + words[3] * 8, decodeChunk],
  ["picture", (words) => WORDS.picture * 4 + words[4] * 5 + words[2] * words[3], decodePicture],
  ["edges", (words) => 8 + words[1] * 12, decodeEdges],
];

/**
 * What a binary message says; `null` for one of an unknown kind or that is shorter than it says.
 * @param {ArrayBuffer} buffer
 * @returns {{ kind: string, value: any } | null}
 */
export function decode(buffer) {
  const words = new Uint32Array(buffer, 0, buffer.byteLength >> 2), floats = new Float32Array(buffer, 0, buffer.byteLength >> 2);
  const found = words.length > 1 ? KINDS[words[0]] : undefined;
  if (!found) return null;
  const [kind, size, read] = found;
  // Comparing with what is missing gives NaN, which is no size either.
  return size(words) <= buffer.byteLength ? { kind, value: read(words, floats) } : null;
}
