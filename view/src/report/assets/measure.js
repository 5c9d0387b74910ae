// Lengths between points of the levelled world, and boxes cut out of it.

import { add, norm } from "./vectors.js";

/**
 * How far two points are apart: straight, over the ground, and up from the first to the second.
 * @param {number[]} a @param {number[]} b
 */
export function apart(a, b) {
  const way = add(b, a, -1);
  return { straight: norm(way), level: Math.hypot(way[0], way[1]), up: way[2] };
}

/**
 * Metres in a unit of the map where a measured length is known in metres; `null` where either is no length.
 * @param {number} measured @param {number} metres
 */
export function metresPerUnit(measured, metres) {
  const scale = metres / measured;
  return measured > 0 && metres > 0 && Number.isFinite(scale) ? scale : null;
}

/**
 * The part of a box between shares of its sides, `[low, high]` of each axis in 0–1. Where a share is at its end nothing is
 * cut there: what lies outside of the box stays. `null` where nothing is cut at all.
 * @param {{ low: number[], high: number[] }} box @param {number[][]} shares
 */
export function cutOut(box, shares) {
  if (shares.every(([low, high]) => low <= 0 && high >= 1)) return null;
  /** @param {number} axis @param {number} share */
  const at = (axis, share) => box.low[axis] + share * (box.high[axis] - box.low[axis]);
  return {
    low: shares.map(([low], axis) => (low <= 0 ? -Infinity : at(axis, low))),
    high: shares.map(([, high], axis) => (high >= 1 ? Infinity : at(axis, high))),
  };
}

/** The twelve edges of a box, as pairs of points. @param {{ low: number[], high: number[] }} box */
export function boxEdges({ low, high }) {
  /** @param {number} bits */
  const corner = (bits) => [0, 1, 2].map((axis) => (bits >> axis & 1 ? high[axis] : low[axis]));
  const edges = [];
  for (let bits = 0; bits < 8; bits++) {
    for (let axis = 0; axis < 3; axis++) if (!(bits >> axis & 1)) edges.push([corner(bits), corner(bits | 1 << axis)]);
  }
  return edges;
}

/** What two boxes have in common; the second may reach to infinity. @param {{ low: number[], high: number[] }} a @param {{ low: number[], high: number[] }} b */
export const common = (a, b) => ({ low: a.low.map((v, i) => Math.max(v, b.low[i])), high: a.high.map((v, i) => Math.min(v, b.high[i])) });
