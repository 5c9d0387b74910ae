// Puts the page together.

import { noteScene, sceneFailed } from "../../report/assets/controls.js";
import { byId, data, parentOf } from "../../report/assets/page.js";
import { agents, setAgents, shared } from "../../report/assets/scene.js";
import { Tools } from "../../report/assets/tools.js";
import { add } from "../../report/assets/vectors.js";
import { Feed } from "./feed.js";
import { Panel } from "./panel.js";
import { forget, place, setChunk, setSteps, store } from "./store.js";
import { LiveControls, LiveViewer } from "./view.js";
/** @import { ToldAgent, Vector } from "../../report/assets/types.js" */
/** @import { Chunk, LivePictureMessage, PlacedKeyframe, Steps } from "./decode.js" */
/** @import { Handlers, Status } from "./types.js" */

/** Prepares the viewer's panel for a scene that is still to come. */
function prepareControls() {
  data.cloud.sigma = data.sigma;
  document.querySelectorAll("[name=layer][value=edges], [name=layer][value=picture]").forEach((box) => parentOf(box).remove());
  document.querySelectorAll("[name=layer][value=closures]").forEach((box) => (parentOf(box).hidden = false));
}

/** Points below a σ of 10 %, as the server sends them. @param {LiveControls} controls */
function prepareSigma(controls) {
  const slider = byId("sigma");
  Object.assign(slider, { min: "0", max: "171", value: "171", disabled: false });
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  return controls;
}

/** The 3-D view with its controls. @typedef {{ viewer: LiveViewer, controls: LiveControls }} LiveView */

/** Starts it; nothing without WebGL. @returns {LiveView | null} */
function startLiveViewer() {
  try {
    const viewer = new LiveViewer(byId("scene"));
    const controls = prepareSigma(new LiveControls(viewer));
    new Tools(controls);
    shared.onChange(() => viewer.redraw());
    return { viewer, controls };
  } catch (error) {
    sceneFailed(error);
    return null;
  }
}

/** Looks at the whole scene as long as nobody has looked elsewhere. @param {LiveViewer} viewer @param {LiveControls} controls */
function keepFitted(viewer, controls) {
  if (!viewer.surveyWhenGrown()) return;
  viewer.setCamera(viewer.live);
  if (controls.untouched && !byId("follow").checked) {
    controls.go(controls.view("fit"));
    controls.untouched = true;
  }
}

/** Moves the centre of the view along with the live camera. @param {LiveViewer} viewer @param {number[] | null} camera */
function follow(viewer, camera) {
  if (!byId("follow").checked || !camera) return;
  const target = viewer.scene.level(camera.slice(9, 12));
  viewer.camera.target = add(viewer.camera.target, add(target, viewer.camera.target, -1), 0.2);
}

/** @param {LiveViewer} viewer */
function note(viewer) {
  noteScene([
    `${(viewer.drawn || 0).toLocaleString("en")} of ${store.points.toLocaleString("en")} points drawn`,
    `${viewer.budget.ms.toFixed(0)} ms per image`,
    `grid spacing ${viewer.gridStep.toLocaleString("en", { maximumSignificantDigits: 1 })}${data.scene.metric ? " m" : ""}`,
  ]);
}

/** @type {Record<string, string>} */
const MODES = { live: "live", service: "agent", maps: "maps", station: "station" };
byId("mode").textContent = MODES[data.mode];
byId("side").hidden = data.mode === "maps";
byId("stage").classList.toggle("alone", data.mode === "maps");
/** Whether a part of what a run has is shown. @param {Element} part */
const ofRun = (part) => data.mode === "live" || (data.mode === "service" && !part.classList.contains("commands"));
document.querySelectorAll(".of-run").forEach((part) => part.classList.toggle("absent", !ofRun(part)));
prepareControls();
const view3d = startLiveViewer();
/** Does something with the 3-D view, where there is one. @param {(view: LiveView) => void} action */
const on3d = (action) => view3d && action(view3d);
const panel = new Panel();
/** @type {Handlers} */
const handlers = {
  reset: (/** @type {{ scene: { agents: ToldAgent[], metric: boolean } }} */ { scene }) => {
    const before = agents.map(({ name }) => name);
    setAgents(scene.agents);
    data.scene.metric = scene.metric;
    forget();
    on3d(({ viewer, controls }) => {
      viewer.surveyed = null;
      viewer.live = null;
      if (before.join("\n") !== agents.map(({ name }) => name).join("\n")) {
        viewer.agentsChanged(before);
        controls.agentsChanged();
      }
      viewer.redoLines();
    });
  },
  level: (/** @type {{ up: Vector, forward: Vector }} */ { up, forward }) => Object.assign(data.scene, { up, forward }),
  keyframes: (/** @type {PlacedKeyframe[]} */ placed) => {
    const slots = placed.map(place);
    on3d(({ viewer }) => viewer.moved(slots));
  },
  trajectory: (/** @type {Steps} */ steps) => {
    const from = setSteps(steps);
    on3d(({ viewer }) => viewer.createTrajectory(from));
  },
  edges: (/** @type {Uint32Array<ArrayBuffer>} */ edges) => {
    store.edges = edges;
    on3d(({ viewer }) => viewer.createEdges());
  },
  chunk: (/** @type {Chunk} */ chunk) => {
    setChunk(chunk);
    on3d(({ viewer, controls }) => {
      if (chunk.colours) controls.offerColours();
      viewer.redraw();
    });
  },
  picture: (/** @type {LivePictureMessage} */ picture) => panel.picture.show(picture),
  link: (/** @type {boolean} */ open) => panel.link(open),
  status: (/** @type {{ status: Status }} */ { status }) => {
    panel.show(status);
    on3d(({ viewer }) => {
      viewer.setCamera(status.camera);
      follow(viewer, status.camera);
    });
  },
};
panel.obey(new Feed(handlers));
if (view3d) setInterval(() => {
  keepFitted(view3d.viewer, view3d.controls);
  note(view3d.viewer);
}, 250);
// For tests: what works.
document.documentElement.dataset.page = view3d ? "complete" : "without-3d";
