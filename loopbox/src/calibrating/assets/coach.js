// The page of a calibration that is going on.

import { Drawing, byId, contextOf, data, element } from "../../../../view/src/report/assets/page.js";
import { Feed } from "../../../../view/src/watch/assets/feed.js";
/** @import { LivePictureMessage } from "../../../../view/src/watch/assets/decode.js" */
/** @import { Handlers } from "../../../../view/src/watch/assets/types.js" */
/** @import { CoachStatus } from "./types.js" */

/** @type {Record<string, string>} */
const STATE_NAMES = { collecting: "collecting views", solving: "calibrating", done: "calibrated", failed: "not calibrated" };
/** Of an image of no use, one like others, one that was taken: `coaching.rs` numbers them. */
const MARKS = ["#ff3b46", "#3d9bff", "#2fd85c"];

/** The live image with the corners found in it. */
class LiveBoard extends Drawing {
  /** The newest image. @type {LivePictureMessage | null} */
  picture = null;

  /** @param {LivePictureMessage} picture */
  show(picture) {
    this.picture = picture;
    this.redraw();
  }

  draw() {
    const { canvas, picture } = this;
    if (!picture) return;
    const { width, height, grey, pixels, codes, count } = picture;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const context = contextOf(canvas), image = context.createImageData(width, height);
    const out = new Uint32Array(image.data.buffer);
    for (let i = 0; i < out.length; i++) out[i] = 0xff000000 | (grey[i] * 0x010101);
    context.putImageData(image, 0, 0);
    context.lineWidth = Math.max(1.5, width / 320);
    for (let i = 0; i < count; i++) {
      context.strokeStyle = MARKS[codes[i]];
      context.beginPath();
      context.arc(pixels[i * 2] + 0.5, pixels[i * 2 + 1] + 0.5, width / 110, 0, 7);
      context.stroke();
    }
    document.documentElement.dataset.marked = String(count);
  }
}

/** Where corners were seen: the cells that count, and every corner. */
class CoverageMap extends Drawing {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super(canvas);
    /** Corners of each view, x and y by turns as shares of the image. @type {number[][]} */
    this.views = [];
    /** Corners in each cell. @type {number[]} */
    this.cells = [];
    this.size = [4, 3];
  }

  draw() {
    const { canvas, cells, size } = this, [columns, rows] = data.cells;
    const width = 640, height = Math.round((640 * size[1]) / size[0]);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const context = contextOf(canvas), style = getComputedStyle(document.documentElement);
    /** @param {string} name */
    const colour = (name) => style.getPropertyValue(name).trim();
    context.clearRect(0, 0, width, height);
    const [w, h] = [width / columns, height / rows];
    cells.forEach((count, i) => {
      context.globalAlpha = count ? 0.28 : 0;
      context.fillStyle = colour("--s1");
      context.fillRect((i % columns) * w, Math.floor(i / columns) * h, w, h);
    });
    context.globalAlpha = 0.6;
    context.strokeStyle = colour("--line");
    for (let i = 0; i < columns * rows; i++) context.strokeRect((i % columns) * w, Math.floor(i / columns) * h, w, h);
    context.fillStyle = colour("--accent");
    for (const view of this.views) {
      for (let i = 0; i < view.length; i += 2) context.fillRect(view[i] * width - 2, view[i + 1] * height - 2, 4, 4);
    }
    context.globalAlpha = 1;
  }
}

const board = new LiveBoard(byId("picture")), coverage = new CoverageMap(byId("coverage"));
/** @type {CoachStatus | null} */
let status = null;

/** All that may be missing, what was seen ticked off; then what else there is to wish. @param {string[]} missing */
function showMissing(missing) {
  const others = missing.filter((wish) => !data.wishes.includes(wish));
  const lines = [...data.wishes, ...others].map((wish) => {
    const line = element("li", wish);
    line.classList.toggle("seen", !missing.includes(wish));
    return line;
  });
  byId("missing").replaceChildren(...lines);
  byId("missing-title").textContent = missing.length ? `Still missing: ${missing.length}` : "Nothing is missing";
}

/** @param {CoachStatus} status */
function showButton(status) {
  const button = byId("finish"), collecting = status.state === "collecting";
  button.disabled = collecting ? status.views < data.least_views : !status.waits;
  button.textContent = status.waits ? "End the program" : "Finish and calibrate";
  button.classList.toggle("ready", (collecting && !status.missing.length) || status.waits);
}

/** @param {CoachStatus} now */
function show(now) {
  status = now;
  byId("state").className = `state ${now.state}`;
  byId("state").textContent = STATE_NAMES[now.state];
  byId("number-views").textContent = `${now.views} of ${data.enough_views} or more`;
  byId("number-images").textContent = String(now.images);
  byId("number-share").textContent = `${Math.round(now.share * 100)} %`;
  byId("verdict").textContent = now.verdict;
  showMissing(now.missing);
  showButton(now);
  byId("result-card").hidden = !now.result;
  byId("result-title").textContent = now.state === "failed" ? "There is no result" : "Result";
  byId("result").textContent = now.result;
  Object.assign(coverage, { cells: now.cells, size: now.size[0] ? now.size : [4, 3] });
  coverage.redraw();
}

/** The connection came or went. @param {boolean} open */
function link(open) {
  const ended = status !== null && (status.state === "done" || status.state === "failed");
  byId("banner").hidden = open || ended;
  if (open || ended) return;
  byId("banner").textContent = "The program does not answer: it has ended, or this machine is cut off. Trying again …";
  byId("state").className = "state cut";
  byId("state").textContent = "cut off";
  byId("finish").disabled = true;
}

/** @type {Handlers} */
const handlers = {
  status: (/** @type {{ status: CoachStatus }} */ message) => show(message.status),
  views: (/** @type {{ from: number, views: number[][] }} */ { from, views }) => {
    coverage.views.length = from;
    coverage.views.push(...views);
    coverage.redraw();
  },
  picture: (/** @type {LivePictureMessage} */ picture) => board.show(picture),
  link,
};
const feed = new Feed(handlers);
byId("finish").addEventListener("click", () => {
  byId("finish").disabled = true;
  feed.command("finish");
});
// For tests: what works.
document.documentElement.dataset.page = "complete";
