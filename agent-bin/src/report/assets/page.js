// The page's data, colours and shared state.

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

const agents = data.scene.agents;

const keyframes = {
  count: data.scene.keyframes.count,
  agent: unpack(data.scene.keyframes.agent, Uint32Array),
  id: unpack(data.scene.keyframes.id, Uint32Array),
  frame: unpack(data.scene.keyframes.frame, Float64Array),
  timestamp: unpack(data.scene.keyframes.timestamp, Float64Array),
  pose: unpack(data.scene.keyframes.pose, Float32Array),
  depths: unpack(data.scene.keyframes.depths, Uint32Array),
  /** The camera that took a keyframe. */
  camera(index) {
    return agents[this.agent[index]].camera;
  },
  /** Axis 0–2 or centre 3 of a keyframe. */
  column(index, column) {
    return Array.from(this.pose.subarray(index * 12 + column * 3, index * 12 + column * 3 + 3));
  },
  /** The keyframe whose frame lies nearest; −1 without keyframes. */
  nearest(frame) {
    let best = -1;
    for (let i = 0; i < this.count; i++) {
      if (best < 0 || Math.abs(this.frame[i] - frame) < Math.abs(this.frame[best] - frame)) best = i;
    }
    return best;
  },
};

const trajectory = {
  count: data.scene.trajectory.count,
  agent: unpack(data.scene.trajectory.agent, Uint32Array),
  frame: unpack(data.scene.trajectory.frame, Float64Array),
  timestamp: unpack(data.scene.trajectory.timestamp, Float64Array),
  position: unpack(data.scene.trajectory.position, Float32Array),
};

/** First and end index of each agent's run in an ascending array of agents. */
function spans(owners) {
  const found = agents.map(() => [0, 0]);
  owners.forEach((agent, i) => {
    if (i === 0 || owners[i - 1] !== agent) found[agent][0] = i;
    found[agent][1] = i + 1;
  });
  return found;
}

/** An agent's colour, as CSS reads it. */
const agentColour = (agent) => `rgb(${agents[agent].color.join(" ")})`;

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

/** What is selected and pointed at (a place on the plots' x axis); parts of the page listen for changes. */
const shared = {
  selected: -1,
  hoverAt: null,
  listeners: [],
  onChange(listener) {
    this.listeners.push(listener);
  },
  select(keyframe) {
    if (keyframe === this.selected || keyframe < 0 || keyframe >= keyframes.count) return;
    this.selected = keyframe;
    this.listeners.forEach((f) => f("selected"));
  },
  hover(at) {
    if (at === this.hoverAt) return;
    this.hoverAt = at;
    this.listeners.forEach((f) => f("hover"));
  },
};

/** The image of each keyframe that has one, for the 3-D view and elsewhere. */
const pictureImages = new Map();

/** The image of a picture; its text is given up. */
function takeImage(picture) {
  const image = new Image();
  image["src"] = "data:image/jpeg;base64," + picture.jpeg;
  picture.jpeg = null;
  if (picture.keyframe !== null) pictureImages.set(picture.keyframe, image);
  return image;
}
