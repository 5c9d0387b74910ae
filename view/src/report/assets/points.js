// The points that are shown, whatever holds them: found under the pointer, kept within a box, and handed on.

import { multiply } from "./vectors.js";

/**
 * Points in a row: three words of each place it in a unit cube, over 65535, from which `matrix` (homogeneous) leads to the
 * levelled world; of its bytes one is the intensity and one the code of its relative σ. `colours` has red, green and blue of each.
 * @typedef {{ matrix: number[], first: number, end: number, words: Uint16Array, wordStride: number, bytes: Uint8Array,
 *   byteStride: number, grey: number, code: number, colours?: Uint8Array | null }} Block
 */
/** What is kept of the levelled world. @typedef {{ low: number[], high: number[] }} Box */
/**
 * How the world is seen: clip from the levelled world, pixels of the canvas, and how far the nearest things are that it shows.
 * @typedef {{ clip: number[], width: number, height: number, near: number }} Sight
 */

/** Pixels within which the nearest to the eye is meant, and beyond which nothing is. */
const REACH = { sure: 6, most: 30 };

/**
 * A point of a block's cube through a homogeneous matrix, into `out`: what is divided by, last. Millions of points are asked about
 * at one click, so nothing is made anew for each.
 * @param {ArrayLike<number>} m @param {Block} block @param {number} index @param {Float64Array} out
 */
function through(m, { words, wordStride }, index, out) {
  const at = index * wordStride, x = words[at] / 65535, y = words[at + 1] / 65535, z = words[at + 2] / 65535;
  const w = m[3] * x + m[7] * y + m[11] * z + m[15];
  out[0] = (m[0] * x + m[4] * y + m[8] * z + m[12]) / w;
  out[1] = (m[1] * x + m[5] * y + m[9] * z + m[13]) / w;
  out[2] = (m[2] * x + m[6] * y + m[10] * z + m[14]) / w;
  out[3] = w;
}

/** Whether a point lies in a box; without one it does. @param {Box | null} box @param {ArrayLike<number>} p */
export function isWithin(box, p) {
  if (!box) return true;
  for (let i = 0; i < 3; i++) if (!(p[i] >= box.low[i] && p[i] <= box.high[i])) return false;
  return true;
}

/**
 * Calls `visit` with each point that is as sure as `sigma` (a code) or surer and lies in the box, in the levelled world, and
 * with its red, green and blue: where there are no colours, three times its intensity.
 * @param {Iterable<Block>} blocks @param {number} sigma @param {Box | null} box @param {(p: number[], colour: ArrayLike<number>) => void} visit
 */
export function eachPoint(blocks, sigma, box, visit) {
  const p = new Float64Array(4);
  for (const block of blocks) {
    const { bytes, byteStride, grey, code, colours } = block;
    for (let i = block.first; i < block.end; i++) {
      if (bytes[i * byteStride + code] > sigma) continue;
      through(block.matrix, block, i, p);
      if (isWithin(box, p)) visit([p[0], p[1], p[2]], colours ? colours.subarray(i * 3, i * 3 + 3) : new Array(3).fill(bytes[i * byteStride + grey]));
    }
  }
}

/**
 * The point that is meant by a place on the screen, in the levelled world: of those close to it the one nearest to the eye,
 * else the closest within reach.
 * @param {Iterable<Block>} blocks @param {number} sigma @param {Box | null} box @param {Sight} sight @param {number[]} place
 * @returns {number[] | null}
 */
export function pointAt(blocks, sigma, box, { clip, width, height, near }, [x, y]) {
  const p = new Float64Array(4), seen = new Float64Array(4), best = [0, 0, 0];
  let lowest = Infinity;
  for (const block of blocks) {
    const matrix = multiply(clip, block.matrix), { bytes, byteStride, code } = block;
    for (let i = block.first; i < block.end; i++) {
      if (bytes[i * byteStride + code] > sigma) continue;
      through(matrix, block, i, seen);
      const right = (seen[0] * 0.5 + 0.5) * width - x, down = (0.5 - seen[1] * 0.5) * height - y;
      const off = Math.sqrt(right * right + down * down);
      if (!(off <= REACH.most)) continue;
      through(block.matrix, block, i, p);
      // Homogeneous coordinates of the cube come with a weight of their own: depth is what is left without it.
      const w = seen[3] / p[3];
      if (!(w >= near)) continue;
      const cost = off < REACH.sure ? w / (1 + w) : 1 + off;
      if (cost >= lowest || !isWithin(box, p)) continue;
      lowest = cost;
      for (let axis = 0; axis < 3; axis++) best[axis] = p[axis];
    }
  }
  return lowest < Infinity ? best : null;
}
