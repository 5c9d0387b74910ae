// Mouse, touch, keys and the panel of the 3-D view.

import { OrbitCamera } from "./camera.js";
import { cloud } from "./cloud.js";
import { COLOURS } from "./colours.js";
import { figures } from "./numbers.js";
import { byId, data, element, paintBar, parentOf } from "./page.js";
import { agentColour, agents, keyframes, lengthUnit, shared } from "./scene.js";
import { Tools } from "./tools.js";
import { add, dot } from "./vectors.js";
import { Viewer } from "./viewer.js";
/** @import { Camera, CameraState, ControlsForm, NamedView, Place, SurveyedScene, Vector } from "./types.js" */

/** Pixels of width below which the panel is folded at first, and never moves the view aside. */
const NARROW = 640;

/** The values of the boxes of a name that are ticked. @param {HTMLFormElement} form @param {string} name */
const checked = (form, name) => new FormData(form).getAll(name).map(String);

/** The radio button of a way to colour. @param {ControlsForm} form @param {string} value */
const colourRadio = (form, value) => /** @type {HTMLInputElement} */ (form.querySelector(`[name=colour][value='${value}']`));

export class Controls {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    /** @type {Map<number, Place>} */
    this.pointers = new Map();
    /** Where the pointer was last seen, until that is looked at. @type {number[] | null} */
    this.hovered = null;
    /** Who takes clicks instead of the choice of keyframes, and says whether it did. @type {((place: number[]) => boolean) | null} */
    this.taker = null;
    /** The animation that moves the camera. */
    this.flight = 0;
    /** Whether the panel is folded. */
    this.folded = false;
    /** Pixels that the pointer went since it was put down. */
    this.moved = 0;
    this.bindPanel();
    this.bindPointers();
    this.bindKeys();
    this.untouched = true;
    this.fold(viewer.canvas.clientWidth <= NARROW);
    byId("fold").addEventListener("click", () => this.fold(!this.folded));
    new ResizeObserver(() => {
      viewer.covered = this.coveredWidth();
      if (this.untouched) Object.assign(viewer.camera, this.view("fit"));
      viewer.redraw();
    }).observe(viewer.canvas);
  }

  /** Pixels on the left under the panel; folded, and on narrow screens, it may cover what it covers. */
  coveredWidth() {
    const { folded } = this;
    return this.viewer.canvas.clientWidth > NARROW && !folded ? byId("controls").offsetWidth + 12 : 0;
  }

  /** Folds the panel, or unfolds it. @param {boolean} folded */
  fold(folded) {
    const { viewer } = this;
    this.folded = folded;
    byId("panel").hidden = folded;
    byId("controls").classList.toggle("folded", folded);
    byId("fold").setAttribute("aria-expanded", String(!folded));
    byId("fold").title = folded ? "Unfold the panel" : "Fold the panel";
    viewer.covered = this.coveredWidth();
    if (this.untouched) Object.assign(viewer.camera, this.view("fit"));
    viewer.redraw();
  }

  /** The camera state of a named view. @param {NamedView} name */
  view(name) {
    const { canvas, camera, scene } = this.viewer;
    const [azimuth, elevation] = { fit: [Math.PI + 0.45, 0.5], top: [Math.PI, 1.5607], side: [Math.PI, 0.03] }[name];
    return camera.fitted(scene.whole, azimuth, elevation, Math.max(0.2, (canvas.clientWidth - this.viewer.covered) / (canvas.clientHeight || 1)));
  }

  /** Moves the camera to a state, smoothly where motion is welcome. @param {CameraState} goal */
  go(goal) {
    const { viewer } = this;
    this.untouched = false;
    cancelAnimationFrame(this.flight);
    const start = viewer.camera.state(), begin = performance.now();
    const length = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : 450;
    /** @param {number} now */
    const step = (now) => {
      const t = length ? Math.min(1, Math.max(0, (now - begin) / length)) : 1;
      Object.assign(viewer.camera, OrbitCamera.between(start, goal, t * t * (3 - 2 * t)));
      viewer.redraw();
      if (t < 1) this.flight = requestAnimationFrame(step);
    };
    step(begin);
  }

  /** Looks out of the selected keyframe with its field of view. */
  lookThrough() {
    const { viewer } = this, index = shared.selected;
    if (index >= 0) this.lookOutOf(keyframes.camera(index), viewer.centre(index), viewer.scene.level(keyframes.column(index, 2)), false);
  }

  /** Looks out of a camera in the levelled world with its field of view, by a flight or at once. @param {Camera} camera @param {Vector} centre @param {Vector} forward @param {boolean} atOnce */
  lookOutOf({ width, height, fx, fy }, centre, forward, atOnce) {
    const { viewer } = this, { clientWidth, clientHeight } = viewer.canvas;
    const narrow = (clientWidth - viewer.covered) / clientHeight;
    const tan = Math.max(height / 2 / fy, width / 2 / fx / narrow) * 1.05;
    const goal = viewer.camera.through(centre, forward, viewer.frustumSize * 3, 2 * Math.atan(tan));
    if (!atOnce) return this.go(goal);
    this.untouched = false;
    cancelAnimationFrame(this.flight);
    Object.assign(viewer.camera, goal);
    return viewer.redraw();
  }

  bindPanel() {
    const { viewer } = this, form = byId("controls");
    form.addEventListener("submit", (event) => event.preventDefault());
    const { scene } = viewer, codes = cloud.value.filter((_, i) => i % 2 === 1);
    const span = codes.reduce(([low, high], c) => [Math.min(low, c), Math.max(high, c)], [255, 0]);
    const slider = byId("sigma");
    if (span[0] <= span[1]) [slider.min, slider.max, slider.value] = [span[0], span[1], span[1]].map(String);
    slider.disabled = span[0] >= span[1];
    this.withoutImages(form);
    if (cloud.color) this.offerColours();
    this.offerAgents(form);
    const read = () => {
      const { settings } = viewer;
      settings.colour = Number(form.elements.colour.value);
      settings.size = Number(byId("size").value);
      settings.sigma = Number(slider.value);
      settings.layers = new Set(checked(form, "layer"));
      const chosen = new Set(checked(form, "agent").map(Number));
      if (agents.length > 1 && [...agents.keys()].some((agent) => chosen.has(agent) !== settings.agents.has(agent))) {
        settings.agents = chosen;
        viewer.createEdges();
      }
      byId("size-value").textContent = String(settings.size);
      byId("sigma-value").textContent = `${figures(cloud.sigma(settings.sigma) * 100)} %`;
      showLegend(settings.colour, scene);
      viewer.redraw();
    };
    form.addEventListener("input", read);
    read();
    form.addEventListener("click", (event) => {
      const name = event.target instanceof HTMLElement ? event.target.dataset.view : undefined;
      if (name === "full") toggleFullScreen(byId("viewer"));
      else if (name) this.go(this.view(/** @type {NamedView} */ (name)));
    });
  }

  /** What only images have is not offered where there are LiDARs alone. @param {ControlsForm} form */
  withoutImages(form) {
    if (!agents.length || !agents.every((agent) => agent.isLidar)) return;
    form.querySelectorAll("[data-of=images]").forEach((node) => node instanceof HTMLElement && (node.hidden = true));
    form.elements.colour.value = "1";
  }

  /** Where images have colours, those are what is shown first of one agent. */
  offerColours() {
    const radio = colourRadio(byId("controls"), "5"), label = parentOf(radio);
    if (!label.hidden) return;
    label.hidden = false;
    if (agents.length > 1) return;
    radio.checked = true;
    radio.dispatchEvent(new Event("input", { bubbles: true }));
  }

  /** Several agents are told apart by colour and shown one by one. @param {ControlsForm} form */
  offerAgents(form) {
    const several = agents.length > 1, { elements } = form;
    byId("agents").querySelectorAll("label").forEach((label) => label.remove());
    byId("agents").hidden = !several;
    const byAgent = colourRadio(form, "4"), wasOffered = !parentOf(byAgent).hidden;
    parentOf(byAgent).hidden = !several;
    if (!several && byAgent.checked) elements.colour.value = "0";
    if (!several) return;
    byId("agents").append(...agents.map(({ name }, agent) => {
      const box = element("input"), swatch = element("span");
      Object.assign(box, { type: "checkbox", name: "agent", value: String(agent), checked: this.viewer.settings.agents.has(agent) });
      swatch.className = "swatch";
      swatch.style.background = agentColour(agent);
      const label = element("label", null, box, " ", swatch, name);
      label.title = name;
      return label;
    }));
    form.querySelectorAll("[value=closures]").forEach((box) => (parentOf(box).hidden = false));
    if (!wasOffered) byAgent.checked = true;
  }

  bindPointers() {
    const { viewer } = this, { canvas } = viewer;
    /** @param {MouseEvent} event */
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      cancelAnimationFrame(this.flight);
      if (!this.pointers.size) this.moved = 0;
      this.pointers.set(event.pointerId, place(event));
      canvas.classList.add("dragging");
    });
    canvas.addEventListener("pointermove", (event) => {
      const at = place(event);
      if (this.pointers.has(event.pointerId)) this.drag(event, at);
      else this.hover(at);
    });
    /** @param {PointerEvent} event */
    const release = (event) => {
      const at = this.pointers.get(event.pointerId);
      this.pointers.delete(event.pointerId);
      canvas.classList.toggle("dragging", this.pointers.size > 0);
      if (at && event.type === "pointerup" && event.button === 0 && this.moved < 4) this.click(at);
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("dblclick", (event) => this.taker || this.centreOn(place(event)));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
      this.zoom(Math.exp(Math.max(-200, Math.min(200, pixels)) * 0.0015), place(event));
    }, { passive: false });
  }

  /** The pointer is at a place: once for each image on the screen it is asked whether a keyframe is there. @param {Place} place */
  hover(place) {
    if (!this.hovered) {
      requestAnimationFrame(() => {
        if (this.hovered) this.viewer.canvas.classList.toggle("pointing", this.keyframeAt(this.hovered) >= 0);
        this.hovered = null;
      });
    }
    this.hovered = place;
  }

  /** A place was clicked: the keyframe there is selected. Tools may take it instead. @param {Place} place */
  click(place) {
    if (!this.taker || !this.taker(place)) shared.select(this.keyframeAt(place));
  }

  /** One pointer orbits (or pans with right button or shift); two pan and pinch. @param {PointerEvent} event @param {Place} at */
  drag(event, at) {
    const { viewer } = this, height = viewer.canvas.clientHeight;
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [at[0] - before[0], at[1] - before[1]];
    this.moved += Math.abs(dx) + Math.abs(dy);
    this.untouched = false;
    if (this.pointers.size === 1) {
      if (event.buttons & 2 || event.buttons & 4 || event.shiftKey) viewer.camera.pan(dx, dy, height);
      else viewer.camera.orbit(dx, dy);
    } else {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      /** @param {Place} p */
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      viewer.camera.pan(dx / 2, dy / 2, height);
      this.zoom(apart(before) / apart(at), [(at[0] + other[0]) / 2, (at[1] + other[1]) / 2]);
    }
    this.pointers.set(event.pointerId, at);
    viewer.redraw();
  }

  /** Zooms about a place on the canvas. @param {number} factor @param {number[]} place */
  zoom(factor, [x, y]) {
    const { viewer } = this, { clientWidth, clientHeight } = viewer.canvas;
    this.untouched = false;
    viewer.camera.zoom(factor, x - (clientWidth + viewer.covered) / 2, y - clientHeight / 2, clientHeight);
    viewer.redraw();
  }

  /** The keyframe drawn within a few pixels of a place, or −1. @param {number[]} place */
  keyframeAt([x, y]) {
    const { viewer } = this;
    if (!viewer.settings.layers.has("keyframes")) return -1;
    const matrix = viewer.matrix();
    let best = -1, nearest = 14;
    for (let i = 0; i < keyframes.count; i++) {
      if (!viewer.isShown(i)) continue;
      const p = viewer.project(matrix, viewer.centre(i));
      const distance = p ? Math.hypot(p[0] - x, p[1] - y) : Infinity;
      if (distance < nearest) [best, nearest] = [i, distance];
    }
    return best;
  }

  /** Makes the point that a place on the screen means the centre of orbits. @param {Place} place */
  centreOn(place) {
    const { viewer } = this, target = viewer.pointAt(place);
    if (!target) return;
    const distance = dot(add(viewer.camera.eye(), target, -1), viewer.camera.axes().back);
    this.go({ ...viewer.camera.state(), target, distance: Math.max(distance * 0.7, viewer.frustumSize) });
  }

  bindKeys() {
    const { viewer } = this;
    viewer.canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      /** @type {Record<string, NamedView | undefined>} */
      const views = { f: "fit", t: "top", s: "side" };
      const view = views[event.key];
      if (view) this.go(this.view(view));
      else if (event.key === "ArrowLeft") shared.select(shared.selected - 1);
      else if (event.key === "ArrowRight") shared.select(shared.selected + 1);
      else if (event.key === "+" || event.key === "-") this.zoom(event.key === "+" ? 0.85 : 1 / 0.85, [(viewer.canvas.clientWidth + viewer.covered) / 2, viewer.canvas.clientHeight / 2]);
      else return;
      event.preventDefault();
    });
  }
}

/** @param {HTMLElement} node */
export function toggleFullScreen(node) {
  if (document.fullscreenElement) document.exitFullscreen();
  else if (node.requestFullscreen) node.requestFullscreen().catch(() => {});
}

/** Explains the colours in use. @param {number} colour @param {SurveyedScene} scene */
export function showLegend(colour, scene) {
  /** @type {Record<number, [title: string, table: Uint8Array, ticks: string[]] | undefined>} */
  const legends = {
    1: [`Height, ${lengthUnit()}`, COLOURS.ordered, scene.heights.map((h) => figures(h))],
    2: [`Depth in its keyframe, ${lengthUnit()}`, COLOURS.depth, [0, 0.5, 1].map((t) => figures(cloud.depth(t)))],
    3: ["Relative σ of inverse depth", COLOURS.ordered, [1, 0.5, 0].map((t) => `${figures(cloud.sigma(scene.codes[0] + t * (scene.codes[1] - scene.codes[0])) * 100)} %`)],
  };
  const legend = legends[colour];
  byId("legend").hidden = !legend;
  byId("viewer").classList.toggle("has-legend", Boolean(legend));
  if (!legend) return;
  const [title, table, ticks] = legend;
  byId("legend-title").textContent = title;
  paintBar(byId("legend-bar"), table);
  byId("legend-ticks").replaceChildren(...ticks.map((t) => element("span", t)));
}

/** Says what is drawn, and how to move in it. @param {string[]} parts */
export function noteScene(parts) {
  const help = element("span", "drag orbits  ·  right-drag pans  ·  wheel zooms  ·  double-click centres");
  help.className = "help";
  byId("scene-note").replaceChildren(`${parts.join("  ·  ")}\n`, help);
}

/** Says that there is no 3-D view, and why. @param {unknown} error */
export function sceneFailed(error) {
  byId("scene-failure").hidden = false;
  byId("scene-failure").textContent = `The 3-D view cannot start: ${error instanceof Error ? error.message : error} The rest of the page does not need it.`;
  byId("controls").hidden = true;
}

/** The 3-D view, as its controls; nothing without WebGL: the rest of the page still serves. */
export function startViewer() {
  try {
    const viewer = new Viewer(byId("scene"));
    const controls = new Controls(viewer);
    noteScene([
      cloud.count < data.cloud.total ? `${cloud.count.toLocaleString("en")} of ${data.cloud.total.toLocaleString("en")} points` : `${cloud.count.toLocaleString("en")} points`,
      `${keyframes.count.toLocaleString("en")} keyframes`,
      `grid spacing ${viewer.gridStep.toLocaleString("en", { maximumSignificantDigits: 1 })}${data.scene.metric ? " m" : ""}`,
    ]);
    new Tools(controls);
    shared.onChange((what) => (what === "selected" ? viewer.selectionChanged() : viewer.redraw()));
    return controls;
  } catch (error) {
    sceneFailed(error);
    return null;
  }
}
