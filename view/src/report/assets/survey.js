// The levelled frame (z up) in which the map is shown, and what the cloud's distribution says about its size.

import { cloud } from "./cloud.js";
import { quantile } from "./numbers.js";
import { data } from "./page.js";
import { keyframes, trajectory } from "./scene.js";
import { add, cross, dot, norm, unit } from "./vectors.js";
/** @import { Span, SurveyedScene, Vector } from "./types.js" */

/** Rows of the rotation that levels the world: ahead, left, up. */
function levelledAxes() {
  const up = unit(data.scene.up);
  /** @param {Vector} v */
  const flat = (v) => add(v, up, -dot(v, up));
  let ahead = flat(data.scene.forward);
  if (norm(ahead) < 0.2) ahead = cross(up, flat(longestDirection()));
  if (norm(ahead) < 1e-9) ahead = cross(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
  ahead = unit(ahead);
  return [ahead, cross(up, ahead), up];
}

/** The direction from the first camera to the one farthest from it. */
function longestDirection() {
  /** @param {number} i */
  const at = (i) => keyframes.column(i, 3);
  let best = [0, 0, 0];
  for (let i = 1; i < keyframes.count; i++) {
    const direction = add(at(i), at(0), -1);
    if (norm(direction) > norm(best)) best = direction;
  }
  return best;
}

/** The levelled world: axes, box of the bulk of the scene and of all but a few stray points, range of heights and of sigma codes. @returns {SurveyedScene} */
export function surveyScene() {
  const axes = levelledAxes();
  /** @param {Vector} p */
  const level = (p) => axes.map((axis) => dot(axis, p));
  /** @param {Vector} p */
  const unlevel = (p) => axes.reduce((sum, axis, i) => add(sum, axis, p[i]), [0, 0, 0]);
  const step = Math.max(1, Math.floor(cloud.count / 20000));
  /** @type {number[][]} */
  const samples = [[], [], []];
  /** @type {number[]} */
  const codes = [];
  for (let i = 0; i < cloud.count; i += step) {
    level(cloud.world(i)).forEach((v, axis) => samples[axis].push(v));
    codes.push(cloud.value[i * 2 + 1]);
  }
  [...samples, codes].forEach((list) => list.sort((a, b) => a - b));
  /** @param {number} share */
  const bulk = (share) => samples.map((s) => (s.length ? quantile(s, share) : Infinity * (share < 0.5 ? 1 : -1)));
  const box = { low: bulk(0.02), high: bulk(0.98) }, whole = { low: bulk(0.002), high: bulk(0.998) };
  /** @param {Vector} p */
  const widen = (p) => [box, whole].forEach(({ low, high }) => p.forEach((v, i) => {
    low[i] = Math.min(low[i], v);
    high[i] = Math.max(high[i], v);
  }));
  for (let i = 0; i < keyframes.count; i++) widen(level(keyframes.column(i, 3)));
  for (let i = 0; i < trajectory.count; i++) widen(level(Array.from(trajectory.position.subarray(i * 3, i * 3 + 3))));
  [box, whole].forEach((b) => Number.isFinite(b.low[0]) || Object.assign(b, { low: [-1, -1, -1], high: [1, 1, 1] }));
  const size = norm(add(box.high, box.low, -1)) || 1;
  /** @type {Span} */
  const heights = samples[2].length ? [quantile(samples[2], 0.02), quantile(samples[2], 0.98)] : [0, 1];
  if (heights[1] <= heights[0]) heights[1] = heights[0] + size * 1e-3;
  /** @type {Span} */
  const span = codes.length ? [quantile(codes, 0.02), quantile(codes, 0.98)] : [0, 255];
  return { axes, level, unlevel, box, whole, size, heights, codes: span[1] > span[0] ? span : [span[0] - 1, span[0] + 1] };
}
