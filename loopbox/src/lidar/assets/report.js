// The page of a map with scans in it: the 3-D view, matrices, tables, plots.

import { COLOURS } from "../../../../view/src/report/assets/colours.js";
import { startViewer } from "../../../../view/src/report/assets/controls.js";
import { figures, quantile, unpack } from "../../../../view/src/report/assets/numbers.js";
import { LINE_COLOURS } from "../../../../view/src/report/assets/overlays.js";
import { byId, contextOf, data, element } from "../../../../view/src/report/assets/page.js";
import { keyframeInWords, shared } from "../../../../view/src/report/assets/scene.js";
import { heads, medians, plotTable } from "../../../../view/src/report/assets/tabular.js";
/** @import { Controls } from "../../../../view/src/report/assets/controls.js" */
/** @import { Plotted, Segment } from "../../../../view/src/report/assets/types.js" */

for (const [label, value] of data.tiles) byId("tiles").append(element("div", null, element("dt", label), element("dd", value)));

/** Draws the way by odometry alone. @param {Controls} controls */
function drawOdometry({ viewer }) {
  const places = unpack(data.odometry, Float32Array);
  /** @type {Segment[]} */
  const segments = [];
  /** @param {number} i */
  const at = (i) => viewer.scene.level(Array.from(places.subarray(3 * i, 3 * i + 3)));
  for (let i = 1; i < places.length / 3; i++) segments.push([at(i - 1), at(i), LINE_COLOURS.odometry]);
  viewer.setOverlay("odometry", segments);
  byId("odometry").hidden = false;
}

const controls = startViewer();
if (controls && data.odometry) drawOdometry(controls);
shared.onChange((what) => what === "selected" && (byId("selection").textContent = `Selected: ${keyframeInWords(shared.selected)}`));

byId("matrices").hidden = !data.matrices.length;
for (const matrix of data.matrices) {
  const values = unpack(matrix.values, Uint8Array);
  const picture = element("canvas");
  picture.className = "matrix";
  [picture.width, picture.height] = [matrix.columns, matrix.rows];
  const context = contextOf(picture);
  const image = context.createImageData(matrix.columns, matrix.rows);
  values.forEach((value, i) => { image.data.set(COLOURS.ordered.subarray(3 * (255 - value), 3 * (255 - value) + 3), i * 4); image.data[i * 4 + 3] = 255; });
  context.putImageData(image, 0, 0);
  byId("matrices").append(element("p", matrix.name), picture);
}
byId("matrices").append(element("p", "Bright: alike. Rows and columns are keyframes in order of time."));

for (const table of data.tables) {
  const head = element("tr", null, ...table.head.map((/** @type {string} */ cell) => element("th", cell)));
  const rows = table.rows.map((/** @type {string[]} */ row) => element("tr", null, ...row.map((cell) => element("td", cell))));
  const node = element("table", null, element("thead", null, head), element("tbody", null, ...rows));
  node.className = "lidar-table";
  const scroll = element("div", null, node);
  scroll.className = "lidar-scroll";
  byId("tables").append(element("h2", table.name), rows.length ? scroll : element("p", "none"));
}

for (const plot of data.plots) {
  byId("plots").hidden = false;
  const values = unpack(plot.values, Float32Array);
  const picture = element("canvas");
  picture.className = "plot";
  picture.setAttribute("role", "img");
  picture.setAttribute("aria-label", `${plot.name}; the table below has the figures`);
  byId("plots").append(element("p", plot.name), picture);
  const context = contextOf(picture);
  [picture.width, picture.height] = [picture.clientWidth * 2, picture.clientHeight * 2];
  const sorted = Array.from(values).sort((a, b) => a - b);
  const top = sorted.length ? quantile(sorted, 0.99) * 1.1 || 1 : 1;
  context.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue("--plot-1");
  context.lineWidth = 2;
  context.beginPath();
  values.forEach((value, i) => context.lineTo((i / Math.max(1, values.length - 1)) * picture.width, picture.height * (1 - Math.min(1, value / top))));
  context.stroke();
  context.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--soft");
  context.font = "22px system-ui";
  context.fillText(figures(top / 1.1), 4, 22);
}

if (data.plots.length) {
  /** @type {Plotted[]} */
  const panels = data.plots.map((/** @type {Record<"name" | "values", string>} */ { name, values }) => ({ title: name, unit: "", values: unpack(values, Float32Array) }));
  const count = Math.max(...panels.map(({ values }) => values.length));
  byId("plots").append(plotTable(["Part", ...heads(panels)], () => medians(panels, [0, count], ([first, end]) => [`${first + 1}–${end}`])));
}

// For tests: what works.
document.documentElement.dataset.report = controls ? "complete" : "without-3d";
