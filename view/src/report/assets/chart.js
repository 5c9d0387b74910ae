// Panels of plots on one canvas that share the x axis.

import { roundStep } from "./numbers.js";
import { Drawing, contextOf } from "./page.js";
import { shared } from "./scene.js";
/** @import { Panel, ReadColour, Readout, Span } from "./types.js" */

export const PANEL = { height: 112, head: 24, gap: 6, left: 52, right: 14, band: 12, axis: 26 };

/** Draws panels. What is plotted, what lies below and what pointing does is for those who extend it. @template {Panel} P */
export class Chart extends Drawing {
  /** `full` is the span of x; `below` the pixels between the panels and the axis; `axis` the name of x. @param {HTMLCanvasElement} canvas @param {P[]} panels @param {Span} full @param {number} below @param {string} axis */
  constructor(canvas, panels, full, below, axis) {
    super(canvas);
    this.panels = panels;
    this.full = full;
    /** The span of x that is shown. @type {Span} */
    this.range = full;
    this.axis = axis;
    this.leastTick = 0;
    /** Pixels; 0 before it is first drawn. */
    this.width = 0;
    /** Where the span being dragged begins and ends. @type {Span | null} */
    this.dragged = null;
    this.bottom = panels.length * (PANEL.height + PANEL.gap) + 4 + below;
    this.height = this.bottom + PANEL.axis;
    canvas.style.height = `${this.height}px`;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    shared.onChange(() => this.redraw());
    this.bind();
  }

  /** Shows a span of x. @param {Span} range */
  show(range) {
    this.range = range;
    this.redraw();
  }

  /** @param {number} value */
  x(value) {
    return PANEL.left + ((value - this.range[0]) / (this.range[1] - this.range[0])) * (this.width - PANEL.left - PANEL.right);
  }

  /** @param {number} x */
  valueAt(x) {
    const t = (x - PANEL.left) / (this.width - PANEL.left - PANEL.right);
    return this.range[0] + Math.max(0, Math.min(1, t)) * (this.range[1] - this.range[0]);
  }

  draw() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    this.width = canvas.clientWidth;
    if (!this.width) return;
    [canvas.width, canvas.height] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    const context = contextOf(canvas);
    context.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    /** @param {string} name */
    const colour = (name) => style.getPropertyValue(name).trim();
    context.font = `12px ${style.fontFamily}`;
    this.panels.forEach((panel, i) => this.drawPanel(context, panel, i * (PANEL.height + PANEL.gap), colour));
    this.drawBelow(context, colour);
    this.drawAxis(context, colour);
    this.drawCursor(context, colour);
  }

  /** @param {CanvasRenderingContext2D} context @param {P} panel @param {number} y @param {ReadColour} colour */
  drawPanel(context, panel, y, colour) {
    const top = y + PANEL.head, bottom = y + PANEL.height, right = this.width - PANEL.right;
    /** @param {number} value */
    const at = (value) => bottom - Math.max(0, Math.min(1, (value - panel.low) / (panel.high - panel.low))) * (bottom - top);
    context.textBaseline = "middle";
    this.drawScale(context, panel, at, right, colour);
    context.save();
    context.beginPath();
    context.rect(PANEL.left, top - 5, right - PANEL.left, bottom - top + 6);
    context.clip();
    this.drawCurves(context, panel, at, colour);
    context.restore();
    const unit = panel.unit && ` · ${panel.unit}`;
    this.write(context, panel.title, PANEL.left, y + 11, colour("--text"), "left", 600);
    this.write(context, unit, PANEL.left + this.textWidth(context, panel.title, 600), y + 11, colour("--soft"));
    let end = right;
    for (const [text, fill, weight] of this.readout(panel, colour).reverse()) {
      this.write(context, text, end, y + 11, fill, "right", weight);
      end -= this.textWidth(context, text, weight) + 14;
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {P} panel @param {(value: number) => number} at @param {number} right @param {ReadColour} colour */
  drawScale(context, panel, at, right, colour) {
    const step = roundStep((panel.high - panel.low) / 2);
    context.strokeStyle = colour("--line");
    context.lineWidth = 1;
    for (let k = Math.ceil(panel.low / step - 1e-9) + 0; k * step <= panel.high; k++) {
      const y = Math.round(at(k * step)) + 0.5;
      context.beginPath();
      context.moveTo(PANEL.left, y);
      context.lineTo(right, y);
      context.stroke();
      this.write(context, (k * step).toLocaleString("en", { maximumSignificantDigits: 3 }), PANEL.left - 8, y, colour("--faint"), "right");
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {ReadColour} colour */
  drawAxis(context, colour) {
    const step = Math.max(this.leastTick, roundStep((this.range[1] - this.range[0]) / Math.max(2, this.width / 160)));
    for (let k = Math.ceil(this.range[0] / step - 1e-9) + 0; k * step <= this.range[1]; k++) {
      this.write(context, (k * step).toLocaleString("en"), this.x(k * step), this.bottom + 13, colour("--faint"), "center");
    }
    this.write(context, this.axis, PANEL.left - 8, this.bottom + 13, colour("--faint"), "right");
  }

  /** A line over all panels. @param {CanvasRenderingContext2D} context @param {number} x @param {string} stroke @param {number[]} dash */
  drawUpright(context, x, stroke, dash) {
    if (x < PANEL.left - 1 || x > this.width - PANEL.right + 1) return;
    context.strokeStyle = stroke;
    context.lineWidth = 1;
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(Math.round(x) + 0.5, PANEL.head - 4);
    context.lineTo(Math.round(x) + 0.5, this.bottom);
    context.stroke();
    context.setLineDash([]);
  }

  /** The place pointed at, with its label, and the span being dragged. @param {CanvasRenderingContext2D} context @param {ReadColour} colour */
  drawCursor(context, colour) {
    if (this.dragged) {
      context.fillStyle = colour("--accent");
      context.globalAlpha = 0.12;
      const [a, b] = this.dragged.map((value) => this.x(value));
      context.fillRect(Math.min(a, b), PANEL.head - 4, Math.abs(b - a), this.bottom - PANEL.head + 4);
      context.globalAlpha = 1;
    }
    const cursor = this.cursor();
    if (!cursor) return;
    const x = this.x(cursor.at);
    this.drawUpright(context, x, colour("--soft"), [2, 3]);
    const width = this.textWidth(context, cursor.text, 600) + 16;
    const left = Math.max(PANEL.left, Math.min(this.width - PANEL.right - width, x - width / 2));
    context.fillStyle = colour("--text");
    context.beginPath();
    context.roundRect(left, this.bottom + 3, width, 21, 5);
    context.fill();
    this.write(context, cursor.text, left + 8, this.bottom + 14, colour("--card"), "left", 600);
  }

  /** A dot on a curve. @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {string} fill */
  drawDot(context, x, y, fill) {
    context.fillStyle = fill;
    context.beginPath();
    context.arc(x, y, 3.5, 0, 7);
    context.fill();
  }

  /** @param {CanvasRenderingContext2D} context @param {string} text @param {number} weight */
  textWidth(context, text, weight) {
    context.font = context.font.replace(/^\d+ (?=\d)|^/, `${weight} `);
    const { width } = context.measureText(text);
    context.font = context.font.replace(/^\d+ (?=\d)/, "");
    return width;
  }

  /** @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y @param {string} fill @param {CanvasTextAlign} align */
  write(context, text, x, y, fill, align = "left", weight = 400) {
    context.font = context.font.replace(/^\d+ (?=\d)|^/, `${weight} `);
    context.fillStyle = fill;
    context.textAlign = align;
    context.fillText(text, x, y);
    context.font = context.font.replace(/^\d+ (?=\d)/, "");
  }

  bind() {
    const { canvas } = this;
    /** @param {PointerEvent} event */
    const valueOf = (event) => this.valueAt(event.clientX - canvas.getBoundingClientRect().left);
    canvas.addEventListener("pointermove", (event) => {
      if (this.dragged) {
        this.dragged = [this.dragged[0], valueOf(event)];
        this.redraw();
      }
      this.point(valueOf(event));
    });
    canvas.addEventListener("pointerleave", () => shared.hover(null));
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      if (event.pointerType === "mouse") canvas.setPointerCapture(event.pointerId);
      this.dragged = [valueOf(event), valueOf(event)];
    });
    /** @param {PointerEvent} event */
    const drop = (event) => {
      if (!this.dragged) return;
      const [a, b] = this.dragged.sort((p, q) => p - q);
      this.dragged = null;
      if (event.type === "pointerup") {
        if (Math.abs(this.x(b) - this.x(a)) > 8) this.range = [a, Math.max(b, a + this.least())];
        else this.pick(a);
      }
      this.redraw();
    };
    canvas.addEventListener("pointerup", drop);
    canvas.addEventListener("pointercancel", drop);
    canvas.addEventListener("dblclick", () => {
      this.range = this.full;
      this.redraw();
    });
    canvas.addEventListener("keydown", (event) => {
      const direction = event.key === "ArrowLeft" ? -1 : event.key === "ArrowRight" ? 1 : 0;
      if (!direction) return;
      event.preventDefault();
      this.walk(direction);
    });
  }

  // What is for those who extend it.

  /** Draws a panel's curves; `at` gives the height of a value. @param {CanvasRenderingContext2D} _context @param {P} _panel @param {(value: number) => number} _at @param {ReadColour} _colour */
  drawCurves(_context, _panel, _at, _colour) {}

  /** What a panel says at its right: `[text, colour, weight]` each. @returns {Readout[]} @param {P} _panel @param {ReadColour} _colour */
  readout(_panel, _colour) {
    return [];
  }

  /** Draws what lies below the panels. @param {CanvasRenderingContext2D} _context @param {ReadColour} _colour */
  drawBelow(_context, _colour) {}

  /** The place pointed at. @returns {{ at: number, text: string } | null} */
  cursor() {
    return null;
  }

  /** The pointer is at a value of x. @param {number} _value */
  point(_value) {}

  /** A value of x was clicked. @param {number} _value */
  pick(_value) {}

  /** An arrow key was pressed. @param {number} _direction */
  walk(_direction) {}

  /** The shortest span worth a look. */
  least() {
    return 0;
  }
}
