// The page's data, colours, and what is drawn on it.

export const data = JSON.parse(document.getElementById("data").textContent);
/** The element of that name; which kind it is, the page's HTML says. @param {string} id @returns {any} */
export const byId = (id) => document.getElementById(id);

/** An element with text and children; text is never read as HTML. */
export function element(tag, text, ...children) {
  const node = document.createElement(tag);
  if (text !== undefined && text !== null) node.textContent = text;
  node.append(...children);
  return node;
}

/** Paints a table of colours along a canvas of 256 × 1 pixels. */
export function paintBar(canvas, table) {
  const context = canvas.getContext("2d");
  const image = context.createImageData(256, 1);
  for (let i = 0; i < 256; i++) {
    image.data.set(table.subarray(i * 3, i * 3 + 3), i * 4);
    image.data[i * 4 + 3] = 255;
  }
  context.putImageData(image, 0, 0);
}

/** Something drawn on a canvas, at most once for each image on the screen. */
export class Drawing {
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
