import assert from "node:assert/strict";
import { test } from "node:test";
import { provenanceInWords } from "./numbers.js";

test("what is kept of the sensor is told in words and with few figures", () => {
  assert.deepEqual(provenanceInWords(["lens", "-0.002030292095902284 0.0"]), ["distortion beyond the calibration", "-0.0020 0.00"]);
  assert.deepEqual(provenanceInWords(["readout rows", "0.02625323324668059"]), ["rolling shutter, first to last row", "26.3 ms"]);
  assert.deepEqual(provenanceInWords(["source", "a/1.25.mp4"]), ["source", "a/1.25.mp4"]);
});
