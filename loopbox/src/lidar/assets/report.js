// The page of a LiDAR run or merge: a cloud to turn, paths, matrices, tables, plots.

import { COLOURS } from "../../../../view/src/report/assets/colours.js";
import { figures, quantile, unpack } from "../../../../view/src/report/assets/numbers.js";
import { byId, data, element } from "../../../../view/src/report/assets/page.js";

for (const [label, value] of data.tiles) byId("tiles").append(element("div", null, element("dt", label), element("dd", value)));

const points = unpack(data.cloud.points, Uint16Array);
const owners = unpack(data.cloud.agents, Uint8Array);
const { corner, step } = data.cloud;
const count = owners.length;
const at = (i, axis) => corner[axis] + step * points[3 * i + axis];
const paths = data.paths.map((path) => ({ ...path, xyz: unpack(path.points, Float32Array) }));
for (const path of paths) {
  const mark = element("i");
  mark.style.background = path.color;
  byId("paths").append(element("span", null, mark, path.name));
}

const canvas = byId("cloud");
const heights = [];
for (let i = 0; i < count; i += Math.max(1, Math.floor(count / 5000))) heights.push(at(i, 2));
heights.sort((a, b) => a - b);
const low = heights.length ? quantile(heights, 0.02) : 0;
const high = heights.length ? quantile(heights, 0.98) : 1;
const middle = [0, 1, 2].map((axis) => {
  const values = [];
  for (let i = 0; i < count; i += Math.max(1, Math.floor(count / 5000))) values.push(at(i, axis));
  values.sort((a, b) => a - b);
  return values.length ? quantile(values, 0.5) : 0;
});
const reach = (() => {
  const values = [];
  for (let i = 0; i < count; i += Math.max(1, Math.floor(count / 5000))) values.push(Math.hypot(at(i, 0) - middle[0], at(i, 1) - middle[1]));
  values.sort((a, b) => a - b);
  return values.length ? quantile(values, 0.97) : 10;
})();
const look = { yaw: 0, pitch: 1.1, zoom: 1, x: 0, y: 0 };

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const width = (canvas.width = Math.round(canvas.clientWidth * ratio));
  const height = (canvas.height = Math.round(canvas.clientHeight * ratio));
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  const depth = new Float32Array(width * height).fill(-Infinity);
  const scale = (0.48 * Math.min(width, height) * look.zoom) / Math.max(reach, 1);
  const [cy, sy, cp, sp] = [Math.cos(look.yaw), Math.sin(look.yaw), Math.cos(look.pitch), Math.sin(look.pitch)];
  const project = (x, y, z) => {
    const [dx, dy, dz] = [x - middle[0], y - middle[1], z - middle[2]];
    const u = cy * dx - sy * dy;
    const v = sy * dx + cy * dy;
    return [width / 2 + scale * u + look.x * ratio, height / 2 - scale * (sp * v + cp * dz) + look.y * ratio, sp * dz - cp * v];
  };
  const byAgent = byId("colour").value === "agent";
  for (let i = 0; i < count; i++) {
    const z = at(i, 2);
    const [u, v, near] = project(at(i, 0), at(i, 1), z);
    const [px, py] = [u | 0, v | 0];
    if (px < 0 || py < 0 || px >= width || py >= height) continue;
    const pixel = py * width + px;
    if (depth[pixel] > near) continue;
    depth[pixel] = near;
    if (byAgent) image.data.set(data.agents[owners[i]].color, pixel * 4);
    else {
      const shade = 3 * Math.round(255 * Math.min(1, Math.max(0, (z - low) / (high - low || 1))));
      image.data.set(COLOURS.ordered.subarray(shade, shade + 3), pixel * 4);
    }
    image.data[pixel * 4 + 3] = 255;
  }
  context.putImageData(image, 0, 0);
  for (const path of paths) {
    context.strokeStyle = path.color;
    context.lineWidth = 1.6 * ratio;
    context.beginPath();
    for (let i = 0; i < path.xyz.length; i += 3) context.lineTo(...project(path.xyz[i], path.xyz[i + 1], path.xyz[i + 2]).slice(0, 2));
    context.stroke();
  }
  context.fillStyle = "#ffb833";
  for (const loop of data.marks) {
    const [u, v] = project(...loop);
    context.beginPath();
    context.arc(u, v, 3.5 * ratio, 0, 7);
    context.fill();
  }
}
let asked = false;
function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; draw(); });
}
canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
canvas.addEventListener("pointermove", (event) => {
  if (!event.buttons) return;
  if (event.shiftKey || event.buttons === 2) { look.x += event.movementX; look.y += event.movementY; }
  else { look.yaw += event.movementX * 0.006; look.pitch = Math.min(1.57, Math.max(0, look.pitch + event.movementY * 0.006)); }
  redraw();
});
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", (event) => { event.preventDefault(); look.zoom *= Math.exp(-event.deltaY * 0.001); redraw(); }, { passive: false });
byId("colour").addEventListener("change", redraw);
window.addEventListener("resize", redraw);
if (data.agents.length > 1) byId("colour").value = "agent";
draw();

for (const matrix of data.matrices) {
  const values = unpack(matrix.values, Uint8Array);
  const picture = element("canvas");
  picture.className = "matrix";
  [picture.width, picture.height] = [matrix.columns, matrix.rows];
  const context = picture.getContext("2d");
  const image = context.createImageData(matrix.columns, matrix.rows);
  values.forEach((value, i) => { image.data.set(COLOURS.ordered.subarray(3 * (255 - value), 3 * (255 - value) + 3), i * 4); image.data[i * 4 + 3] = 255; });
  context.putImageData(image, 0, 0);
  byId("matrices").append(element("p", matrix.name), picture);
}
byId("matrices").append(element("p", "Bright: alike. Rows and columns are keyframes in order of time."));

for (const table of data.tables) {
  const head = element("tr", null, ...table.head.map((cell) => element("th", cell)));
  const rows = table.rows.map((row) => element("tr", null, ...row.map((cell) => element("td", cell))));
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
  byId("plots").append(element("p", plot.name), picture);
  const context = picture.getContext("2d");
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
