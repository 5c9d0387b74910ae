// Level of detail: which chunks are seen, and how many points of each are worth drawing.

import { quantile } from "../../report/assets/numbers.js";
import { add, dot, norm } from "../../report/assets/vectors.js";
import { chunkPoint } from "./store.js";
/** @import { Numbers, Vector } from "../../report/assets/types.js" */
/** @import { Chunk } from "./decode.js" */
/** @import { Sphere } from "./types.js" */

/** Points of an image, and the milliseconds that it may take. */
const BUDGET = { start: 400000, least: 40000, most: 4000000, goal: 24 };

/** A sphere around the bulk of a chunk, in its keyframe's frame and unit; any beginning of a chunk is a fair sample. @param {Chunk} chunk @returns {Sphere} */
export function chunkSphere(chunk) {
  /** @type {Vector[]} */
  const sample = [];
  for (let i = 0; i < Math.min(160, chunk.count); i++) sample.push(chunkPoint(chunk, i));
  const middle = [0, 1, 2].map((axis) => quantile(sample.map((p) => p[axis]).sort((a, b) => a - b), 0.5));
  const away = sample.map((p) => norm(add(p, middle, -1))).sort((a, b) => a - b);
  return { middle, radius: quantile(away, 0.9) || 1e-6 };
}

/** The planes that bound what is seen, as `[a, b, c, d]` with a·x + b·y + c·z + d ≥ 0 inside. @param {number[]} matrix */
export function frustum(matrix) {
  /** @param {number} r */
  const row = (r) => [0, 1, 2, 3].map((c) => matrix[c * 4 + r]);
  const w = row(3);
  return [0, 1].flatMap((r) => [1, -1].map((sign) => {
    const plane = w.map((v, i) => v + sign * row(r)[i]);
    return plane.map((v) => v / (norm(plane) || 1));
  }));
}

/** Whether a sphere reaches into the frustum. @param {Numbers[]} planes @param {Vector} centre @param {number} radius */
export const isSeen = (planes, centre, radius) => planes.every((plane) => dot(plane, centre) + plane[3] > -radius);

/**
 * How many points to draw of each: near and large ones get more, none more than it has, all together the
 * budget. `chunks` are `{ count, weight }`; the shares that full ones leave over go to the rest.
 * @param {{ count: number, weight: number }[]} chunks @param {number} budget
 */
export function shares(chunks, budget) {
  const out = new Array(chunks.length).fill(0);
  let open = chunks.map((_, i) => i), left = budget;
  for (let round = 0; round < 4 && open.length && left > 0; round++) {
    const weights = open.reduce((sum, i) => sum + chunks[i].weight, 0) || 1;
    const share = left / weights;
    left = 0;
    /** @type {number[]} */
    const still = [];
    for (const i of open) {
      const wanted = out[i] + share * chunks[i].weight;
      out[i] = Math.min(chunks[i].count, wanted);
      left += wanted - out[i];
      if (out[i] < chunks[i].count) still.push(i);
    }
    open = still;
  }
  return out.map(Math.floor);
}

/** Keeps the time of a frame near its goal by the number of points that may be drawn. */
export class Budget {
  constructor() {
    this.points = BUDGET.start;
    this.ms = 0;
  }

  /** Learns that drawing `drawn` points took so many milliseconds; says whether there is room for more. @param {number} ms @param {number} drawn */
  learn(ms, drawn) {
    this.ms = this.ms ? this.ms + 0.25 * (ms - this.ms) : ms;
    const full = drawn > this.points * 0.9;
    if (ms < BUDGET.goal && !full) return false;
    const change = Math.max(0.25, Math.min(1.3, BUDGET.goal / Math.max(ms, 0.1)));
    this.points = Math.max(BUDGET.least, Math.min(BUDGET.most, this.points * change));
    return full && change > 1.1 && this.points < BUDGET.most;
  }
}
