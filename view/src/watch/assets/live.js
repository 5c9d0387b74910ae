// Puts the page together.

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
    shared.onChange(() => viewer.redraw());
    return { viewer, controls };
  } catch (error) {
    byId("scene-failure").hidden = false;
    byId("scene-failure").textContent = `The 3-D view cannot start: ${error.message} The rest of the page does not need it.`;
    byId("controls").hidden = true;
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
  byId("scene-note").textContent = [
    `${(viewer.drawn || 0).toLocaleString("en")} of ${store.points.toLocaleString("en")} points drawn`,
    `${viewer.budget.ms.toFixed(0)} ms per image`,
    `grid spacing ${viewer.gridStep.toLocaleString("en", { maximumSignificantDigits: 1 })}`,
  ].join("  ·  ") + "\ndrag orbits  ·  right-drag pans  ·  wheel zooms  ·  double-click centres";
}

byId("mode").textContent = data.live ? "live" : "maps";
byId("side").hidden = !data.live;
byId("stage").classList.toggle("alone", !data.live);
prepareControls();
const { viewer, controls } = startLiveViewer();
let feed = null;
const panel = new Panel(() => feed);
const on3d = (action) => viewer && action();
const handlers = {
  reset: () => on3d(() => {
    viewer.surveyed = null;
    viewer.live = null;
    viewer.redoLines();
  }),
  level: () => {},
  keyframes: (slots) => on3d(() => viewer.moved(slots)),
  trajectory: (from) => on3d(() => viewer.createTrajectory(from)),
  edges: () => on3d(() => viewer.createEdges()),
  chunk: () => on3d(() => viewer.redraw()),
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
