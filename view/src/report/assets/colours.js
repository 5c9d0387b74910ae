// Colour maps.

// Colour maps as stops at equal distances: dark to light for height and confidence, a hue ring for depth.
const COLOUR_STOPS = {
  ordered: ["#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"],
  depth: ["#7a5cf5", "#3d82f7", "#19b5e0", "#2fd8a0", "#8fe04a", "#e9d835", "#fb9428", "#ec4527"],
};

/** 256 colours, `[r, g, b]` bytes in a row, interpolated between stops. @param {string[]} stops */
export function colourTable(stops) {
  const parsed = stops.map((s) => [1, 3, 5].map((i) => parseInt(s.slice(i, i + 2), 16)));
  const table = new Uint8Array(256 * 3);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (parsed.length - 1);
    const k = Math.min(Math.floor(at), parsed.length - 2);
    for (let c = 0; c < 3; c++) table[i * 3 + c] = Math.round(parsed[k][c] + (at - k) * (parsed[k + 1][c] - parsed[k][c]));
  }
  return table;
}
/** The tables by their use. */
export const COLOURS = { ordered: colourTable(COLOUR_STOPS.ordered), depth: colourTable(COLOUR_STOPS.depth) };
