import assert from "node:assert/strict";
import test from "node:test";
import { OrbitCamera } from "./camera.js";
import { transform } from "./vectors.js";

/** Pixels of the corners of a box, as a view shows them on a canvas whose left is covered. */
function corners(box, azimuth, elevation, width, height, covered) {
  const camera = new OrbitCamera();
  Object.assign(camera, camera.fitted(box, azimuth, elevation, (width - covered) / height));
  const clip = camera.clipFromWorld(width, height, covered, 1000);
  return Array.from({ length: 8 }, (_, bits) => {
    const [x, y, , w] = transform(clip, [0, 1, 2].map((axis) => (bits >> axis & 1 ? box.high[axis] : box.low[axis])));
    return [(x / w * 0.5 + 0.5) * width, (0.5 - y / w * 0.5) * height];
  });
}

test("every view fits the box beside the panel", () => {
  const boxes = [{ low: [-3, -2, 0], high: [9, 4, 1] }, { low: [0, 0, 0], high: [1, 30, 8] }, { low: [-1, -1, -20], high: [1, 1, 2] }];
  for (const box of boxes) {
    for (const [azimuth, elevation] of [[Math.PI + 0.45, 0.5], [Math.PI, 1.5607], [Math.PI, 0.03]]) {
      for (const [width, height, covered] of [[940, 600, 218], [1900, 900, 218], [360, 570, 0], [700, 900, 218]]) {
        for (const [x, y] of corners(box, azimuth, elevation, width, height, covered)) {
          assert.ok(x >= covered && x <= width && y >= 0 && y <= height, `${x}, ${y} on ${width} × ${height}, ${covered} covered`);
        }
      }
    }
  }
});
