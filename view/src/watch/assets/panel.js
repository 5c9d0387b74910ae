// Numbers, buttons, the live image and the trends beside the 3-D view.

import { COLOURS } from "../../report/assets/colours.js";
import { figures, quantile } from "../../report/assets/numbers.js";
import { Drawing, byId, contextOf, data, element, paintBar } from "../../report/assets/page.js";
import { nearLines } from "./near.js";
import { scaleBreakText } from "./warnings.js";
/** @import { LivePictureMessage } from "./decode.js" */
/** @import { Feed } from "./feed.js" */
/** @import { Neighbourhood, ScaleBreaks, Status } from "./types.js" */

/** How long trends reach back, milliseconds. */
const TREND_SPAN = 60000;
/** @type {Record<string, string>} */
const STATE_NAMES = { preparing: "preparing", starting: "starting", tracking: "tracking", lost: "lost", done: "finished", saved: "saved map", collecting: "collecting" };

/** @param {number} value */
const whole = (value) => Math.round(value).toLocaleString("en");
/** @param {number} value */
const points = (value) => (value < 1e4 ? whole(value) : value < 1e6 ? `${(value / 1e3).toFixed(0)} k` : `${(value / 1e6).toFixed(2)} M`);
/** @param {number | null} value */
const mebibytes = (value) => (value ? `${whole(value / 1048576)} MiB` : "–");

/** A number by its label and its text of a status. @typedef {[label: string, text: (status: Status) => string | null]} NumberOf */

/** Numbers in the head: `[label, text of a status]`; `null` leaves one out. @type {Record<string, NumberOf>} */
const TILES = {
  frame: ["frame", (s) => (s.frames ? `${whole(s.frame)} / ${whole(s.frames)}` : whole(s.frame))],
  fps: ["frames/s", (s) => s.frames_per_s.toFixed(1)],
  latency: ["latency", (s) => (s.latency_ms === null ? null : `${s.latency_ms.toFixed(0)} ms`)],
  keyframes: ["keyframes", (s) => whole(s.keyframes)],
  points: ["points", (s) => points(s.points)],
  memory: ["memory", (s) => mebibytes(s.memory_bytes)],
  dropped: ["dropped", (s) => whole(s.dropped)],
};

/** @type {Record<string, NumberOf>} */
const FACTS = {
  matched: ["Points matched", (s) => whole(s.matched)],
  rmse: ["Residual, grey levels", (s) => figures(s.rmse ?? NaN)],
  loops: ["Loops closed", (s) => whole(s.loops)],
  losses: ["Times lost", (s) => whole(s.losses)],
  cpu: ["CPU, cores", (s) => (s.cpu === null ? null : s.cpu.toFixed(2))],
  folder: ["Results", (s) => s.folder],
};

/** What of these is shown of what is no run. @type {Record<string, { tiles: string[], facts: string[] }>} */
const SHOWN = {
  live: { tiles: Object.keys(TILES), facts: Object.keys(FACTS) },
  service: { tiles: Object.keys(TILES), facts: Object.keys(FACTS) },
  maps: { tiles: ["keyframes", "points"], facts: [] },
  station: { tiles: ["keyframes", "points", "memory"], facts: ["folder"] },
};

/** @param {Record<string, NumberOf>} all @param {string[]} names */
const chosen = (all, names) => Object.fromEntries(names.map((name) => [name, all[name]]));

/** A list of named numbers. */
class Numbers {
  /** @param {HTMLElement} list @param {Record<string, NumberOf>} shown */
  constructor(list, shown) {
    this.cells = Object.entries(shown).map(([name, [label, text]]) => {
      const value = element("dd", "–");
      value.id = `number-${name}`;
      const parts = [element("dt", label), value];
      const row = list.classList.contains("tiles") ? element("div", null, ...parts) : null;
      list.append(...(row ? [row] : parts));
      return { value, text, parts: row ? [row] : parts };
    });
  }

  /** @param {Status} status */
  show(status) {
    for (const { value, text, parts } of this.cells) {
      const now = text(status);
      parts.forEach((part) => (part.hidden = now === null));
      if (now !== null && value.textContent !== now) value.textContent = now;
    }
  }
}

/** A small curve of the last minute. */
class Trend extends Drawing {
  /** @param {HTMLCanvasElement} canvas @param {string} colour @param {number} top */
  constructor(canvas, colour, top) {
    super(canvas);
    this.colour = colour;
    this.top = top;
    /** Moments and values. @type {[number, number][]} */
    this.values = [];
  }

  /** @param {number} value */
  push(value) {
    const now = performance.now();
    this.values.push([now, value]);
    while (this.values.length && now - this.values[0][0] > TREND_SPAN) this.values.shift();
    this.redraw();
  }

  draw() {
    const { canvas, values } = this, ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (values.length < 2) return;
    const context = contextOf(canvas), now = values[values.length - 1][0];
    // A single slow frame may leave the picture, so that the others are seen.
    const top = this.top || quantile(values.map(([, v]) => v).sort((a, b) => a - b), 0.97) * 1.4 || 1;
    const span = Math.min(TREND_SPAN, Math.max(8000, now - values[0][0]));
    context.scale(ratio, ratio);
    /** @param {[number, number]} moment @returns {[number, number]} */
    const place = ([at, v]) => [width - ((now - at) / span) * width, height - 2 - Math.min(1, v / top) * (height - 5)];
    context.beginPath();
    values.forEach((value, i) => context[i ? "lineTo" : "moveTo"](...place(value)));
    const colour = getComputedStyle(document.documentElement).getPropertyValue(this.colour).trim();
    context.strokeStyle = colour;
    context.lineWidth = 1.6;
    context.stroke();
    context.lineTo(width, height);
    context.lineTo(place(values[0])[0], height);
    context.globalAlpha = 0.16;
    context.fillStyle = colour;
    context.fill();
  }
}

/** The live image, its depths in colour over it. */
class LivePicture extends Drawing {
  /** The newest. @type {LivePictureMessage | null} */
  last = null;
  /** What it is drawn in. @type {ImageData | null} */
  image = null;

  constructor() {
    super(byId("picture"));
    this.grey = Uint32Array.from({ length: 256 }, (_, v) => 0xff000000 | (v * 0x010101));
    const { depth } = COLOURS;
    this.colours = Uint32Array.from({ length: 256 }, (_, v) => (0xff000000 | (depth[v * 3 + 2] << 16) | (depth[v * 3 + 1] << 8) | depth[v * 3]) >>> 0);
    paintBar(byId("depth-bar"), depth);
    byId("show-depth").addEventListener("input", () => this.redraw());
  }

  /** @param {LivePictureMessage} picture */
  show(picture) {
    this.last = picture;
    this.redraw();
  }

  draw() {
    const { canvas, last: picture } = this;
    if (!picture) return;
    const { width, height } = picture;
    if (canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width, height];
      this.image = null;
    }
    const context = contextOf(canvas);
    this.image = this.image || context.createImageData(width, height);
    const out = new Uint32Array(this.image.data.buffer), { grey } = this;
    for (let i = 0; i < out.length; i++) out[i] = grey[picture.grey[i]];
    if (byId("show-depth").checked) this.overlay(out, picture);
    context.putImageData(this.image, 0, 0);
    byId("picture-title").textContent = `Frame ${whole(picture.frame)}`;
    const [far, near] = picture.range;
    byId("far").textContent = picture.count ? `${figures(1 / near)} near` : "";
    byId("near").textContent = picture.count ? `far ${figures(1 / far)}` : "";
    document.documentElement.dataset.overlaid = String(picture.count);
  }

  /** Dots of two by two pixels. @param {Uint32Array} out @param {LivePictureMessage} picture */
  overlay(out, { width, height, pixels, codes, count }) {
    for (let i = 0; i < count; i++) {
      const x = Math.min(pixels[i * 2], width - 2), y = Math.min(pixels[i * 2 + 1], height - 2), at = y * width + x;
      out[at] = out[at + 1] = out[at + width] = out[at + width + 1] = this.colours[codes[i]];
    }
  }
}

/** Everything beside the 3-D view. */
export class Panel {
  constructor() {
    const { tiles, facts } = SHOWN[data.mode];
    this.tiles = new Numbers(byId("tiles"), chosen(TILES, tiles));
    this.facts = new Numbers(byId("facts"), chosen(FACTS, facts));
    this.share = new Trend(byId("trend-share"), "--plot-2", 1);
    this.ms = new Trend(byId("trend-ms"), "--plot-1", 0);
    this.picture = new LivePicture();
    /** @type {Status | null} */
    this.status = null;
    /** What was last shown of who is near. */
    this.nearSaid = "";
  }

  /** Sends what its buttons say. @param {Feed} feed */
  obey(feed) {
    if (data.mode !== "live") return;
    const toggle = () => feed.command(this.status && this.status.paused ? "resume" : "pause");
    byId("pause").addEventListener("click", toggle);
    byId("save").addEventListener("click", () => feed.command("save"));
    const ask = byId("ask-restart");
    byId("restart").addEventListener("click", () => ask.showModal());
    byId("restart-yes").addEventListener("click", () => {
      ask.close();
      feed.command("restart");
    });
    byId("restart-no").addEventListener("click", () => ask.close());
    byId("record").addEventListener("click", () => this.status && feed.command("record", !this.status.recording));
    // Only while the focus is in here: who dictates, or types for something else, stops no robot by a letter.
    byId("side").addEventListener("keydown", (event) => {
      if (event.key === "p" && !event.ctrlKey && !event.metaKey && !event.altKey && !byId("pause").disabled) toggle();
    });
  }

  /** Shows where the run stands. @param {Status} status */
  show(status) {
    const before = this.status;
    this.status = status;
    const state = byId("state"), paused = status.paused && status.state !== "done";
    state.className = `state ${paused ? "paused" : status.state}`;
    state.textContent = paused ? "paused" : STATE_NAMES[status.state] || status.state;
    this.tiles.show(status);
    this.facts.show(status);
    byId("share").textContent = `${Math.round(status.inlier_share * 100)} %`;
    byId("ms").textContent = `${status.ms.toFixed(0)} ms`;
    if (status.state !== "preparing" && (!before || before.frame !== status.frame)) {
      this.share.push(status.inlier_share);
      this.ms.push(status.ms);
    }
    byId("pause").textContent = status.paused ? "Resume" : "Pause";
    byId("record").textContent = status.recording ? "Stop recording" : "Record";
    byId("record").setAttribute("aria-pressed", String(Boolean(status.recording)));
    const reason = status.reason && status.state !== "tracking" ? `No pose: ${status.reason}. ` : "";
    // A reader of the screen reads it out: only what is new.
    if (byId("note").textContent !== reason + status.note) byId("note").textContent = reason + status.note;
    this.near(status.neighbourhood);
    this.scaleBreak(status.scale_break);
    this.enable(status.state !== "done" && status.state !== "preparing");
    if (status.state === "done") this.say(status.note, false);
    if (status.state === "done" && status.report) this.offerReport();
  }

  /** Shows who is near, of an agent that pairs. @param {Neighbourhood | null} neighbourhood */
  near(neighbourhood) {
    byId("near-by").hidden = !neighbourhood;
    if (!neighbourhood) return;
    const lines = nearLines(neighbourhood), said = JSON.stringify(lines);
    if (said === this.nearSaid) return;
    this.nearSaid = said;
    byId("near-list").replaceChildren(...lines.map(({ kind, text }) => Object.assign(element("li", null, element("span", text)), { className: kind })));
  }

  /** Says where the scale was not carried on; it stays, for what comes after is in another unit. @param {ScaleBreaks | null} found */
  scaleBreak(found) {
    const banner = byId("scale-break"), text = found ? scaleBreakText(found) : "";
    banner.hidden = !found;
    if (banner.textContent !== text) banner.textContent = text;
  }

  /** @param {boolean} on */
  enable(on) {
    [byId("pause"), byId("save"), byId("restart"), byId("record")].forEach((button) => (button.disabled = !on));
    if (on && this.status && this.status.recording === null) {
      byId("record").disabled = true;
      byId("record").title = "Nothing here records: start with a recorder";
    }
  }

  /** Says something across the page. @param {string} text @param {boolean} bad */
  say(text, bad) {
    const banner = byId("banner");
    banner.hidden = !text;
    banner.textContent = text;
    banner.classList.toggle("bad", bad);
  }

  /** Links to the report, once it is written. */
  offerReport() {
    const link = Object.assign(element("a", "Open the report"), { id: "report", href: "report.html" });
    byId("banner").append(". ", link);
  }

  /** The connection came or went. @param {boolean} on */
  link(on) {
    document.documentElement.dataset.link = on ? "open" : "closed";
    const done = this.status && this.status.state === "done";
    if (done) return;
    this.enable(on);
    if (!on) Object.assign(byId("state"), { className: "state lost", textContent: "cut off" });
    const lives = data.mode !== "maps";
    this.say(on ? "" : lives ? "The program does not answer: it has ended, or this machine is cut off. Trying again …" : "The program has ended. What was loaded can still be looked at.", !on && lives);
  }
}
