// Puts the page together.

import { startPaths } from "./paths.js";
import { fillAgents, fillHead, fillNumbers, fillPairs, fillTimes, meetingSection, meetings, mergeGraph, plural } from "./tables.js";
import { startViewer } from "../../../../../view/src/report/assets/controls.js";
import { Drawing, byId, contextOf } from "../../../../../view/src/report/assets/page.js";
import { agentColour, agents, keyframeInWords, shared } from "../../../../../view/src/report/assets/scene.js";
/** @import { ReadColour } from "../../../../../view/src/report/assets/types.js" */

/** The merges as a graph: agents on a circle, lines between those that were merged. */
class MergeGraph extends Drawing {
  draw() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const context = contextOf(canvas), style = getComputedStyle(document.documentElement);
    /** @param {string} name */
    const colour = (name) => style.getPropertyValue(name).trim();
    context.scale(ratio, ratio);
    context.font = `12px ${style.fontFamily}`;
    context.textBaseline = "middle";
    const [rx, ry] = [Math.min(width / 2 - 76, 120), height / 2 - 30];
    /** @param {number} i @returns {[number, number]} */
    const place = (i) => {
      const angle = (i / agents.length) * 2 * Math.PI - (agents.length === 2 ? Math.PI : Math.PI / 2);
      return [width / 2 + rx * Math.cos(angle), height / 2 + ry * Math.sin(angle)];
    };
    mergeGraph.merges.forEach(({ agents: [a, b], closures, in_tree: tree }) => {
      const [p, q] = [place(a), place(b)];
      context.strokeStyle = colour(tree ? "--text" : "--faint");
      context.lineWidth = tree ? 3 : 1.2;
      context.beginPath();
      context.moveTo(...p);
      context.lineTo(...q);
      context.stroke();
      // Between three and more agents there is room for the number alone.
      this.label(context, agents.length > 2 ? String(closures) : plural(closures, "closure"), (p[0] + q[0]) / 2, (p[1] + q[1]) / 2, colour);
    });
    agents.forEach((agent, i) => {
      const [x, y] = place(i);
      context.fillStyle = agentColour(i);
      context.beginPath();
      context.arc(x, y, 9, 0, 7);
      context.fill();
      context.fillStyle = colour("--text");
      context.textAlign = "center";
      context.fillText(agent.name, x, y + (y > height / 2 || agents.length === 2 ? 20 : -18), 150);
    });
  }

  /** Text on a patch of the card's colour. @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y @param {ReadColour} colour */
  label(context, text, x, y, colour) {
    const { width } = context.measureText(text);
    context.fillStyle = colour("--card");
    context.fillRect(x - width / 2 - 4, y - 9, width + 8, 18);
    context.fillStyle = colour("--soft");
    context.textAlign = "center";
    context.fillText(text, x, y);
  }
}

/** Tells which keyframe is selected. */
function showSelection() {
  const index = shared.selected;
  byId("selection").hidden = index < 0;
  if (index < 0) return;
  byId("selection").textContent = `Selected: ${keyframeInWords(index)}`;
}

fillHead();
fillAgents();
fillPairs();
fillNumbers();
fillTimes();
byId("meetings").append(...[...meetings].sort((a, b) => Number(Boolean(a.refusal)) - Number(Boolean(b.refusal))).map(meetingSection));
const controls = startViewer();
const graph = new MergeGraph(byId("graph"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => graph.redraw());
startPaths();
shared.onChange((what) => what === "selected" && showSelection());
// For tests: what works.
document.documentElement.dataset.report = controls ? "complete" : "without-3d";
