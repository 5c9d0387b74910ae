import assert from "node:assert/strict";
import test from "node:test";
import { apart, boxEdges, common, cutOut, metresPerUnit } from "./measure.js";

test("lengths are told straight, level and up", () => {
  const { straight, level, up } = apart([1, 1, 5], [4, 5, -7]);
  assert.deepEqual([straight, level, up], [13, 5, -12]);
});

test("a known length gives the scale, anything else none", () => {
  assert.equal(metresPerUnit(0.5, 3), 6);
  for (const [measured, metres] of [[0, 3], [0.5, 0], [0.5, -1], [0.5, NaN], [NaN, 3], [1e-320, 1e300]]) assert.equal(metresPerUnit(measured, metres), null);
});

test("a cut at its ends cuts nothing, not even what lies outside of the box", () => {
  const box = { low: [0, 0, -1], high: [10, 4, 1] };
  const whole = [[0, 1], [0, 1], [0, 1]];
  assert.equal(cutOut(box, whole), null);
  assert.deepEqual(cutOut(box, [[0.1, 1], [0, 0.5], [0, 1]]), { low: [1, -Infinity, -Infinity], high: [Infinity, 2, Infinity] });
  assert.deepEqual(common(box, cutOut(box, [[0.1, 1], [0, 0.5], [0, 1]])), { low: [1, 0, -1], high: [10, 2, 1] });
});

test("a box has twelve edges along its axes", () => {
  const box = { low: [0, 0, 0], high: [1, 2, 3] };
  const edges = boxEdges(box);
  assert.equal(edges.length, 12);
  const lengths = edges.map(([a, b]) => apart(a, b).straight).sort();
  assert.deepEqual(lengths, [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3]);
  assert.equal(new Set(edges.map((edge) => JSON.stringify(edge))).size, 12);
});
