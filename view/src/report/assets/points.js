// The points that are shown, whatever holds them: found under the pointer, kept within a box, and handed on.

import { multiply, transform } from "./vectors.js";

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

/** A point of the block's cube. @param {Block} block @param {number} index */
function inCube({ words, wordStride }, index) {
  const at = index * wordStride;
  return [words[at] / 65535, words[at + 1] / 65535, words[at + 2] / 65535];
}

/** A point through a homogeneous matrix. @param {number[]} matrix @param {number[]} point */
function through(matrix, point) {
  const [x, y, z, w] = transform(matrix, point);
  return [x / w, y / w, z / w];
}

/** Whether a point lies in a box; without one it does. @param {Box | null} box @param {number[]} p */
export const isWithin = (box, p) => !box || p.every((v, i) => v >= box.low[i] && v <= box.high[i]);

/**
 * Calls `visit` with each point that is as sure as `sigma` (a code) or surer and lies in the box, in the levelled world, and
 * with its red, green and blue: where there are no colours, three times its intensity.
 * @param {Iterable<Block>} blocks @param {number} sigma @param {Box | null} box @param {(p: number[], colour: ArrayLike<number>) => void} visit
 */
export function eachPoint(blocks, sigma, box, visit) {
  for (const block of blocks) {
    const { bytes, byteStride, grey, code, colours } = block;
    for (let i = block.first; i < block.end; i++) {
      if (bytes[i * byteStride + code] > sigma) continue;
      const p = through(block.matrix, inCube(block, i));
      if (isWithin(box, p)) visit(p, colours ? colours.subarray(i * 3, i * 3 + 3) : new Array(3).fill(bytes[i * byteStride + grey]));
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
  let best = null, lowest = Infinity;
  for (const block of blocks) {
    const matrix = multiply(clip, block.matrix);
    for (let i = block.first; i < block.end; i++) {
      if (block.bytes[i * block.byteStride + block.code] > sigma) continue;
      const cube = inCube(block, i);
      const [cx, cy, , cw] = transform(matrix, cube);
      // Homogeneous coordinates of the cube come with a weight of their own: depth is what is left without it.
      const m = block.matrix, w = cw / (m[3] * cube[0] + m[7] * cube[1] + m[11] * cube[2] + m[15]);
      if (!(w >= near)) continue;
      const off = Math.hypot((cx / cw * 0.5 + 0.5) * width - x, (0.5 - cy / cw * 0.5) * height - y);
      if (off > REACH.most) continue;
      const cost = off < REACH.sure ? w / (1 + w) : 1 + off;
      if (cost >= lowest) continue;
      const p = through(m, cube);
      if (isWithin(box, p)) [best, lowest] = [p, cost];
    }
  }
  return best;
}
