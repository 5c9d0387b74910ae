// What the panel offers beside views: measuring, cutting, and files of what is shown.

import { plyFile, tumFile } from "./files.js";
import { apart, boxEdges, common, cutOut, metresPerUnit } from "./measure.js";
import { figures } from "./numbers.js";
import { LINE_COLOURS } from "./overlays.js";
import { byId, data, element } from "./page.js";
import { Player } from "./player.js";
import { eachPoint } from "./points.js";
import { agents, lengthUnit, trajectory } from "./scene.js";
/** @import { Controls } from "./controls.js" */
/** @import { Place, Segment, Vector } from "./types.js" */
/** @import { Viewer } from "./viewer.js" */

/** The sides of the box that cuts, along the axes of the levelled world. */
const SIDES = ["Depth", "Width", "Height"];
const CUT_STEPS = 200;

/** Lets the browser write a file. @param {string} name @param {Blob | string | Uint8Array<ArrayBuffer>} content @param {string} [type] */
function download(name, content, type) {
  const blob = content instanceof Blob ? content : new Blob([content], { type });
  const address = URL["createObjectURL"](blob);
  Object.assign(element("a"), { href: address, download: name }).click();
  setTimeout(() => URL["revokeObjectURL"](address), 10000);
}

/** A file's name that tells whose it is. @param {string} what @param {string} ending */
const fileName = (what, ending) => `${(document.title.split(" · ")[0].split("/").pop() || "map").replace(/[^\w.-]+/g, "_")}-${what}.${ending}`;

/** Measuring between two points that are clicked, one after the other. */
class Ruler {
  /** @param {Controls} controls */
  constructor(controls) {
    this.controls = controls;
    /** Points of the world, two at most. @type {Vector[]} */
    this.points = [];
    /** How far they are apart. */
    this.straight = NaN;
    byId("measure").addEventListener("click", () => this.toggle());
    byId("measured-metres").addEventListener("input", () => this.showCommand());
    controls.viewer.canvas.addEventListener("keydown", (event) => {
      if (event.key === "m" && !event.ctrlKey && !event.metaKey && !event.altKey) this.toggle();
      else if (event.key === "Escape" && this.controls.taker) this.toggle();
    });
  }

  toggle() {
    const { controls } = this, on = !controls.taker;
    controls.taker = on ? (place) => this.take(place) : null;
    controls.viewer.canvas.classList.toggle("measuring", on);
    byId("measure").setAttribute("aria-pressed", String(on));
    byId("measured").hidden = !on;
    this.points = [];
    this.show();
  }

  /** A place on the canvas was clicked; says that nobody else is to take it. @param {Place} place */
  take(place) {
    const { viewer } = this.controls, point = viewer.pointAt(place);
    if (this.points.length === 2) this.points = [];
    if (point) this.points.push(viewer.scene.unlevel(point));
    this.show(point ? "" : "There is no point there. ");
    return true;
  }

  /** Draws what was clicked, and says how far it is apart. */
  show(before = "") {
    const { viewer } = this.controls, points = this.points.map((p) => viewer.scene.level(p));
    /** @type {Segment[]} */
    const segments = points.length === 2 ? [[points[0], points[1], LINE_COLOURS.measured]] : [];
    points.forEach((p) => segments.push(...this.cross(p)));
    viewer.setOverlay("measured", segments);
    byId("measured-known").hidden = points.length < 2 || data.scene.metric;
    if (points.length < 2) byId("measured-text").textContent = `${before}${points.length ? "Click the second point." : "Click the first point."}`;
    else {
      const { straight, level, up } = apart(points[0], points[1]);
      this.straight = straight;
      byId("measured-text").textContent = `${figures(straight)} ${lengthUnit()}  ·  level ${figures(level)}  ·  ${up < 0 ? "down" : "up"} ${figures(Math.abs(up))}`;
      document.documentElement.dataset.measured = String(straight);
    }
    this.showCommand();
  }

  /** Three short strokes through a point. @param {Vector} p @returns {Segment[]} */
  cross(p) {
    const size = this.controls.viewer.scene.size * 0.006;
    return [0, 1, 2].map((axis) => {
      /** @param {number} sign */
      const end = (sign) => p.map((v, i) => v + (i === axis ? sign * size : 0));
      return [end(-1), end(1), LINE_COLOURS.measured];
    });
  }

  /** How the map is brought to metres, once a true length is given. */
  showCommand() {
    const scale = this.points.length === 2 ? metresPerUnit(this.straight, Number(byId("measured-metres").value)) : null;
    byId("measured-command").hidden = scale === null || data.scene.metric;
    if (scale !== null) byId("measured-command").textContent = `loopbox export map.mcap --scale ${Number(scale.toPrecision(6))} --mcap metres.mcap`;
  }
}

/** A box by six sliders, outside of which nothing is drawn, found or written. */
class Cutter {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.sliders = SIDES.map((name) => {
      const [low, high] = [["from", 0], ["to", CUT_STEPS]].map(([end, value]) => {
        const slider = element("input");
        Object.assign(slider, { type: "range", min: 0, max: CUT_STEPS, value });
        slider.setAttribute("aria-label", `${name}, ${end}`);
        return slider;
      });
      low.addEventListener("input", () => Number(low.value) >= Number(high.value) && (low.value = String(Number(high.value) - 1)));
      high.addEventListener("input", () => Number(high.value) <= Number(low.value) && (high.value = String(Number(low.value) + 1)));
      const pair = element("div", null, element("span", name), low, high);
      pair.className = "pair";
      byId("cut-sides").append(pair);
      return [low, high];
    });
    this.sliders.flat().forEach((slider) => slider.addEventListener("input", () => this.apply()));
    const reset = element("button", "Whole");
    Object.assign(reset, { type: "button", title: "Cut nothing away" });
    reset.addEventListener("click", () => {
      this.sliders.forEach(([low, high]) => Object.assign(low, { value: 0 }) && Object.assign(high, { value: CUT_STEPS }));
      this.apply();
    });
    const row = element("div", null, reset);
    row.className = "buttons";
    byId("cut-sides").append(row);
  }

  apply() {
    const { viewer } = this, box = viewer.scene.whole;
    viewer.settings.cut = cutOut(box, this.sliders.map((pair) => pair.map((slider) => Number(slider.value) / CUT_STEPS)));
    const edges = viewer.settings.cut ? boxEdges(common(box, viewer.settings.cut)) : [];
    viewer.setOverlay("cut", edges.map(([a, b]) => [a, b, LINE_COLOURS.cut]));
    document.documentElement.dataset.cut = viewer.settings.cut ? "some" : "none";
  }
}

/** Writes what is shown: points, trajectories, the picture. */
class Saver {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    byId("save-cloud").addEventListener("click", () => this.saveCloud());
    byId("save-path").addEventListener("click", () => this.savePaths());
    byId("save-image").addEventListener("click", () => this.saveImage());
  }

  saveCloud() {
    const { viewer } = this, { sigma, cut } = viewer.settings;
    /** @type {Vector[]} */
    const places = [];
    /** @type {ArrayLike<number>[]} */
    const colours = [];
    eachPoint(viewer.blocks(), sigma, cut, (p, colour) => {
      places.push(viewer.scene.unlevel(p));
      colours.push(colour);
    });
    download(fileName("cloud", "ply"), plyFile(places, colours, `loopbox, ${lengthUnit()}`), "application/octet-stream");
    document.documentElement.dataset.saved = String(places.length);
  }

  savePaths() {
    const { viewer } = this, spans = viewer.frameSpans();
    viewer.shownAgents().filter((agent) => spans[agent][1] > spans[agent][0]).forEach((agent) => {
      const name = agents.length > 1 ? `trajectory-${agents[agent].name}` : "trajectory";
      download(fileName(name, "txt"), tumFile(trajectory, spans[agent][0], spans[agent][1]), "text/plain");
    });
  }

  saveImage() {
    this.viewer.image((blob) => blob && download(fileName("view", "png"), blob));
  }
}

/** All of them. */
export class Tools {
  /** @param {Controls} controls */
  constructor(controls) {
    const { viewer } = controls;
    this.ruler = new Ruler(controls);
    this.cutter = new Cutter(viewer);
    this.player = new Player(controls);
    this.saver = new Saver(viewer);
    // Another level or another box moves what was drawn in it.
    viewer.onSurvey = () => {
      this.ruler.show();
      this.cutter.apply();
    };
  }
}
