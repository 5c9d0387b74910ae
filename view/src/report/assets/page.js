// The page's data, colours, and what is drawn on it.

/** @import { ElementOf } from "./types.js" */

/** The element of that name, which the page's HTML has. @template {string} I @param {I} id */
export const byId = (id) => /** @type {ElementOf<I>} */ (/** @type {unknown} */ (document.getElementById(id)));
/** The element around one that the page's HTML puts into another. @param {Element} node */
export const parentOf = (node) => /** @type {HTMLElement} */ (node.parentElement);
/** What the program hands to the page: each page has its own, and its scripts know which. */
export const data = JSON.parse(byId("data").textContent);

/** An element with text and children; text is never read as HTML. @template {keyof HTMLElementTagNameMap} K @param {K} tag @param {string | null} [text] @param {(Node | string)[]} children @returns {HTMLElementTagNameMap[K]} */
export function element(tag, text, ...children) {
  const node = document.createElement(tag);
  if (text !== undefined && text !== null) node.textContent = text;
  node.append(...children);
  return node;
}

/** What draws on a canvas. @param {HTMLCanvasElement} canvas */
export function contextOf(canvas) {
  const context = canvas.getContext("2d");
  if (!context) throw new Error("This browser draws on no more canvases.");
  return context;
}

/** Paints a table of colours along a canvas of 256 × 1 pixels. @param {HTMLCanvasElement} canvas @param {Uint8Array} table */
export function paintBar(canvas, table) {
  const context = contextOf(canvas);
  const image = context.createImageData(256, 1);
  for (let i = 0; i < 256; i++) {
    image.data.set(table.subarray(i * 3, i * 3 + 3), i * 4);
    image.data[i * 4 + 3] = 255;
  }
  context.putImageData(image, 0, 0);
}

/** Something drawn on a canvas, at most once for each image on the screen. */
export class Drawing {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.pending = false;
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  /** Draws; for those who extend it. */
  draw() {}

  /** Asks for a new image with the next animation frame. */
  redraw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.draw();
    });
  }
}
