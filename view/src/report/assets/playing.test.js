import assert from "node:assert/strict";
import test from "node:test";
import { aheadOf, axesOf, framesAt, nearestTime, playedSeconds } from "./playing.js";

test("a quaternion's axes are the columns of its rotation", () => {
  const half = Math.SQRT1_2;
  // A quarter turn about z.
  const [x, y, z] = axesOf([0, 0, half, half]);
  const close = (a, b) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) < 1e-12, `${a}`));
  close(x, [0, 1, 0]);
  close(y, [-1, 0, 0]);
  close(z, [0, 0, 1]);
  // A quarter turn about x brings y to z.
  close(axesOf([half, 0, 0, half])[1], [0, 0, 1]);
});

test("a LiDAR that stands upright looks along its x, with its left to the left and up above", () => {
  const [right, down, ahead] = aheadOf(axesOf([0, 0, 0, 1]));
  assert.deepEqual([right, down, ahead].map((v) => v.map((c) => c + 0)), [[0, -1, 0], [0, 0, -1], [1, 0, 0]]);
});

test("the nearest time of a part is found", () => {
  const times = [0, 1, 2, 10, 11, 13];
  assert.deepEqual([-5, 0.4, 0.6, 2.4, 99].map((t) => nearestTime(times, 0, 3, t)), [0, 0, 1, 2, 2]);
  assert.equal(nearestTime(times, 3, 6, 12.1), 5);
  assert.equal(nearestTime(times, 3, 3, 1), -1);
});

test("agents play together, each from its own first frame to its last", () => {
  const times = [100, 101, 102, 7, 8, 9, 10, 11], spans = [[0, 3], [3, 8], [8, 8]];
  assert.equal(playedSeconds(times, spans), 4);
  assert.deepEqual(framesAt(times, spans, 0), [0, 3, -1]);
  assert.deepEqual(framesAt(times, spans, 1.2), [1, 4, -1]);
  assert.deepEqual(framesAt(times, spans, 3.9), [-1, 7, -1]);
});
