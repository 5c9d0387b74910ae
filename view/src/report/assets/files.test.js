import assert from "node:assert/strict";
import test from "node:test";
import { plyFile, tumFile } from "./files.js";

test("a cloud is a PLY of as many points as it says", () => {
  const bytes = plyFile([[1, 2, 3], [-0.5, 0, 1e6]], [[9, 8, 7], [255, 254, 1]], "loopbox, m");
  const text = Buffer.from(bytes).toString("latin1"), end = text.indexOf("end_header\n") + 11;
  assert.ok(text.startsWith("ply\nformat binary_little_endian 1.0\ncomment loopbox, m\nelement vertex 2\nproperty float x\n"));
  const view = new DataView(bytes.buffer, end);
  assert.equal(view.byteLength, 2 * 15);
  assert.deepEqual([0, 4, 8].map((at) => view.getFloat32(15 + at, true)), [-0.5, 0, 1e6]);
  assert.deepEqual([12, 13, 14].map((at) => view.getUint8(at)), [9, 8, 7]);
});

test("a trajectory is TUM text of the frames asked for", () => {
  const trajectory = { timestamp: [0, 1700000000.25, 2], position: Float32Array.from([0, 0, 0, 0.1, -2, 3, 9, 9, 9]), rotation: Float32Array.from([0, 0, 0, 1, 0, 0.6, 0, 0.8, 0, 0, 0, 1]) };
  assert.equal(tumFile(trajectory, 1, 2), "# timestamp tx ty tz qx qy qz qw\n1700000000.250000000 0.1 -2 3 0 0.6 0 0.8\n");
});
