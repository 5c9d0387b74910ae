// The page of a calibration.

import { COLOURS } from "../../../../view/src/report/assets/colours.js";
import { figures, unpack } from "../../../../view/src/report/assets/numbers.js";
import { byId, contextOf, data, element } from "../../../../view/src/report/assets/page.js";
/** @import { PackedView, Parameter, View } from "./types.js" */

/** @type {View[]} */
const views = data.views.map((/** @type {PackedView} */ view) => ({ ...view, corners: unpack(view.corners, Float32Array) }));
/** Each corner is x, y, dx, dy, used. */
const STRIDE = 5;
const [imageWidth, imageHeight] = data.size;

/** @param {(corner: Float32Array, view: View) => void} visit */
function eachCorner(visit) {
  for (const view of views) {
    for (let i = 0; i < view.corners.length; i += STRIDE) visit(view.corners.subarray(i, i + STRIDE), view);
  }
}

/** A canvas of the image's shape and its context, drawn in image pixels. @param {HTMLCanvasElement} canvas */
function imageCanvas(canvas) {
  canvas.width = 2 * Math.min(imageWidth, 900);
  const scale = canvas.width / imageWidth;
  canvas.height = Math.round(imageHeight * scale);
  const context = contextOf(canvas);
  context.scale(scale, scale);
  return context;
}

/** @param {number} share */
const colour = (share) => {
  const i = 3 * Math.round(255 * Math.min(1, Math.max(0, share)));
  return `rgb(${COLOURS.ordered[i]},${COLOURS.ordered[i + 1]},${COLOURS.ordered[i + 2]})`;
};

/** Where views of which tilt or distance saw the board. @param {"tilt" | "distance"} key @param {string} unit */
function drawCoverage(key, unit) {
  const known = views.flatMap((view) => (view.used ? [view[key]] : [])).filter((value) => value !== null);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const context = imageCanvas(byId(key));
  eachCorner((c, view) => {
    if (!view.used) return;
    context.fillStyle = colour(((view[key] ?? 0) - low) / (high - low || 1));
    context.beginPath();
    context.arc(c[0], c[1], imageWidth / 260, 0, 7);
    context.fill();
  });
  byId(`${key}-scale`).textContent = `dark ${figures(low)} ${unit} to light ${figures(high)} ${unit}`;
}

function drawResiduals() {
  const factor = 0.02 * imageWidth / Math.max(data.rms, 1e-6);
  const context = imageCanvas(byId("vectors"));
  context.lineWidth = imageWidth / 700;
  eachCorner((c) => {
    if (!Number.isFinite(c[2])) return;
    context.strokeStyle = c[4] ? "#0b8a6d" : "#e0353e";
    context.beginPath();
    context.moveTo(c[0], c[1]);
    context.lineTo(c[0] + factor * c[2], c[1] + factor * c[3]);
    context.stroke();
  });
  byId("residual-note").textContent = `Residuals are drawn ${figures(factor)} times as long. They should point anywhere: a pattern over the image means that the model does not fit the lens.`;
  const canvas = byId("scatter");
  canvas.width = canvas.height = 600;
  const plot = contextOf(canvas);
  const reach = 4 * data.rms;
  plot.strokeStyle = "#8888";
  for (const k of [1, 2, 3]) {
    plot.beginPath();
    plot.arc(300, 300, (300 * k * data.rms) / reach, 0, 7);
    plot.stroke();
  }
  eachCorner((c) => {
    plot.fillStyle = c[4] ? "#0b6bcb66" : "#e0353e";
    plot.fillRect(299 + (300 * c[2]) / reach, 299 + (300 * c[3]) / reach, 3, 3);
  });
  byId("scatter-scale").textContent = `x and y of all residuals; circles at 1, 2 and 3 rms (${data.rms.toFixed(3)} px)`;
}

function drawBars() {
  const canvas = byId("bars");
  canvas.width = 1600;
  canvas.height = 240;
  const context = contextOf(canvas);
  const shown = views.flatMap(({ used, rms }) => (rms === null ? [] : [{ used, rms }]));
  const top = Math.max(...shown.map(({ rms }) => rms), 1e-9);
  const step = canvas.width / Math.max(shown.length, 1);
  shown.forEach(({ used, rms }, i) => {
    context.fillStyle = used ? "#0b6bcb" : "#e0353e";
    const height = (220 * rms) / top;
    context.fillRect(i * step + 1, 240 - height, Math.max(step - 2, 1), height);
  });
}

function fillTables() {
  /** @param {"td" | "th"} tag @param {string[]} cells */
  const row = (tag, cells) => element("tr", null, ...cells.map((cell) => element(tag, cell)));
  const parameters = data.parameters.map((/** @type {Parameter} */ p) => row("td", [p.name, p.value, `± ${p.sigma}`]));
  byId("parameters").append(row("th", ["parameter", "value", "uncertainty"]), ...parameters);
  const heads = ["image", "corners", "used", "rms [px]", "edge width [px]", "tilt [°]", "distance", "not used because"];
  byId("views").append(row("th", heads));
  for (const view of views) {
    /** @param {number | null} value @param {number} digits */
    const number = (value, digits) => (value === null ? "–" : value.toFixed(digits));
    const used = view.used ? view.count : 0;
    const cells = [view.name, String(view.corners.length / STRIDE), String(used), number(view.rms, 3), number(view.edge_width, 1), number(view.tilt, 0), number(view.distance, 3), view.reason || ""];
    const line = row("td", cells);
    line.classList.toggle("rejected", !view.used);
    line.cells[line.cells.length - 1].className = "text";
    byId("views").append(line);
  }
  for (const [label, value] of data.tiles) byId("tiles").append(element("div", null, element("dt", label), element("dd", value)));
  byId("advice").append(...data.advice.map((/** @type {string} */ line) => element("li", `Would help: ${line}`)));
}

/** @param {{ view: number, jpeg: string }} shot */
function drawShot(shot) {
  const canvas = document.createElement("canvas");
  const context = imageCanvas(canvas);
  const image = new Image();
  image.onload = () => {
    context.drawImage(image, 0, 0, imageWidth, imageHeight);
    const c = views[shot.view].corners;
    /** @param {number} x @param {number} y @param {number} radius @param {string} style */
    const dot = (x, y, radius, style) => {
      context.strokeStyle = style;
      context.lineWidth = imageWidth / 500;
      context.beginPath();
      context.arc(x, y, radius, 0, 7);
      context.stroke();
    };
    for (let i = 0; i < c.length; i += STRIDE) {
      dot(c[i], c[i + 1], imageWidth / 130, c[i + 4] ? "#2fd85c" : "#ff3b46");
      if (Number.isFinite(c[i + 2])) dot(c[i] + c[i + 2], c[i + 1] + c[i + 3], imageWidth / 400, "#3d82f7");
    }
  };
  image.src = `data:image/jpeg;base64,${shot.jpeg}`;
  byId("shots").append(element("figure", null, canvas, element("figcaption", views[shot.view].name)));
}

fillTables();
drawCoverage("tilt", "°");
drawCoverage("distance", data.unit);
drawResiduals();
drawBars();
data.shots.forEach(drawShot);
document.documentElement.dataset.report = "complete";
