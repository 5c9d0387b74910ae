// Puts the page together.

import { startViewer } from "./controls.js";
import { Gallery, pictures } from "./gallery.js";
import { provenanceInWords } from "./numbers.js";
import { byId, data, element } from "./page.js";
import { Plots, rows } from "./plots.js";
import { shared } from "./scene.js";
import { heads, medians, plotTable } from "./tabular.js";
/** @import { Controls } from "./controls.js" */
/** @import { Labelled, Span } from "./types.js" */

function fillTables() {
  /** @param {Labelled} entry */
  const row = ([label, value]) => {
    const head = element("th", label);
    head.scope = "row";
    return element("tr", null, head, element("td", value));
  };
  byId("numbers").append(...data.numbers.map(row));
  byId("provenance").append(...data.provenance.map(provenanceInWords).map(row));
  byId("provenance-card").hidden = !data.provenance.length;
  byId("tiles").append(...data.numbers.slice(0, 6).map((/** @type {Labelled} */ [label, value]) => element("div", null, element("dt", label), element("dd", value))));
}

/** What the keyframe's card does with the 3-D view. @param {Controls} controls */
function bindCard(controls) {
  const { viewer } = controls;
  byId("look").addEventListener("click", () => controls.lookThrough());
  byId("isolate").addEventListener("click", () => {
    viewer.settings.isolate = !viewer.settings.isolate;
    byId("isolate").setAttribute("aria-pressed", String(viewer.settings.isolate));
    viewer.redraw();
  });
}

/** What a table of the plots says first of a part of the rows. @param {Span} span */
function partOfRows([first, end]) {
  const lost = rows.state.slice(first, end).filter((state) => state === 2).length;
  return [`${rows.frame[first]}–${rows.frame[end - 1]}`, rows.timestamp[first].toFixed(2), String(lost)];
}

fillTables();
// A map alone says nothing of what its frames took.
byId("timing").hidden = !data.rows.count;
const controls = startViewer();
if (controls) bindCard(controls);
else byId("look").hidden = byId("isolate").hidden = true;
new Gallery();
const { panels } = new Plots(byId("plots"));
byId("plots").after(plotTable(["Frames", "From, s", "Lost frames", ...heads(panels)], () => medians(panels, [0, rows.count], partOfRows)));
shared.select(pictures.length ? pictures[Math.floor((pictures.length - 1) / 2)].keyframe : 0);
// For tests: what works.
document.documentElement.dataset.report = controls ? "complete" : "without-3d";
