// Vectors of three and matrices (column-major arrays of 16).

/** @import { Numbers, Vector } from "./types.js" */

/** @param {Numbers} a @param {Numbers} b @returns {Vector} */
export const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
/** @param {Numbers} a @param {Numbers} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Numbers} a @param {Numbers} b @returns {Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Numbers} a @param {number} s @returns {Vector} */
export const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
/** @param {Numbers} a */
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
/** @param {Numbers} a */
export const unit = (a) => scaled(a, 1 / (norm(a) || 1));

/** The matrix product a·b. @param {Numbers} a @param {Numbers} b @returns {number[]} */
export function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return out;
}

/** A point through a matrix, to `[x, y, z, w]`. @param {Numbers} m @param {Numbers} p */
export function transform(m, p) {
  const out = [0, 0, 0, 0];
  for (let r = 0; r < 4; r++) out[r] = m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r];
  return out;
}

/** Perspective projection for a vertical field of view in radians. @param {number} fov @param {number} aspect @param {number} near @param {number} far */
export function perspective(fov, aspect, near, far) {
  const f = 1 / Math.tan(fov / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

/** The matrix whose rows are the axes of a view at `eye`: right, up, back. @param {Vector} right @param {Vector} up @param {Vector} back @param {Vector} eye */
export function viewMatrix(right, up, back, eye) {
  return [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -dot(right, eye), -dot(up, eye), -dot(back, eye), 1];
}
