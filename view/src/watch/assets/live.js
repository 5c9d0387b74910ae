// Puts the page together.

import { noteScene, sceneFailed } from "../../report/assets/controls.js";
import { byId, data } from "../../report/assets/page.js";
import { agents, setAgents, shared } from "../../report/assets/scene.js";
import { Tools } from "../../report/assets/tools.js";
import { add } from "../../report/assets/vectors.js";
import { Feed } from "./feed.js";
import { Panel } from "./panel.js";
import { forget, place, setChunk, setSteps, store } from "./store.js";
import { LiveControls, LiveViewer } from "./view.js";

/** Prepares the viewer's panel for a scene that is still to come. */
function prepareControls() {
  data.cloud.sigma = data.sigma;
  document.querySelectorAll("[name=layer][value=edges], [name=layer][value=picture]").forEach((box) => box.parentElement.remove());
  const closures = document.querySelector("[name=layer][value=closures]");
  closures.parentElement.hidden = false;
}

/** Points below a σ of 10 %, as the server sends them. */
function prepareSigma(controls) {
  const slider = byId("sigma");
  Object.assign(slider, { min: 0, max: 171, value: 171, disabled: false });
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  return controls;
}

function startLiveViewer() {
  try {
    const viewer = new LiveViewer(byId("scene"));
    const controls = prepareSigma(new LiveControls(viewer));
    new Tools(controls);
    shared.onChange(() => viewer.redraw());
    return { viewer, controls };
  } catch (error) {
    sceneFailed(error);
    return { viewer: null, controls: null };
  }
}

/** Looks at the whole scene as long as nobody has looked elsewhere. */
function keepFitted(viewer, controls) {
  if (!viewer.surveyWhenGrown()) return;
  viewer.setCamera(viewer.live);
  if (controls.untouched && !byId("follow").checked) {
    controls.go(controls.view("fit"));
    controls.untouched = true;
  }
}

/** Moves the centre of the view along with the live camera. */
function follow(viewer, camera) {
  if (!byId("follow").checked || !camera) return;
  const target = viewer.scene.level(camera.slice(9, 12));
  viewer.camera.target = add(viewer.camera.target, add(target, viewer.camera.target, -1), 0.2);
}

function note(viewer) {
  noteScene([
    `${(viewer.drawn || 0).toLocaleString("en")} of ${store.points.toLocaleString("en")} points drawn`,
    `${viewer.budget.ms.toFixed(0)} ms per image`,
    `grid spacing ${viewer.gridStep.toLocaleString("en", { maximumSignificantDigits: 1 })}${data.scene.metric ? " m" : ""}`,
  ]);
}

const MODES = { live: "live", service: "agent", maps: "maps", station: "station" };
byId("mode").textContent = MODES[data.mode];
byId("side").hidden = data.mode === "maps";
byId("stage").classList.toggle("alone", data.mode === "maps");
const ofRun = { live: () => true, service: (part) => !part.classList.contains("commands") }[data.mode] ?? (() => false);
document.querySelectorAll(".of-run").forEach((part) => part.classList.toggle("absent", !ofRun(part)));
prepareControls();
const { viewer, controls } = startLiveViewer();
let feed = null;
const panel = new Panel(() => feed);
const on3d = (action) => viewer && action();
const handlers = {
  reset: ({ scene }) => {
    const before = agents.map(({ name }) => name);
    setAgents(scene.agents);
    data.scene.metric = scene.metric;
    forget();
    on3d(() => {
      viewer.surveyed = null;
      viewer.live = null;
      if (before.join("\n") !== agents.map(({ name }) => name).join("\n")) {
        viewer.agentsChanged(before);
        controls.agentsChanged();
      }
      viewer.redoLines();
    });
  },
  level: ({ up, forward }) => Object.assign(data.scene, { up, forward }),
  keyframes: (placed) => {
    const slots = placed.map(place);
    on3d(() => viewer.moved(slots));
  },
  trajectory: (steps) => {
    const from = setSteps(steps);
    on3d(() => viewer.createTrajectory(from));
  },
  edges: (edges) => {
    store.edges = edges;
    on3d(() => viewer.createEdges());
  },
  chunk: (chunk) => {
    setChunk(chunk);
    on3d(() => {
      if (chunk.colours) controls.offerColours();
      viewer.redraw();
    });
  },
  picture: (picture) => panel.picture.show(picture),
  link: (open) => panel.link(open),
  status: ({ status }) => {
    panel.show(status);
    on3d(() => {
      viewer.setCamera(status.camera);
      follow(viewer, status.camera);
    });
  },
};
feed = new Feed((kind, value) => handlers[kind] && handlers[kind](value));
if (viewer) setInterval(() => {
  keepFitted(viewer, controls);
  note(viewer);
}, 250);
// For tests: what works.
document.documentElement.dataset.page = viewer ? "complete" : "without-3d";
