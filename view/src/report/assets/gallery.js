// Key images with their inverse depth, the selected keyframe's card and the enlarged picture.

import { cloud } from "./cloud.js";
import { COLOURS } from "./colours.js";
import { figures, unpack } from "./numbers.js";
import { byId, contextOf, data, element, paintBar, parentOf } from "./page.js";
import { keyframes, lengthUnit, pictureImages, shared, takeImage } from "./scene.js";
/** @import { KeyImage } from "./types.js" */

/** @type {KeyImage[]} */
export const pictures = data.gallery;
pictures.forEach(takeImage);

/** Colour of each pixel with a depth (1–255), 0 elsewhere. @param {KeyImage} picture */
export function depthColours(picture) {
  if (picture.colours) return picture.colours;
  const pairs = unpack(picture.depth ?? "", Uint8Array), colours = new Uint8Array(picture.width * picture.height);
  let at = 0;
  for (let i = 0; i < pairs.length; i += 2) {
    at += pairs[i];
    if (pairs[i + 1]) colours[at] = pairs[i + 1];
  }
  Object.assign(picture, { colours, depth: null });
  return colours;
}

/** The picture with its depth on top, as children for a `.picture` element. @param {KeyImage} picture */
export function drawnPicture(picture) {
  const image = /** @type {HTMLImageElement} */ (pictureImages.get(picture.keyframe)?.cloneNode());
  image.alt = `Key image, frame ${keyframes.frame[picture.keyframe]}`;
  image.draggable = false;
  [image.width, image.height] = [picture.width, picture.height];
  const canvas = element("canvas");
  [canvas.width, canvas.height] = [picture.width, picture.height];
  const context = contextOf(canvas);
  const pixels = context.createImageData(picture.width, picture.height);
  depthColours(picture).forEach((colour, i) => {
    if (!colour) return;
    pixels.data.set(COLOURS.depth.subarray(colour * 3, colour * 3 + 3), i * 4);
    pixels.data[i * 4 + 3] = 255;
  });
  context.putImageData(pixels, 0, 0);
  return [image, canvas];
}

/** The depth at or next to a place of a picture, map units; `null` where none is known. @param {KeyImage} picture @param {number} x @param {number} y */
export function depthNear(picture, x, y) {
  const colours = depthColours(picture);
  let best = null, nearest = 10;
  for (let v = Math.max(0, y - 3); v <= Math.min(picture.height - 1, y + 3); v++) {
    for (let u = Math.max(0, x - 3); u <= Math.min(picture.width - 1, x + 3); u++) {
      const distance = (u - x) ** 2 + (v - y) ** 2, colour = colours[v * picture.width + u];
      if (colour && distance < nearest) [best, nearest] = [cloud.depth((colour - 1) / 254), distance];
    }
  }
  return best;
}

export class Gallery {
  constructor() {
    this.thumbs = pictures.map((picture) => this.thumb(picture));
    byId("strip").append(...this.thumbs);
    if (!pictures.length) byId("strip").append(element("p", "This map has no key images."));
    shared.onChange((what) => what === "selected" && this.show());
    paintBar(byId("depth-bar"), COLOURS.depth);
    byId("far").textContent = figures(cloud.depth(0));
    byId("near").textContent = figures(cloud.depth(1));
    parentOf(byId("depth-bar")).replaceChildren(byId("far"), byId("depth-bar"), byId("near"), element("span", `depth, ${lengthUnit()}`));
    /** The picture that is open large. @type {KeyImage | null} */
    this.large = null;
    this.bind();
  }

  /** @param {KeyImage} picture */
  thumb(picture) {
    const box = element("div", null, ...drawnPicture(picture));
    box.className = "picture";
    const index = picture.keyframe;
    const caption = element("span", null, element("b", `#${keyframes.id[index]}`), element("i", `${keyframes.timestamp[index].toFixed(2)} s`));
    const button = element("button", null, box, caption);
    button.type = "button";
    button.setAttribute("aria-pressed", "false");
    button.title = `Keyframe ${keyframes.id[index]}, frame ${keyframes.frame[index]}`;
    button.addEventListener("click", () => shared.select(index));
    button.addEventListener("dblclick", () => this.enlarge(picture));
    return button;
  }

  /** The selected keyframe's picture, or none. */
  current() {
    return pictures.find((p) => p.keyframe === shared.selected);
  }

  /** Fills the card and marks the thumbnail. */
  show() {
    const index = shared.selected, picture = this.current();
    byId("keyframe-title").textContent = `Keyframe ${keyframes.id[index]}`;
    const missing = element("p", "The report holds a choice of pictures; this keyframe's is not among them.");
    missing.className = "missing";
    byId("keyframe-picture").replaceChildren(...(picture ? drawnPicture(picture) : [missing]));
    byId("keyframe-picture").style.cursor = picture ? "" : "default";
    const centre = keyframes.column(index, 3).map((v) => figures(v)).join(", ");
    const area = keyframes.camera(index).width * keyframes.camera(index).height;
    const facts = [
      ["Frame", keyframes.frame[index].toLocaleString("en")],
      ["Time", `${keyframes.timestamp[index].toFixed(3)} s`],
      ["Pixels with depth", `${keyframes.depths[index].toLocaleString("en")} (${figures(keyframes.depths[index] / area * 100)} %)`],
      ["Position", centre],
    ];
    byId("keyframe-facts").replaceChildren(...facts.flatMap(([label, value]) => [element("dt", label), element("dd", value)]));
    byId("previous").disabled = index <= 0;
    byId("next").disabled = index >= keyframes.count - 1;
    pictures.forEach((p, i) => {
      const chosen = p.keyframe === index;
      this.thumbs[i].setAttribute("aria-pressed", String(chosen));
      if (chosen) this.reveal(this.thumbs[i]);
    });
  }

  /** Scrolls the strip, and only the strip, until a thumbnail is seen. @param {HTMLElement} thumb */
  reveal(thumb) {
    const strip = byId("strip");
    const left = thumb.offsetLeft - strip.offsetLeft, right = left + thumb.offsetWidth;
    if (left < strip.scrollLeft) strip.scrollLeft = left - 40;
    else if (right > strip.scrollLeft + strip.clientWidth) strip.scrollLeft = right - strip.clientWidth + 40;
  }

  /** Opens a picture large. @param {KeyImage} picture */
  enlarge(picture) {
    const dialog = byId("enlarged");
    this.large = picture;
    shared.select(picture.keyframe);
    byId("enlarged-title").textContent = `Keyframe ${keyframes.id[picture.keyframe]} · frame ${keyframes.frame[picture.keyframe]} · ${keyframes.timestamp[picture.keyframe].toFixed(3)} s`;
    byId("enlarged-value").textContent = "";
    byId("enlarged-picture").replaceChildren(...drawnPicture(picture));
    dialog.style.setProperty("--aspect", String(picture.width / picture.height));
    byId("enlarged-previous").disabled = picture === pictures[0];
    byId("enlarged-next").disabled = picture === pictures[pictures.length - 1];
    if (!dialog.open) dialog.showModal();
  }

  bind() {
    const overlay = byId("overlay"), dialog = byId("enlarged");
    const blend = () => {
      document.body.style.setProperty("--overlay", String(Number(overlay.value) / 100));
      byId("overlay-value").textContent = `${overlay.value} %`;
    };
    overlay.addEventListener("input", blend);
    blend();
    byId("keyframe-picture").addEventListener("click", () => {
      const picture = this.current();
      if (picture) this.enlarge(picture);
    });
    byId("previous").addEventListener("click", () => shared.select(shared.selected - 1));
    byId("next").addEventListener("click", () => shared.select(shared.selected + 1));
    /** @param {number} step */
    const turn = (step) => {
      const next = this.large && pictures[pictures.indexOf(this.large) + step];
      if (next) this.enlarge(next);
    };
    byId("enlarged-previous").addEventListener("click", () => turn(-1));
    byId("enlarged-next").addEventListener("click", () => turn(1));
    byId("enlarged-close").addEventListener("click", () => dialog.close());
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
    dialog.addEventListener("keydown", (event) => {
      if (event.key === "ArrowLeft") turn(-1);
      if (event.key === "ArrowRight") turn(1);
    });
    const large = byId("enlarged-picture");
    large.addEventListener("pointermove", (event) => {
      const box = large.getBoundingClientRect(), picture = this.large;
      if (!picture) return;
      const [x, y] = [(event.clientX - box.left) / box.width * picture.width, (event.clientY - box.top) / box.height * picture.height].map(Math.floor);
      const depth = depthNear(picture, x, y);
      byId("enlarged-value").textContent = `pixel ${x}, ${y}  ·  ${depth === null ? "no depth" : `depth ${figures(depth)}, inverse ${figures(1 / depth)}`}`;
    });
  }
}
