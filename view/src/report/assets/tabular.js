// Plots as tables: for who does not see them, and for who wants the figures.

import { figures, medianOf, parts } from "./numbers.js";
import { element } from "./page.js";
/** @import { Plotted, Span } from "./types.js" */

/** Columns of a table from panels of plots: their titles with units. @param {Plotted[]} panels */
export const heads = (panels) => panels.map(({ title, unit }) => (unit ? `${title}, ${unit}` : title));

/** A row for each equal part of the values from `first` up to `end`: what `label` says of the part, then the panels' medians; at most so many rows. @param {Plotted[]} panels @param {Span} span @param {(part: Span) => string[]} label */
export function medians(panels, [first, end], label, most = 24) {
  return parts(end - first, most).map(([from, to]) => {
    const part = /** @type {[number, number]} */ ([first + from, first + to]);
    return [...label(part), ...panels.map(({ values }) => figures(medianOf(values, part)))];
  });
}

/** A table that unfolds; its rows are made when it does. @param {string[]} head @param {() => string[][]} rows */
export function plotTable(head, rows) {
  /** @param {string} text @param {"col" | "row"} scope */
  const cell = (text, scope) => Object.assign(element("th", text), { scope });
  const body = element("tbody");
  const columns = element("thead", null, element("tr", null, ...head.map((text) => cell(text, "col"))));
  const table = element("table", null, element("caption", "Medians of equal parts"), columns, body);
  const scroll = Object.assign(element("div", null, table), { className: "scroll" });
  const details = Object.assign(element("details", null, element("summary", "The plots as a table"), scroll), { className: "plot-table" });
  details.addEventListener("toggle", () => {
    if (body.childElementCount) return;
    body.append(...rows().map(([first, ...others]) => element("tr", null, cell(first, "row"), ...others.map((text) => element("td", text)))));
  });
  return details;
}
