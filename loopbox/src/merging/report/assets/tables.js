// Tables and words of a merging.

import { matchFigures } from "./matches.js";
import { figures } from "../../../../../view/src/report/assets/numbers.js";
import { byId, data, element } from "../../../../../view/src/report/assets/page.js";
import { agentColour, agents, keyframes, trajectory } from "../../../../../view/src/report/assets/scene.js";
/** @import { Labelled } from "../../../../../view/src/report/assets/types.js" */
/** @import { Closure, Column, Direct, Graph, Group, Meeting, Scale, Seconds } from "./types.js" */

/** What became of each two maps. @type {Meeting[]} */
export const meetings = data.meetings;
/** Who was joined with whom. @type {Graph} */
export const mergeGraph = data.graph;

/** @param {number | null} [share] */
export const percent = (share) => (share === null || share === undefined ? "–" : `${(share * 100).toFixed(0)} %`);
/** A small share in per cent; what is not finite came as null. @param {number | null} share */
export const fine = (share) => figures(share === null ? NaN : share * 100);
/** @param {number | null} value */
export const fixed = (value) => (value !== null && Number.isFinite(value) ? value.toFixed(4) : "–");
/** @param {number | null} value @param {number | null} sigma */
export const plusMinus = (value, sigma) => `${fixed(value)} ± ${fixed(sigma)}`;
/** @param {number} count @param {string} one */
export const plural = (count, one, many = `${one}s`) => `${count.toLocaleString("en")} ${count === 1 ? one : many}`;

/** Words as people list them. @param {string[]} words */
export const listed = (words) => (words.length < 2 ? words.join("") : `${words.slice(0, -1).join(", ")} and ${words[words.length - 1]}`);

/** An agent's name with its colour, as children of a node. @param {number} agent */
export function nameOf(agent) {
  const swatch = Object.assign(element("span"), { className: "swatch" });
  swatch.style.background = agentColour(agent);
  return [swatch, agents[agent].name];
}

/** What the columns mean, to be unfolded by pointer, key or touch. @param {Column[]} columns */
function columnsExplained(columns) {
  const list = element("dl", null, ...columns.flatMap(([head, explanation]) => [element("dt", head || "Row"), element("dd", explanation)]));
  return element("caption", null, element("details", null, element("summary", "What the columns mean"), list));
}

/** Fills a table: columns `[head, explanation, class]`, rows of texts or nodes. @param {HTMLTableElement} table @param {Column[]} columns @param {(Node | string | number)[][]} rows */
export function fillTable(table, columns, rows) {
  const heads = columns.map(([head, explanation, kind]) => {
    const cell = Object.assign(element("th", head), { title: explanation, className: kind || "" });
    cell.scope = "col";
    return cell;
  });
  /** @param {(Node | string | number)[]} row */
  const cells = (row) => row.map((value, i) => {
    const cell = element("td", null, value instanceof Node ? value : String(value));
    cell.className = columns[i][2] || "";
    return cell;
  });
  table.replaceChildren(
    columnsExplained(columns),
    element("thead", null, element("tr", null, ...heads)),
    element("tbody", null, ...rows.map((row) => element("tr", null, ...cells(row)))),
  );
  return table;
}

export const newTable = () => Object.assign(element("table"), { className: "grid" });
/** @param {boolean} good @param {string} text */
export const verdictOf = (good, text) => Object.assign(element("span", text), { className: `verdict ${good ? "good" : "bad"}` });
/** @param {number} index @returns {string} */
export const inputName = (index) => data.inputs[index];
/** @param {Seconds} seconds */
export const secondsOf = ({ places, meeting, method }) => places + meeting + method;

/** The direct alignment with most agreeing pixels among the pairs used: what the verdict rests on. @param {Closure} closure */
export function bestDirect(closure) {
  const used = closure.pairs.flatMap((pair) => (pair && pair.agrees && pair.direct ? [pair.direct] : []));
  return used.reduce((/** @type {Direct | null} */ best, direct) => (!best || direct.inlier_share > best.inlier_share ? direct : best), null);
}

export function fillPairs() {
  const columns = [
    ["Maps", "The map that was searched, and the one whose keyframes were looked for"],
    ["Verdict", "Whether they were merged"],
    ["γ", "Key points that match over the keyframe pairs that agree", "number"],
    ["σ*", "Scale: units of the first map per unit of the second, with standard deviation", "number"],
    ["Δ", "Largest difference between the scales that went into σ*", "number"],
    ["Pixels agree", "Share of the pixels with depth that agree once the images are aligned", "number"],
    ["Of all", "Share of all pixels with depth that agree, seen by the other keyframe or not", "number"],
    ["RMSE", "Photometric residual after direct alignment, grey levels", "number"],
    ["Closures", "Keyframe pairs along both maps that agree and join them", "number"],
    ["Seconds", "Finding the place, following it, further closures", "number"],
    ["Reason", "Why they were not merged", "wrap"],
  ];
  const rows = meetings.map((meeting) => {
    const { closure, closures } = meeting, direct = closure && bestDirect(closure);
    return [
      `${inputName(meeting.target)} + ${inputName(meeting.source)}`,
      verdictOf(!meeting.refusal, meeting.verdict),
      closure ? closure.evidence.matches.toLocaleString("en") : Math.max(0, ...meeting.places.map((place) => place.match_count)),
      closure ? plusMinus(closure.scale.scale, closure.scale.deviation) : "–",
      closure ? figures(closure.scale.scale_gap) : "–",
      closure ? percent(closure.evidence.inlier_share) : "–",
      closure ? percent(closure.evidence.agreeing_share) : "–",
      direct ? figures(direct.rmse) : "–",
      closures ? closures.used : "–",
      secondsOf(meeting.seconds).toFixed(2),
      meeting.refusal || "",
    ];
  });
  // Without refusals nobody needs the column.
  const shown = meetings.some((meeting) => meeting.refusal) ? columns.length : columns.length - 1;
  fillTable(byId("pairs"), columns.slice(0, shown), rows.map((row) => row.slice(0, shown)));
}

/** The table of the pairs z = −1, 0, 1. @param {Closure} closure */
export function tripleTable(closure) {
  const columns = [
    ["Pair", "Position along the joining map, from the place"],
    ["Keyframes", "Of the first map and of the joining one", "number"],
    ["γ", "Key points that match and fit one relative pose", "number"],
    ["With depth", "Those with depth on both sides", "number"],
    ["σ", "Scale by this pair alone, with standard deviation", "number"],
    ["Deviation", "Standard deviation over the scale", "number"],
    ["RMSE", "Photometric residual after direct alignment, grey levels", "number"],
    ["Pixels agree", "Share of the pixels with depth that agree then", "number"],
    ["Overlap", "Share of the pixels with depth that the other keyframe sees", "number"],
    ["Verdict", "What became of the pair", "wrap"],
  ];
  const rows = closure.pairs.map((pair, z) => {
    const name = `z = ${["−1", "0", "1"][z]}`;
    if (!pair) return [name, ...Array(8).fill("–"), "The maps have no such pair."];
    const { keyframes: ids, matches, scale, direct } = pair;
    return [
      name, `${ids.target} · ${ids.source}`, matches ? matches.count : "–", matches ? matches.with_depth : "–",
      scale ? plusMinus(scale[0], scale[1]) : "–", scale ? `${fine(scale[1] / scale[0])} %` : "–",
      direct ? figures(direct.rmse) : "–", direct ? percent(direct.inlier_share) : "–", direct ? percent(direct.overlap) : "–", pair.verdict,
    ];
  });
  return fillTable(newTable(), columns, rows);
}

/** σ* by both estimators, and the registration of the clouds. @param {Closure} closure */
export function scaleTable(closure) {
  /** @param {boolean[]} used */
  const names = (used) => listed(["−1", "0", "1"].filter((_, i) => used[i])) || "none";
  /** @param {string} title @param {Scale} found */
  const row = (title, { scale, deviation, scale_gap: gap, used, basis }) => [title, plusMinus(scale, deviation), figures(gap), `z = ${names(used)}: ${basis}`];
  const { Ok: paper, Err: none } = closure.algorithm_1;
  const rows = [row("Inverse variance (used)", closure.scale), paper ? row("Algorithm 1 of the paper", paper) : ["Algorithm 1 of the paper", "–", "–", `None: ${none}.`]];
  return fillTable(newTable(), [["Scale σ* by", "How the scales of the three pairs are made one"], ["σ*", "With standard deviation", "number"], ["Δ", "Largest difference between the scales used", "number"], ["Rests on", "The pairs used", "wrap"]], rows);
}

/** @param {Closure} closure */
export function registrationText(closure) {
  const { Ok: found, Err: none } = closure.registration;
  if (!found) return `The clouds of the chosen pair could not be registered point by point: ${none}. The images were aligned from where the key points put them.`;
  const end = found.converged ? "" : " It still moved then.";
  return `Registering the clouds of the pair z = ${["−1", "0", "1"][closure.chosen]} point by point: residual ${figures(found.rmse)} units, ${percent(found.inlier_share)} inliers, ${percent(found.overlap)} overlap, after ${plural(found.iterations, "iteration")}.${end} Then every pair was aligned on its images.`;
}

/** The places tried, folded away. @param {Meeting} meeting */
export function placesTried(meeting) {
  const columns = [["Keyframes", "Of the first map and of the joining one", "number"], ["γ", "Key points that match and fit one relative pose", "number"], ["Outcome", "What became of it", "wrap"]];
  const rows = meeting.places.map(({ keyframes: ids, match_count: count, outcome }) => [`${ids.target} · ${ids.source}`, count || "–", outcome]);
  const summary = element("summary", `${plural(meeting.places.length, "place")} tried of ${meeting.proposed.toLocaleString("en")} proposed`);
  const folded = element("details", null, summary);
  if (rows.length) folded.append(Object.assign(element("div", null, fillTable(newTable(), columns, rows)), { className: "scroll" }));
  return folded;
}

/** What happened between two maps. @param {Meeting} meeting */
export function meetingStory(meeting) {
  const { closure, closures, refusal } = meeting;
  const [first, second] = [meeting.target, meeting.source].map(inputName);
  if (!closure) return `${refusal} Nothing of ${second} was joined to ${first} here.`;
  const { evidence } = closure;
  const story = `The agents passed the place travelling ${closure.travel}. ${evidence.matches.toLocaleString("en")} key points match over ${plural(evidence.pairs, "keyframe pair")}; one unit of ${second} is ${plusMinus(closure.scale.scale, closure.scale.deviation)} of ${first}. The motion between the maps is known to ${figures(evidence.rotation_deviation)}° and ${fine(evidence.scale_deviation)} % of the scale.`;
  if (!closure.accepted) return `${refusal} ${story}`;
  return closures ? `${story} ${plural(closures.used, "closure")} along both maps agree and join them; ${closures.rejected} more disagreed, ${closures.failed} could not be aligned.` : story;
}

/** @param {Meeting} meeting */
export function meetingSection(meeting) {
  const { closure, refusal } = meeting;
  const names = [meeting.target, meeting.source].map(inputName);
  const title = refusal ? `${names[0]} and ${names[1]} were not merged` : `Where ${names[1]} met ${names[0]}`;
  /** @param {Node} node */
  const scroll = (node) => Object.assign(element("div", null, node), { className: "scroll" });
  const card = Object.assign(element("div", null, Object.assign(element("p", meetingStory(meeting)), { className: "lead" })), { className: "card" });
  if (closure) card.append(...matchFigures(meeting, closure), scroll(tripleTable(closure)), scroll(scaleTable(closure)), Object.assign(element("p", registrationText(closure)), { className: "lead" }));
  card.append(placesTried(meeting));
  const head = Object.assign(element("div", null, element("h2", title)), { className: "section-head" });
  return Object.assign(element("section", null, head, card), { className: "meeting" });
}

export function fillTimes() {
  /** @param {number} value */
  const seconds = (value) => value.toFixed(3);
  const rows = meetings.map(({ target, source, seconds: { places, meeting, method } }) => [`${inputName(target)} + ${inputName(source)}`, seconds(places), seconds(meeting), seconds(method)]);
  rows.push(["Common map", "", "", seconds(data.fusion_seconds)]);
  fillTable(byId("times"), [["", "The two maps"], ["Places", "Place recognition", "number"], ["Meeting", "Matching places and following them to their verdicts, closures along both maps included", "number"], ["Method, fusion", "What another method than the default does; for the common map its joint optimisation", "number"]], rows);
}

/** A row of a table of labels and values. @param {Labelled} entry */
export function labelled([label, value]) {
  const head = element("th", label);
  head.scope = "row";
  return element("tr", null, head, element("td", value));
}

export function fillNumbers() {
  const { pose_graph: graph } = mergeGraph;
  /** @type {Labelled[]} */
  const rows = [
    ["Agents", listed(agents.map((agent) => agent.name))],
    ["Keyframes", keyframes.count.toLocaleString("en")],
    ["Points", data.cloud.total.toLocaleString("en")],
    ["Frames drawn", trajectory.count.toLocaleString("en")],
  ];
  if (graph) {
    const suppressed = graph.suppressed ? `; ${plural(graph.suppressed, "closure")} came to be disbelieved` : "";
    rows.push(["Cost of the joint pose graph", `${figures(graph.initial_cost)} before, ${figures(graph.final_cost)} after ${plural(graph.iterations, "iteration")}${graph.converged ? "" : ", not converged"}${suppressed}`]);
  }
  data.others.forEach((/** @type {Group} */ group) => rows.push(["Not in this map", `${listed(group.names)}: ${plural(group.keyframes, "keyframe")}, joined to nobody shown here`]));
  byId("numbers").append(...rows.map(labelled));
}

export function fillAgents() {
  byId("agent-list").append(...mergeGraph.agents.map((agent, index) => {
    const { way, scale, deviation: sigma, confidence } = agent;
    const lines = [`${plural(agent.keyframes, "keyframe")}.`];
    if (way.length < 2) lines.push("Its world is the common frame.");
    else {
      const over = way.slice(1, -1).map((i) => agents[i].name);
      lines.push(`Joined ${over.length ? `over ${listed(over)} (${way.length - 1} merges)` : `to ${agents[way[0]].name}`}. One unit of its own map is ${figures(scale)} here.`);
      lines.push(`Place known to ${figures(sigma.position)} units, ${figures(sigma.rotation)}°, ${fine(sigma.scale)} % of the scale (σ); confidence ${figures(confidence)}.`);
    }
    return Object.assign(element("div", null, element("h3", null, ...nameOf(index)), ...lines.map((line) => element("p", line))), { className: "agent" });
  }));
}

export function fillHead() {
  const merged = meetings.filter((meeting) => !meeting.refusal).length;
  const closures = mergeGraph.merges.reduce((sum, merge) => sum + merge.closures, 0);
  const seconds = meetings.reduce((sum, meeting) => sum + secondsOf(meeting.seconds), data.fusion_seconds);
  const tiles = [
    ["agents in one map", agents.length], ["pairs merged", `${merged} of ${meetings.length}`], ["closures", closures],
    ["keyframes", keyframes.count.toLocaleString("en")], ["points", data.cloud.total.toLocaleString("en")], ["merging", `${seconds.toFixed(2)} s`],
  ];
  byId("tiles").append(...tiles.map(([label, value]) => element("div", null, element("dt", label), element("dd", String(value)))));
  const apart = data.others.flatMap((/** @type {Group} */ group) => group.names);
  byId("lead").textContent = `${agents.length > 1 ? `Maps of ${agents.length} agents, each made on its own and in its own unit of length, joined where the agents saw the same places. White lines and frames in the picture mark the matched keyframes.` : `${agents[0] ? agents[0].name : "The map"} was joined with nobody.`}${apart.length ? ` Not in this map: ${listed(apart)}.` : ""}`;
}
