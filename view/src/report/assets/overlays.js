// What is drawn over the scene: colours of lines, segments that tools and pages set, and dots.

import { Lines } from "./gl.js";
import { element } from "./page.js";
/** @import { Program, Segment } from "./types.js" */

export const LINE_COLOURS = {
  trajectory: [1, 0.72, 0.2, 1],
  keyframe: [0.46, 0.73, 1, 0.7],
  selected: [1, 0.36, 0.74, 1],
  grid: [0.55, 0.63, 0.74, 0.16],
  closure: [1, 1, 1, 1],
  cut: [1, 1, 1, 0.55],
  measured: [0.4, 1, 0.55, 1],
  played: [1, 0.95, 0.6, 1],
  odometry: [0.94, 0.59, 0.29, 0.8],
  edges: [[0.6, 0.66, 0.74, 0.5], [0.35, 0.85, 0.72, 0.45], [1, 0.33, 0.36, 1], [0.78, 0.55, 1, 1]],
};

/** Their widths, pixels. @type {Record<string, number>} */
const WIDTHS = { odometry: 1.4, cut: 1, played: 2, measured: 2.4 };

/** Segments that tools and pages set, by what they show; kept, so that they outlive the graphics card's memory. */
export class Overlays {
  constructor() {
    /** `[from, to, colour]` each. @type {Record<string, Segment[]>} */
    this.segments = { odometry: [], cut: [], played: [], measured: [] };
    /** @type {Record<string, Lines>} */
    this.lines = {};
  }

  /** Makes what lives on the graphics card. @param {WebGL2RenderingContext} gl */
  create(gl) {
    for (const name of Object.keys(this.segments)) {
      this.lines[name] = new Lines(gl);
      this.set(name, this.segments[name]);
    }
  }

  /** @param {string} name @param {Segment[]} segments */
  set(name, segments) {
    this.segments[name] = segments;
    segments.forEach(([from, to, colour]) => this.lines[name].push(from, to, colour));
    this.lines[name].upload();
  }

  /** @param {Program} lineProgram @param {number} ratio */
  draw(lineProgram, ratio) {
    for (const [name, lines] of Object.entries(this.lines)) lines.draw(lineProgram, WIDTHS[name] * ratio);
  }
}

/** A dot of a kind, to be moved over a canvas. @param {string} kind @param {HTMLCanvasElement} canvas */
export function marker(kind, canvas) {
  const node = element("div");
  node.className = `marker ${kind}`;
  canvas.after(node);
  return node;
}
