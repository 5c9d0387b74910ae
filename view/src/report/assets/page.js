// The page's data, colours, and what is drawn on it.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);

/** Bytes of a base64 text, as the given typed array (little-endian). */
function unpack(text, Type) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return new Type(bytes.buffer);
}

/** An element with text and children; text is never read as HTML. */
function element(tag, text, ...children) {
  const node = document.createElement(tag);
  if (text !== undefined && text !== null) node.textContent = text;
  node.append(...children);
  return node;
}

/** A number with about three figures. */
function figures(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1000) return Math.round(value).toLocaleString("en");
  if (size >= 100) return value.toFixed(0);
  if (size >= 10) return value.toFixed(1);
  if (size >= 1 || size === 0) return value.toFixed(2);
  return value.toPrecision(2);
}

/** The `share` quantile of sorted numbers. */
const quantile = (sorted, share) => sorted[Math.round((sorted.length - 1) * share)];

// Colour maps as stops at equal distances: dark to light for height and confidence, a hue ring for depth.
const COLOUR_STOPS = {
  ordered: ["#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"],
  depth: ["#7a5cf5", "#3d82f7", "#19b5e0", "#2fd8a0", "#8fe04a", "#e9d835", "#fb9428", "#ec4527"],
};

/** 256 colours, `[r, g, b]` bytes in a row, interpolated between stops. */
function colourTable(stops) {
  const parsed = stops.map((s) => [1, 3, 5].map((i) => parseInt(s.slice(i, i + 2), 16)));
  const table = new Uint8Array(256 * 3);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (parsed.length - 1);
    const k = Math.min(Math.floor(at), parsed.length - 2);
    for (let c = 0; c < 3; c++) table[i * 3 + c] = Math.round(parsed[k][c] + (at - k) * (parsed[k + 1][c] - parsed[k][c]));
  }
  return table;
}
const COLOURS = { ordered: colourTable(COLOUR_STOPS.ordered), depth: colourTable(COLOUR_STOPS.depth) };

/** Paints a table of colours along a canvas of 256 × 1 pixels. */
function paintBar(canvas, table) {
  const context = canvas.getContext("2d");
  const image = context.createImageData(256, 1);
  for (let i = 0; i < 256; i++) {
    image.data.set(table.subarray(i * 3, i * 3 + 3), i * 4);
    image.data[i * 4 + 3] = 255;
  }
  context.putImageData(image, 0, 0);
}

/** Something drawn on a canvas, at most once for each image on the screen. */
class Drawing {
  constructor(canvas) {
    this.canvas = canvas;
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  /** Asks for a new image with the next animation frame. */
  redraw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.draw();
    });
  }
}
