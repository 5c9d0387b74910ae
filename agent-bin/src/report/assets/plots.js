// Plots per frame on one canvas: panels share the x axis; the state lies in a band below.

const STATE_NAMES = ["starting", "tracking", "lost"];
const PANEL = { height: 112, head: 24, gap: 6, left: 52, right: 14, band: 12, axis: 26 };

const rows = {
  count: data.rows.count,
  frame: unpack(data.rows.frame, Float64Array),
  timestamp: unpack(data.rows.timestamp, Float64Array),
  state: unpack(data.rows.state, Uint8Array),
};

/** The panels: title, unit, values, colour variable, reference lines `[label, value]`. */
function plotPanels() {
  const column = (name) => unpack(data.rows[name], Float32Array);
  const ms = column("ms");
  const sorted = ms.filter(Number.isFinite).sort();
  const steps = rows.timestamp.slice(1).map((t, i) => t - rows.timestamp[i]).sort();
  const references = [];
  if (sorted.length) references.push(["median", quantile(sorted, 0.5)], ["p99", quantile(sorted, 0.99)]);
  if (steps.length && quantile(steps, 0.5) > 0) references.push(["frame interval", quantile(steps, 0.5) * 1000]);
  return [
    { title: "Time per frame", unit: "ms", values: ms, colour: "--plot-1", references },
    { title: "Matched points", unit: "", values: column("matched_points"), colour: "--plot-2", references: [] },
    { title: "Inlier share", unit: "%", values: column("inlier_share").map((v) => v * 100), colour: "--plot-3", references: [], top: 100 },
    { title: "Photometric RMSE", unit: "grey levels", values: column("rmse"), colour: "--plot-4", references: [] },
  ].map((panel) => ({ ...panel, top: panel.top || axisTop(panel.values) }));
}

/** The top of an axis from 0: all values, unless a few would flatten the others. */
function axisTop(values) {
  const sorted = values.filter(Number.isFinite).sort();
  if (!sorted.length) return 1;
  const [most, high] = [sorted[sorted.length - 1], quantile(sorted, 0.985)];
  return (most > high * 3 ? high * 1.8 : most) * 1.08 || 1;
}

class Plots {
  constructor(canvas) {
    this.canvas = canvas;
    this.panels = plotPanels();
    this.full = rows.count ? [rows.frame[0], Math.max(rows.frame[rows.count - 1], rows.frame[0] + 1)] : [0, 1];
    this.range = this.full;
    this.height = this.panels.length * (PANEL.height + PANEL.gap) + PANEL.band + PANEL.axis + 4;
    canvas.style.height = `${this.height}px`;
    new ResizeObserver(() => this.redraw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    shared.onChange(() => this.redraw());
    this.bind();
  }

  redraw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.draw();
    });
  }

  x(frame) {
    return PANEL.left + ((frame - this.range[0]) / (this.range[1] - this.range[0])) * (this.width - PANEL.left - PANEL.right);
  }

  frameAt(x) {
    const t = (x - PANEL.left) / (this.width - PANEL.left - PANEL.right);
    return this.range[0] + Math.max(0, Math.min(1, t)) * (this.range[1] - this.range[0]);
  }

  /** The first row whose frame is not before `frame`. */
  rowFrom(frame) {
    let low = 0, high = rows.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (rows.frame[middle] < frame) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The row nearest to a frame; −1 without rows. */
  rowNear(frame) {
    const after = Math.min(this.rowFrom(frame), rows.count - 1);
    return after > 0 && frame - rows.frame[after - 1] < rows.frame[after] - frame ? after - 1 : after;
  }

  draw() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    this.width = canvas.clientWidth;
    if (!this.width) return;
    [canvas.width, canvas.height] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    context.font = `12px ${style.fontFamily}`;
    const shown = [Math.max(0, this.rowFrom(this.range[0]) - 1), Math.min(rows.count, this.rowFrom(this.range[1]) + 1)];
    const hover = shared.hoverFrame === null ? -1 : this.rowNear(shared.hoverFrame);
    this.panels.forEach((panel, i) => this.drawPanel(context, panel, i * (PANEL.height + PANEL.gap), shown, hover, colour));
    this.drawBand(context, shown, colour);
    this.drawCursor(context, hover, colour);
  }

  drawPanel(context, panel, y, shown, hover, colour) {
    const top = y + PANEL.head, bottom = y + PANEL.height;
    const at = (value) => bottom - Math.max(0, Math.min(1, value / panel.top)) * (bottom - top);
    const right = this.width - PANEL.right;
    context.textBaseline = "middle";
    this.drawScale(context, panel, at, right, colour);
    context.save();
    context.beginPath();
    context.rect(PANEL.left, top - 5, right - PANEL.left, bottom - top + 6);
    context.clip();
    this.drawCurve(context, panel, at, shown, colour(panel.colour));
    context.restore();
    const labels = this.drawReferences(context, panel, at, right, colour);
    const unit = panel.unit && ` · ${panel.unit}`;
    this.write(context, panel.title, PANEL.left, y + 11, colour("--text"), "left", 600);
    const titleWidth = this.textWidth(context, panel.title, 600);
    this.write(context, unit, PANEL.left + titleWidth, y + 11, colour("--soft"));
    if (hover >= 0) {
      this.write(context, `${figures(panel.values[hover])}${panel.unit ? " " + panel.unit : ""}`, right, y + 11, colour(panel.colour), "right", 650);
      context.fillStyle = colour(panel.colour);
      context.beginPath();
      if (Number.isFinite(panel.values[hover])) context.arc(this.x(rows.frame[hover]), at(panel.values[hover]), 3.5, 0, 7);
      context.fill();
    } else if (this.width > 560) {
      this.write(context, labels, right, y + 11, colour("--soft"), "right");
    }
  }

  drawScale(context, panel, at, right, colour) {
    const step = roundStep(panel.top / 2);
    context.strokeStyle = colour("--line");
    context.lineWidth = 1;
    for (let value = 0; value <= panel.top; value += step) {
      const y = Math.round(at(value)) + 0.5;
      context.beginPath();
      context.moveTo(PANEL.left, y);
      context.lineTo(right, y);
      context.stroke();
      this.write(context, value.toLocaleString("en", { maximumSignificantDigits: 3 }), PANEL.left - 8, y, colour("--faint"), "right");
    }
  }

  /** The curve; where many rows share a pixel, their span is drawn. Values off the scale get a tick on top. */
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
      if (value > panel.top) context.fillRect(x - 1, at(panel.top) - 5, 2, 4);
    }
    if (dense) flush();
    context.stroke();
  }

  /** The median step between frame indices of rows. */
  usualStep() {
    if (!this.step) {
      const steps = rows.frame.slice(1).map((f, i) => f - rows.frame[i]).sort();
      this.step = steps.length ? Math.max(1, quantile(steps, 0.5)) : 1;
    }
    return this.step;
  }

  /** Dashed reference lines within the scale; gives their values as text. */
  drawReferences(context, panel, at, right, colour) {
    context.save();
    context.strokeStyle = colour("--soft");
    context.globalAlpha = 0.7;
    context.setLineDash([3, 4]);
    panel.references.filter(([, value]) => value <= panel.top).forEach(([, value]) => {
      context.beginPath();
      context.moveTo(PANEL.left, at(value));
      context.lineTo(right, at(value));
      context.stroke();
    });
    context.restore();
    return panel.references.map(([label, value]) => `${label} ${figures(value)}`).join("  ·  ");
  }

  /** State band, keyframe ticks and the frame axis. */
  drawBand(context, [first, end], colour) {
    const y = this.panels.length * (PANEL.height + PANEL.gap) + 4, right = this.width - PANEL.right;
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
    const step = Math.max(1, roundStep((this.range[1] - this.range[0]) / Math.max(2, this.width / 160)));
    for (let frame = Math.ceil(this.range[0] / step) * step; frame <= this.range[1]; frame += step) {
      this.write(context, frame.toLocaleString("en"), this.x(frame), y + PANEL.band + 13, colour("--faint"), "center");
    }
    this.write(context, "frame", PANEL.left - 8, y + PANEL.band + 13, colour("--faint"), "right");
  }

  /** The frame pointed at, the selected keyframe and the span being dragged. */
  drawCursor(context, hover, colour) {
    const bottom = this.panels.length * (PANEL.height + PANEL.gap) + 4 + PANEL.band;
    const line = (x, stroke, dash) => {
      if (x < PANEL.left - 1 || x > this.width - PANEL.right + 1) return;
      context.strokeStyle = stroke;
      context.setLineDash(dash);
      context.beginPath();
      context.moveTo(Math.round(x) + 0.5, PANEL.head - 4);
      context.lineTo(Math.round(x) + 0.5, bottom);
      context.stroke();
      context.setLineDash([]);
    };
    if (shared.selected >= 0) line(this.x(keyframes.frame[shared.selected]), "#e0489f", []);
    if (this.dragFrom !== undefined && hover >= 0) {
      context.fillStyle = colour("--accent");
      context.globalAlpha = 0.12;
      const [a, b] = [this.x(this.dragFrom), this.x(this.dragTo)];
      context.fillRect(Math.min(a, b), PANEL.head - 4, Math.abs(b - a), bottom - PANEL.head + 4);
      context.globalAlpha = 1;
    }
    if (hover < 0) return;
    const x = this.x(rows.frame[hover]);
    line(x, colour("--soft"), [2, 3]);
    const text = `frame ${rows.frame[hover]}  ·  ${rows.timestamp[hover].toFixed(3)} s  ·  ${STATE_NAMES[rows.state[hover]]}`;
    const width = this.textWidth(context, text, 600) + 16;
    const left = Math.max(PANEL.left, Math.min(this.width - PANEL.right - width, x - width / 2));
    context.fillStyle = colour("--text");
    context.beginPath();
    context.roundRect(left, bottom + 3, width, 21, 5);
    context.fill();
    this.write(context, text, left + 8, bottom + 14, colour("--card"), "left", 600);
  }

  textWidth(context, text, weight) {
    context.font = context.font.replace(/^\d+ |^/, `${weight} `);
    const { width } = context.measureText(text);
    context.font = context.font.replace(/^\d+ /, "");
    return width;
  }

  write(context, text, x, y, fill, align = "left", weight = 400) {
    context.font = context.font.replace(/^\d+ (?=\d)|^/, `${weight} `);
    context.fillStyle = fill;
    context.textAlign = align;
    context.fillText(text, x, y);
    context.font = context.font.replace(/^\d+ (?=\d)/, "");
  }

  bind() {
    const { canvas } = this;
    const frameOf = (event) => this.frameAt(event.clientX - canvas.getBoundingClientRect().left);
    canvas.addEventListener("pointermove", (event) => {
      const row = this.rowNear(frameOf(event));
      if (this.dragFrom !== undefined) {
        this.dragTo = frameOf(event);
        this.redraw();
      }
      if (row >= 0) shared.hover(rows.frame[row]);
    });
    canvas.addEventListener("pointerleave", () => shared.hover(null));
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      if (event.pointerType === "mouse") canvas.setPointerCapture(event.pointerId);
      this.dragFrom = this.dragTo = frameOf(event);
    });
    const drop = (event) => {
      if (this.dragFrom === undefined) return;
      const [a, b] = [this.dragFrom, this.dragTo].sort((p, q) => p - q);
      this.dragFrom = undefined;
      if (event.type === "pointerup") {
        if (Math.abs(this.x(b) - this.x(a)) > 8) this.range = [a, Math.max(b, a + 4)];
        else shared.select(keyframes.nearest(a));
      }
      this.redraw();
    };
    canvas.addEventListener("pointerup", drop);
    canvas.addEventListener("pointercancel", drop);
    canvas.addEventListener("dblclick", () => {
      this.range = this.full;
      this.redraw();
    });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** Arrow keys walk along the frames. */
  key(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step || !rows.count) return;
    event.preventDefault();
    const row = shared.hoverFrame === null ? 0 : this.rowNear(shared.hoverFrame) + step;
    shared.hover(rows.frame[Math.max(0, Math.min(rows.count - 1, row))]);
  }
}
