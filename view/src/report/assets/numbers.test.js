import assert from "node:assert/strict";
import { test } from "node:test";
import { medianOf, parts, provenanceInWords } from "./numbers.js";

test("what is kept of the sensor is told in words and with few figures", () => {
  assert.deepEqual(provenanceInWords(["lens", "-0.002030292095902284 0.0"]), ["distortion beyond the calibration", "-0.0020 0.00"]);
  assert.deepEqual(provenanceInWords(["readout rows", "0.02625323324668059"]), ["rolling shutter, first to last row", "26.3 ms"]);
  assert.deepEqual(provenanceInWords(["source", "a/1.25.mp4"]), ["source", "a/1.25.mp4"]);
});

test("values are parted evenly, none left out", () => {
  assert.deepEqual(parts(7, 3), [[0, 2], [2, 4], [4, 7]]);
  assert.deepEqual(parts(2, 24), [[0, 1], [1, 2]]);
  assert.deepEqual(parts(0), []);
  assert.equal(parts(100_000).length, 24);
});

test("the median of a part takes the finite numbers alone, of any kind of array", () => {
  assert.equal(medianOf(Float32Array.of(9, 1, NaN, 30, 2), [1, 5]), 2);
  assert.ok(Number.isNaN(medianOf([NaN, Infinity], [0, 2])));
});
