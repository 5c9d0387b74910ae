// Puts the page together.

function fillTables() {
  const row = ([label, value]) => {
    const head = element("th", label);
    head.scope = "row";
    return element("tr", null, head, element("td", value));
  };
  byId("numbers").append(...data.numbers.map(row));
  byId("provenance").append(...data.provenance.map(row));
  byId("provenance-card").hidden = !data.provenance.length;
  byId("tiles").append(...data.numbers.slice(0, 6).map(([label, value]) => element("div", null, element("dt", label), element("dd", value))));
}

/** The 3-D view; without WebGL the rest of the page still serves. */
function startViewer() {
  try {
    const viewer = new Viewer(byId("scene"));
    const controls = new Controls(viewer);
    byId("scene-note").textContent = [
      cloud.count < data.cloud.total ? `${cloud.count.toLocaleString("en")} of ${data.cloud.total.toLocaleString("en")} points` : `${cloud.count.toLocaleString("en")} points`,
      `${keyframes.count.toLocaleString("en")} keyframes`,
      `grid spacing ${viewer.gridStep.toLocaleString("en", { maximumSignificantDigits: 1 })}`,
    ].join("  ·  ") + "\ndrag orbits  ·  right-drag pans  ·  wheel zooms  ·  double-click centres";
    byId("look").addEventListener("click", () => controls.lookThrough());
    byId("isolate").addEventListener("click", (event) => {
      viewer.settings.isolate = !viewer.settings.isolate;
      event.currentTarget.setAttribute("aria-pressed", viewer.settings.isolate);
      viewer.redraw();
    });
    shared.onChange((what) => (what === "selected" ? viewer.selectionChanged() : viewer.redraw()));
    return true;
  } catch (error) {
    byId("scene-failure").hidden = false;
    byId("scene-failure").textContent = `The 3-D view cannot start: ${error.message} The pictures, plots and numbers below do not need it.`;
    byId("controls").hidden = byId("look").hidden = byId("isolate").hidden = true;
    return false;
  }
}

fillTables();
const shows = startViewer();
new Gallery();
new Plots(byId("plots"));
shared.select(pictures.length ? pictures[Math.floor((pictures.length - 1) / 2)].keyframe : 0);
// For tests: what works.
document.documentElement.dataset.report = shows ? "complete" : "without-3d";
