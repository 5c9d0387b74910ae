// Plots per frame; the state lies in a band below.

import { Chart, PANEL } from "./chart.js";
import { figures, quantile, unpack } from "./numbers.js";
import { data } from "./page.js";
import { keyframes, shared, trajectory } from "./scene.js";
/** @import { ReadColour, Readout, RowPanel, Span } from "./types.js" */

export const STATE_NAMES = ["starting", "tracking", "lost"];

export const rows = {
  count: data.rows.count,
  frame: unpack(data.rows.frame, Float64Array),
  timestamp: unpack(data.rows.timestamp, Float64Array),
  state: unpack(data.rows.state, Uint8Array),
};

/** The panels: title, unit, values, colour variable, reference lines `[label, value]`. @returns {RowPanel[]} */
export function plotPanels() {
  /** @param {string} name @returns {Float32Array} */
  const column = (name) => unpack(data.rows[name], Float32Array);
  const ms = column("ms");
  const sorted = ms.filter(Number.isFinite).sort();
  const steps = rows.timestamp.slice(1).map((t, i) => t - rows.timestamp[i]).sort();
  /** @type {[label: string, value: number][]} */
  const references = [];
  if (sorted.length) references.push(["median", quantile(sorted, 0.5)], ["p99", quantile(sorted, 0.99)]);
  if (steps.length && quantile(steps, 0.5) > 0) references.push(["frame interval", quantile(steps, 0.5) * 1000]);
  return [
    { title: "Time per frame", unit: "ms", values: ms, colour: "--plot-1", references },
    { title: "Matched points", unit: "", values: column("matched_points"), colour: "--plot-2", references: [] },
    { title: "Inlier share", unit: "%", values: column("inlier_share").map((v) => v * 100), colour: "--plot-3", references: [], high: 100 },
    { title: "Photometric RMSE", unit: "grey levels", values: column("rmse"), colour: "--plot-4", references: [] },
  ].map((panel) => ({ ...panel, low: 0, high: panel.high || axisTop(panel.values) }));
}

/** The top of an axis from 0: all values, unless a few would flatten the others. @param {Float32Array} values */
export function axisTop(values) {
  const sorted = values.filter(Number.isFinite).sort();
  if (!sorted.length) return 1;
  const [most, high] = [sorted[sorted.length - 1], quantile(sorted, 0.985)];
  return (most > high * 3 ? high * 1.8 : most) * 1.08 || 1;
}

shared.framePointedAt = () => (shared.hoverAt === null ? -1 : trajectory.frame.indexOf(shared.hoverAt));
shared.placeOfTime = (_, [frame]) => (frame < 0 ? null : trajectory.frame[frame]);

/** The plots per frame. @extends {Chart<RowPanel>} */
export class Plots extends Chart {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    /** @type {Span} */
    const full = rows.count ? [rows.frame[0], Math.max(rows.frame[rows.count - 1], rows.frame[0] + 1)] : [0, 1];
    super(canvas, plotPanels(), full, PANEL.band, "frame");
    this.leastTick = 1;
  }

  /** The first row whose frame is not before `frame`. @param {number} frame */
  rowFrom(frame) {
    let low = 0, high = rows.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (rows.frame[middle] < frame) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The row nearest to a frame; −1 without rows. @param {number} frame */
  rowNear(frame) {
    const after = Math.min(this.rowFrom(frame), rows.count - 1);
    return after > 0 && frame - rows.frame[after - 1] < rows.frame[after] - frame ? after - 1 : after;
  }

  /** First and end of the rows within the range, and one more to either side. @returns {[number, number]} */
  shown() {
    return [Math.max(0, this.rowFrom(this.range[0]) - 1), Math.min(rows.count, this.rowFrom(this.range[1]) + 1)];
  }

  /** The row pointed at, or −1. */
  hovered() {
    return shared.hoverAt === null ? -1 : this.rowNear(shared.hoverAt);
  }

  /** @override @param {CanvasRenderingContext2D} context @param {RowPanel} panel @param {(value: number) => number} at @param {ReadColour} colour */
  drawCurves(context, panel, at, colour) {
    this.drawCurve(context, panel, at, this.shown(), colour(panel.colour));
    this.drawReferences(context, panel, at, colour);
    const hover = this.hovered();
    if (hover >= 0 && Number.isFinite(panel.values[hover])) this.drawDot(context, this.x(rows.frame[hover]), at(panel.values[hover]), colour(panel.colour));
  }

  /** @override @param {RowPanel} panel @param {ReadColour} colour @returns {Readout[]} */
  readout(panel, colour) {
    const hover = this.hovered();
    if (hover >= 0) return [[`${figures(panel.values[hover])}${panel.unit ? " " + panel.unit : ""}`, colour(panel.colour), 650]];
    const labels = panel.references.map(([label, value]) => `${label} ${figures(value)}`);
    return this.width > 560 ? [[labels.join("  ·  "), colour("--soft"), 400]] : [];
  }

  /** The curve; where many rows share a pixel, their span is drawn. Values off the scale get a tick on top. @param {CanvasRenderingContext2D} context @param {RowPanel} panel @param {(value: number) => number} at @param {Span} span @param {string} stroke */
  drawCurve(context, panel, at, [first, end], stroke) {
    context.strokeStyle = context.fillStyle = stroke;
    context.lineWidth = 1.4;
    context.lineJoin = "round";
    context.beginPath();
    let pen = false, column = -1, low = 0, high = 0;
    const flush = () => {
      if (column >= 0 && high > low) {
        context.moveTo(column, at(low));
        context.lineTo(column, at(high));
      }
    };
    const dense = (end - first) / this.width > 2;
    for (let i = first; i < end; i++) {
      const value = panel.values[i];
      const broken = !Number.isFinite(value) || (i > 0 && rows.frame[i] - rows.frame[i - 1] > 8 * this.usualStep());
      if (!Number.isFinite(value)) {
        pen = false;
        continue;
      }
      const x = dense ? Math.round(this.x(rows.frame[i])) : this.x(rows.frame[i]);
      if (dense && x === column) {
        [low, high] = [Math.min(low, value), Math.max(high, value)];
      } else {
        if (dense) flush();
        if (pen && !broken) context.lineTo(x, at(value));
        else context.moveTo(x, at(value));
        [column, low, high, pen] = [x, value, value, true];
        if (dense) context.moveTo(x, at(value));
      }
      if (value > panel.high) context.fillRect(x - 1, at(panel.high) - 5, 2, 4);
    }
    if (dense) flush();
    context.stroke();
  }

  /** The median step between frame indices of rows. @returns {number} */
  usualStep() {
    if (!this.step) {
      const steps = rows.frame.slice(1).map((f, i) => f - rows.frame[i]).sort();
      this.step = steps.length ? Math.max(1, quantile(steps, 0.5)) : 1;
    }
    return this.step;
  }

  /** Dashed reference lines within the scale. @param {CanvasRenderingContext2D} context @param {RowPanel} panel @param {(value: number) => number} at @param {ReadColour} colour */
  drawReferences(context, panel, at, colour) {
    const right = this.width - PANEL.right;
    context.save();
    context.strokeStyle = colour("--soft");
    context.globalAlpha = 0.7;
    context.setLineDash([3, 4]);
    panel.references.filter(([, value]) => value <= panel.high).forEach(([, value]) => {
      context.beginPath();
      context.moveTo(PANEL.left, at(value));
      context.lineTo(right, at(value));
      context.stroke();
    });
    context.restore();
  }

  /** State band and keyframe ticks, and the selected keyframe over all panels. @param {CanvasRenderingContext2D} context @param {ReadColour} colour */
  drawBelow(context, colour) {
    const [first, end] = this.shown();
    const y = this.bottom - PANEL.band, right = this.width - PANEL.right;
    context.save();
    context.beginPath();
    context.rect(PANEL.left, y - 6, right - PANEL.left, PANEL.band + 8);
    context.clip();
    const half = this.usualStep() / 2;
    for (let i = first; i < end;) {
      let next = i + 1;
      while (next < end && rows.state[next] === rows.state[i] && rows.frame[next] - rows.frame[next - 1] <= 8 * half) next++;
      const [x0, x1] = [this.x(rows.frame[i] - half), this.x(rows.frame[next - 1] + half)];
      context.fillStyle = colour(`--s${rows.state[i]}`);
      context.fillRect(x0, y, Math.max(1, x1 - x0), PANEL.band);
      i = next;
    }
    context.fillStyle = colour("--card");
    for (let i = 0; i < keyframes.count; i++) context.fillRect(Math.round(this.x(keyframes.frame[i])), y + PANEL.band / 2, 1, PANEL.band / 2);
    context.restore();
    this.write(context, "state", PANEL.left - 8, y + PANEL.band / 2, colour("--faint"), "right");
    if (shared.selected >= 0) this.drawUpright(context, this.x(keyframes.frame[shared.selected]), "#e0489f", []);
  }

  cursor() {
    const hover = this.hovered();
    if (hover < 0) return null;
    return { at: rows.frame[hover], text: `frame ${rows.frame[hover]}  ·  ${rows.timestamp[hover].toFixed(3)} s  ·  ${STATE_NAMES[rows.state[hover]]}` };
  }

  /** @param {number} frame */
  point(frame) {
    const row = this.rowNear(frame);
    if (row >= 0) shared.hover(rows.frame[row]);
  }

  /** @param {number} frame */
  pick(frame) {
    shared.select(keyframes.nearest(frame));
  }

  /** Arrow keys walk along the frames. @param {number} direction */
  walk(direction) {
    if (!rows.count) return;
    const row = shared.hoverAt === null ? 0 : this.rowNear(shared.hoverAt) + direction;
    shared.hover(rows.frame[Math.max(0, Math.min(rows.count - 1, row))]);
  }

  /** The shortest span worth a look. */
  least() {
    return 4;
  }
}
