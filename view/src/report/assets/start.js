// Puts the page together.

import { startViewer } from "./controls.js";
import { Gallery, pictures } from "./gallery.js";
import { provenanceInWords } from "./numbers.js";
import { byId, data, element } from "./page.js";
import { Plots } from "./plots.js";
import { shared } from "./scene.js";

function fillTables() {
  const row = ([label, value]) => {
    const head = element("th", label);
    head.scope = "row";
    return element("tr", null, head, element("td", value));
  };
  byId("numbers").append(...data.numbers.map(row));
  byId("provenance").append(...data.provenance.map(provenanceInWords).map(row));
  byId("provenance-card").hidden = !data.provenance.length;
  byId("tiles").append(...data.numbers.slice(0, 6).map(([label, value]) => element("div", null, element("dt", label), element("dd", value))));
}

/** What the keyframe's card does with the 3-D view. */
function bindCard(controls) {
  const { viewer } = controls;
  byId("look").addEventListener("click", () => controls.lookThrough());
  byId("isolate").addEventListener("click", (event) => {
    viewer.settings.isolate = !viewer.settings.isolate;
    event.currentTarget.setAttribute("aria-pressed", viewer.settings.isolate);
    viewer.redraw();
  });
}

fillTables();
const controls = startViewer();
if (controls) bindCard(controls);
else byId("look").hidden = byId("isolate").hidden = true;
new Gallery();
new Plots(byId("plots"));
shared.select(pictures.length ? pictures[Math.floor((pictures.length - 1) / 2)].keyframe : 0);
// For tests: what works.
document.documentElement.dataset.report = controls ? "complete" : "without-3d";
