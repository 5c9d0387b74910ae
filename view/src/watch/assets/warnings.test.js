import assert from "node:assert/strict";
import test from "node:test";
import { scaleBreakText } from "./warnings.js";

const found = { count: 1, frame: 431, timestamp: 14.3666, why: "3 of 11 points that measure it agree, no more than by chance" };

test("a scale that was not carried on is said with its time", () => {
  const text = scaleBreakText(found);
  assert.match(text, /^The scale was not carried on: once, some keyframes before frame 431 at 14\.37 s \(3 of 11 points/);
  assert.match(text, /a unit of its own/);
});

test("of several the last is said, and how many there are", () => {
  assert.match(scaleBreakText({ ...found, count: 3 }), /3 times, the last time some keyframes before frame 431/);
});
