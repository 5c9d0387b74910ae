// The agents' paths over time: position per axis, and roll, pitch, yaw.

import { nameOf } from "./tables.js";
import { Chart } from "../../../../../view/src/report/assets/chart.js";
import { figures, quantile, unpack } from "../../../../../view/src/report/assets/numbers.js";
import { byId, data, element, parentOf } from "../../../../../view/src/report/assets/page.js";
import { nearestTime } from "../../../../../view/src/report/assets/playing.js";
import { agentColour, agents, keyframes, lengthUnit, shared, spans, trajectory } from "../../../../../view/src/report/assets/scene.js";
import { heads, medians, plotTable } from "../../../../../view/src/report/assets/tabular.js";
import { MERGE_EDGE } from "../../../../../view/src/report/assets/viewer.js";
/** @import { Panel, Readout } from "../../../../../view/src/report/assets/types.js" */

export const paths = {
  seconds: unpack(data.paths.seconds, Float32Array),
  position: unpack(data.paths.position, Float32Array),
  turns: unpack(data.paths.turns, Float32Array),
  spans: spans(trajectory.agent, trajectory.count),
  /** The frame of an agent nearest to a time; −1 outside of its recording. @param {number} agent @param {number} seconds */
  near(agent, seconds) {
    const [first, end] = this.spans[agent];
    return end > first && seconds <= this.seconds[end - 1] ? nearestTime(this.seconds, first, end, seconds) : -1;
  },
};

shared.framePointedAt = (agent) => (shared.hoverAt === null ? -1 : paths.near(agent, shared.hoverAt));
shared.placeOfTime = (seconds) => seconds;

/** The frames at the keyframes that closures match, by agent. @returns {Set<number>[]} */
export function matchedFrames() {
  const edges = unpack(data.scene.edges, Uint32Array), found = agents.map(() => new Set());
  for (let i = 0; i < edges.length; i += 3) {
    if (edges[i + 2] !== MERGE_EDGE) continue;
    for (const keyframe of edges.slice(i, i + 2)) {
      const agent = keyframes.agent[keyframe], [first, end] = paths.spans[agent];
      if (first === end) continue;
      const frame = paths.near(agent, keyframes.timestamp[keyframe] - trajectory.timestamp[first] + paths.seconds[first]);
      if (frame >= 0) found[agent].add(frame);
    }
  }
  return found;
}

/** Panels of three columns of numbers. @param {string[]} titles @param {string} unit @param {Float32Array} numbers @returns {Panel[]} */
export function pathPanels(titles, unit, numbers) {
  return titles.map((title, column) => {
    const values = numbers.filter((_, i) => i % 3 === column);
    const [low, high] = values.reduce(([low, high], v) => (Number.isFinite(v) ? [Math.min(low, v), Math.max(high, v)] : [low, high]), [Infinity, -Infinity]);
    const middle = low <= high ? (low + high) / 2 : 0, reach = low <= high ? Math.max((high - low) * 0.54, 1e-3) : 1;
    return { title, unit, values, low: middle - reach, high: middle + reach };
  });
}

/** The plots of three columns of numbers. @extends {Chart<Panel>} */
export class PathPlots extends Chart {
  /** @param {HTMLCanvasElement} canvas @param {Panel[]} panels */
  constructor(canvas, panels) {
    const last = paths.seconds.reduce((a, b) => Math.max(a, b), 0);
    super(canvas, panels, [0, last || 1], 0, "s");
    this.matched = matchedFrames();
    /** The median step between the frame indices of each agent. @type {number[]} */
    this.steps = paths.spans.map(([first, end]) => {
      const steps = trajectory.frame.slice(first + 1, end).map((f, i) => f - trajectory.frame[first + i]).sort();
      return steps.length ? Math.max(1, quantile(steps, 0.5)) : 1;
    });
  }

  /** @param {CanvasRenderingContext2D} context @param {Panel} panel @param {(value: number) => number} at */
  drawCurves(context, panel, at) {
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    agents.forEach((_, agent) => {
      const [first, end] = paths.spans[agent], colour = agentColour(agent);
      context.strokeStyle = colour;
      context.beginPath();
      let pen = false;
      for (let i = first; i < end; i++) {
        const value = panel.values[i];
        const lost = i > first && trajectory.frame[i] - trajectory.frame[i - 1] > 8 * this.steps[agent];
        if (pen && !lost) context.lineTo(this.x(paths.seconds[i]), at(value));
        else context.moveTo(this.x(paths.seconds[i]), at(value));
        pen = Number.isFinite(value);
      }
      context.stroke();
      this.matched[agent].forEach((i) => this.drawRing(context, this.x(paths.seconds[i]), at(panel.values[i]), colour));
      const here = shared.hoverAt === null ? -1 : shared.framePointedAt(agent);
      if (here >= 0) this.drawDot(context, this.x(paths.seconds[here]), at(panel.values[here]), colour);
    });
  }

  /** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {string} colour */
  drawRing(context, x, y, colour) {
    context.strokeStyle = colour;
    context.beginPath();
    context.arc(x, y, 3.5, 0, 7);
    context.stroke();
  }

  /** @param {Panel} panel @returns {Readout[]} */
  readout(panel) {
    if (shared.hoverAt === null) return [];
    const texts = agents.map((_, agent) => ({ frame: shared.framePointedAt(agent), colour: agentColour(agent) }));
    return texts.filter(({ frame }) => frame >= 0).map(({ frame, colour }) => [figures(panel.values[frame]), colour, 650]);
  }

  /** Shows the span that another shows. @param {PathPlots} other */
  follow(other) {
    this.show(other.range);
  }

  cursor() {
    return shared.hoverAt === null ? null : { at: shared.hoverAt, text: `${shared.hoverAt.toFixed(2)} s` };
  }

  /** @param {number} seconds */
  point(seconds) {
    shared.hover(seconds);
  }

  /** @param {number} direction */
  walk(direction) {
    const [low, high] = this.range;
    const at = shared.hoverAt === null ? low : shared.hoverAt + direction * (high - low) / 200;
    shared.hover(Math.max(low, Math.min(high, at)));
  }

  least() {
    return 0.2;
  }
}

/** Both columns of plots; nothing where there are no frames. */
export function startPaths() {
  byId("paths-section").hidden = !trajectory.count;
  if (!trajectory.count) return;
  byId("paths-note").textContent = `World of ${agents[0].name}, the first map: x right, y down, z ahead at its start. Time runs from each agent's first frame; rings mark keyframes that closures match. Hover for values, drag to zoom, double-click to reset.`;
  byId("paths-legend").append(...agents.map((_, agent) => element("li", null, ...nameOf(agent))));
  const columns = [
    new PathPlots(byId("positions"), pathPanels(["x", "y", "z"], lengthUnit(), paths.position)),
    new PathPlots(byId("turns"), pathPanels(["Roll", "Pitch", "Yaw"], "degrees", paths.turns)),
  ];
  const panels = columns.flatMap((column) => column.panels);
  parentOf(byId("positions")).append(plotTable(["Agent", "From, s", ...heads(panels)], () => agents.flatMap(({ name }, agent) => medians(panels, paths.spans[agent], ([first]) => [name, paths.seconds[first].toFixed(1)], 12))));
  // Both show one span.
  columns.forEach((column, i) => column.canvas.addEventListener("pointerup", () => columns[1 - i].follow(column)));
  columns.forEach((column, i) => column.canvas.addEventListener("dblclick", () => columns[1 - i].follow(column)));
}
