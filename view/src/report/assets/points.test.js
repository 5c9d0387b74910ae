import assert from "node:assert/strict";
import test from "node:test";
import { OrbitCamera } from "./camera.js";
import { eachPoint, isWithin, pointAt } from "./points.js";
import { multiply, transform } from "./vectors.js";

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
/** Points of the unit cube, with a grey and a code each, as a report holds them. */
function block(points, matrix = IDENTITY) {
  const words = Uint16Array.from(points.flatMap(([x, y, z]) => [x, y, z, 0].map((v) => Math.round(v * 65535))));
  const bytes = Uint8Array.from(points.flatMap(([, , , grey, code]) => [grey, code]));
  return { matrix, first: 0, end: points.length, words, wordStride: 4, bytes, byteStride: 2, grey: 0, code: 1 };
}
const close = (a, b) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) < 1e-4, `${a} is not ${b}`));

test("uncertain points and those cut away are not shown", () => {
  const seen = [];
  eachPoint([block([[0, 0, 0, 10, 5], [0.5, 0, 0, 20, 6], [1, 0, 0, 30, 5], [1, 1, 0, 40, 5]])], 5, { low: [0.5, -Infinity, -1], high: [1, 0.5, 1] }, (p, [grey]) => seen.push([...p, grey]));
  assert.deepEqual(seen, [[1, 0, 0, 30]]);
  const coloured = { ...block([[0, 0, 0, 10, 9], [1, 0, 0, 20, 0]]), colours: Uint8Array.from([1, 2, 3, 4, 5, 6]) };
  eachPoint([coloured], 5, null, (_, colour) => seen.push([...colour]));
  assert.deepEqual(seen[1], [4, 5, 6]);
  assert.ok(isWithin(null, [1e9, 0, 0]));
});

/** A camera above the middle of the unit square that looks down on it, on a canvas of 800 × 600 pixels. */
function sight() {
  const camera = Object.assign(new OrbitCamera(), { target: [0.5, 0.5, 0], azimuth: Math.PI, elevation: 1.2, distance: 3 });
  return { clip: camera.clipFromWorld(800, 600, 0, 100), width: 800, height: 600, near: camera.near() };
}
const onCanvas = ({ clip, width, height }, p) => {
  const [x, y, , w] = transform(clip, p);
  return [(x / w * 0.5 + 0.5) * width, (0.5 - y / w * 0.5) * height];
};

test("the point under the pointer is found, and of two in a line the nearer one", () => {
  const look = sight(), points = [[0.2, 0.3, 0, 1, 0], [0.8, 0.6, 0.1, 1, 0], [0.5, 0.5, 0, 1, 0]];
  for (const [x, y, z] of points) close(pointAt([block(points)], 255, null, look, onCanvas(look, [x, y, z])), [x, y, z]);
  // On the ray to the last one, half way to the eye.
  const eye = Object.assign(new OrbitCamera(), { target: [0.5, 0.5, 0], azimuth: Math.PI, elevation: 1.2, distance: 3 }).eye();
  const above = [0.5, 0.5, 0].map((v, i) => v + 0.25 * (eye[i] - v));
  const found = pointAt([block([...points, [...above, 1, 9]])], 255, null, look, onCanvas(look, [0.5, 0.5, 0]));
  close(found, above);
  close(pointAt([block([...points, [...above, 1, 9]])], 8, null, look, onCanvas(look, [0.5, 0.5, 0])), [0.5, 0.5, 0]);
  close(pointAt([block([...points, [...above, 1, 9]])], 255, { low: [0, 0, -1], high: [1, 1, 0.2] }, look, onCanvas(look, [0.5, 0.5, 0])), [0.5, 0.5, 0]);
});

test("far from every point there is none", () => {
  const look = sight();
  assert.equal(pointAt([block([[0.5, 0.5, 0, 1, 0]])], 255, null, look, [10, 10]), null);
  assert.equal(pointAt([], 255, null, look, [400, 300]), null);
});

test("points by pixel and inverse depth are found where they lie", () => {
  // A keyframe at the origin that looks along x: a cube of pixel shares and inverse depth up to 2.
  const fromPixel = [0, -0.5, 0, 0, 0, 0, -0.5, 0, 0, 0, 0, 2, 1, 0.25, 0.25, 0];
  const look = { ...sight() }, cube = [0.25, 0.75, 0.5];
  const [x, y, z, w] = transform(fromPixel, cube), truth = [x / w, y / w, z / w];
  const camera = Object.assign(new OrbitCamera(), { target: truth, azimuth: 0.3, elevation: 0.4, distance: 5 });
  const seen = { ...look, clip: camera.clipFromWorld(800, 600, 0, 100), near: camera.near() };
  close(pointAt([block([[...cube, 1, 0]], fromPixel)], 255, null, seen, [400, 300]), truth);
  assert.deepEqual(multiply(IDENTITY, fromPixel), fromPixel);
});
