// Key-point matches of keyframe pairs, side by side.

import { toggleFullScreen } from "../../../../../view/src/report/assets/controls.js";
import { unpack } from "../../../../../view/src/report/assets/numbers.js";
import { contextOf, data, element } from "../../../../../view/src/report/assets/page.js";
import { takeImage } from "../../../../../view/src/report/assets/scene.js";
/** @import { Closure, FactoredPicture, Meeting, Pair } from "./types.js" */

export const MATCH_COLOURS = { depth: "#56b4e9", none: "#e69f00" };
/** Pixels between the two images. */
export const MATCH_GAP = 12;

/** @type {FactoredPicture[]} */
export const pictures = data.pictures;
export const images = pictures.map(takeImage);

/** A pair's figure: the earlier map's image on the left, the joining map's on the right, matches as lines. */
export class MatchFigure {
  /** @param {Meeting} meeting @param {Pair} pair @param {string} title */
  constructor(meeting, pair, title) {
    this.pair = pair;
    this.lines = 60;
    this.node = element("figure");
    const [source, target] = [meeting.source, meeting.target].map((input) => data.inputs[input]);
    const { keyframes: ids, matches, pictures: shown } = pair;
    this.canvas = element("canvas");
    this.canvas.title = "Fill the screen";
    this.canvas.addEventListener("click", () => toggleFullScreen(this.node));
    const counts = matches
      ? `γ = ${matches.count.toLocaleString("en")} of ${matches.candidates.toLocaleString("en")} matched key points fit one relative pose, ${matches.with_depth.toLocaleString("en")} of them with depth on both sides. `
      : "";
    const caption = element("figcaption", null, element("b", `${title} `), `Keyframe ${ids.target} of ${target} (left), ${ids.source} of ${source} (right). ${counts}${pair.verdict}`);
    if (shown.every((index) => index !== null)) this.node.append(this.canvas);
    else this.node.append(Object.assign(element("div", "The report holds a choice of pictures; this pair's are not among them."), { className: "blank" }));
    this.node.append(caption);
    if (matches) this.points = { pixels: unpack(matches.pixels, Float32Array), depth: unpack(matches.depth, Uint8Array) };
    if (shown.every((index) => index !== null)) Promise.all(shown.map((index) => images[index].decode())).then(() => this.draw(), () => {});
  }

  /** Shows at most so many lines, spread evenly. @param {number} lines */
  show(lines) {
    this.lines = lines;
    this.draw();
  }

  draw() {
    const [source, target] = this.pair.pictures.map((index) => index === null ? null : { ...pictures[index], image: images[index] });
    if (!source || !target || !source.image.complete) return;
    const height = Math.max(source.height, target.height);
    /** @param {FactoredPicture} picture */
    const zoom = (picture) => height / picture.height;
    const split = target.width * zoom(target) + MATCH_GAP;
    this.canvas.width = split + source.width * zoom(source);
    this.canvas.height = height;
    const context = contextOf(this.canvas);
    context.drawImage(target.image, 0, 0, split - MATCH_GAP, height);
    context.drawImage(source.image, split, 0, this.canvas.width - split, height);
    if (!this.points) return;
    const { pixels, depth } = this.points;
    /** @param {FactoredPicture} picture @param {number} x @param {number} y @param {number} left @returns {[number, number]} */
    const place = (picture, x, y, left) => [(x + 0.5) / picture.factor * zoom(picture) + left, (y + 0.5) / picture.factor * zoom(picture)];
    const count = Math.min(depth.length, this.lines);
    context.lineWidth = height / 330;
    for (let k = 0; k < count; k++) {
      const i = Math.floor((k + 0.5) * depth.length / count);
      const [x, y, u, v] = pixels.subarray(i * 4, i * 4 + 4);
      const ends = [place(target, u, v, 0), place(source, x, y, split)];
      context.strokeStyle = context.fillStyle = depth[i] ? MATCH_COLOURS.depth : MATCH_COLOURS.none;
      context.globalAlpha = 0.75;
      context.beginPath();
      context.moveTo(...ends[0]);
      context.lineTo(...ends[1]);
      context.stroke();
      context.globalAlpha = 1;
      ends.forEach(([a, b]) => {
        context.beginPath();
        context.arc(a, b, height / 140, 0, 7);
        context.fill();
      });
    }
  }
}

/** The three pairs of a meeting: the place itself large, its neighbours beside it. @param {Meeting} meeting @param {Closure} closure */
export function matchFigures(meeting, closure) {
  const titles = ["z = −1: the keyframes before.", "z = 0: the place.", "z = 1: the keyframes after."];
  const figures = closure.pairs.map((pair, z) => pair && new MatchFigure(meeting, pair, titles[z]));
  /** @param {number} z */
  const blank = (z) => Object.assign(element("div", `${titles[z]} The maps have no such pair.`), { className: "blank" });
  const triple = element("div", null, ...[1, 0, 2].map((z) => (figures[z] ? figures[z].node : blank(z))));
  triple.className = "triple";
  const most = Math.max(1, ...figures.map((figure) => (figure && figure.points ? figure.points.depth.length : 0)));
  const slider = Object.assign(element("input"), { type: "range", min: "1", max: String(most), value: String(Math.min(most, 60)) });
  slider.setAttribute("aria-label", "Lines shown");
  slider.addEventListener("input", () => figures.forEach((figure) => figure && figure.show(Number(slider.value))));
  /** @param {string} colour @param {string} text */
  const key = (colour, text) => {
    const swatch = Object.assign(element("span"), { className: "swatch" });
    swatch.style.background = colour;
    return element("span", null, swatch, text);
  };
  const legend = element("div", null, key(MATCH_COLOURS.depth, "depth known on both sides: tells the scale"), key(MATCH_COLOURS.none, "without depth: tells the direction only"), element("label", null, "Lines", slider));
  legend.className = "match-legend";
  return [legend, triple];
}
