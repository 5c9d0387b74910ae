// What is known of a scene before it is drawn, and what is selected in it.

import { unpack } from "./numbers.js";
import { data } from "./page.js";
/** @import { Agent, Jpeg, Span, ToldAgent, Vector } from "./types.js" */

/** What stands for the view of a LiDAR, which sees all around: ahead, 90° wide. */
const AHEAD = { width: 4, height: 3, fx: 2, fy: 2, cx: 1.5, cy: 1 };

/** @param {ToldAgent} agent @returns {Agent} */
const asShown = (agent) => ({ ...agent, camera: agent.camera ?? AHEAD, isLidar: !agent.camera });
/** @type {Agent[]} */
export const agents = data.scene.agents.map(asShown);

/** Takes other agents in place of those that were known. @param {ToldAgent[]} others */
export function setAgents(others) {
  agents.splice(0, agents.length, ...others.map(asShown));
}

export const keyframes = {
  count: data.scene.keyframes.count,
  agent: unpack(data.scene.keyframes.agent, Uint32Array),
  id: unpack(data.scene.keyframes.id, Uint32Array),
  frame: unpack(data.scene.keyframes.frame, Float64Array),
  timestamp: unpack(data.scene.keyframes.timestamp, Float64Array),
  pose: unpack(data.scene.keyframes.pose, Float32Array),
  depths: unpack(data.scene.keyframes.depths, Uint32Array),
  /** The camera that took a keyframe; of a LiDAR's what stands for it. @param {number} index */
  camera(index) {
    return agents[this.agent[index]].camera;
  },
  /** Axis 0–2 or centre 3 of a keyframe. @param {number} index @param {number} column @returns {Vector} */
  column(index, column) {
    return Array.from(this.pose.subarray(index * 12 + column * 3, index * 12 + column * 3 + 3));
  },
  /** The keyframe whose frame lies nearest; −1 without keyframes. @param {number} frame */
  nearest(frame) {
    let best = -1;
    for (let i = 0; i < this.count; i++) {
      if (best < 0 || Math.abs(this.frame[i] - frame) < Math.abs(this.frame[best] - frame)) best = i;
    }
    return best;
  },
};

export const trajectory = {
  count: data.scene.trajectory.count,
  agent: unpack(data.scene.trajectory.agent, Uint32Array),
  frame: unpack(data.scene.trajectory.frame, Float64Array),
  timestamp: unpack(data.scene.trajectory.timestamp, Float64Array),
  position: unpack(data.scene.trajectory.position, Float32Array),
  rotation: unpack(data.scene.trajectory.rotation, Float32Array),
};

/** A keyframe in words: whose it is, when it was taken, and what it holds. @param {number} index */
export function keyframeInWords(index) {
  const agent = agents[keyframes.agent[index]], [one, many] = agent.isLidar ? ["scan", "points"] : ["frame", "pixels with depth"];
  return `${one} ${keyframes.frame[index]} of ${agent.name}, ${keyframes.timestamp[index].toFixed(2)} s, ${keyframes.depths[index].toLocaleString("en")} ${many}`;
}

/** What lengths are told in. */
export const lengthUnit = () => (data.scene.metric ? "m" : "map units");

/** First and end index of each agent's run in an ascending array of `count` agents. @param {ArrayLike<number>} owners @param {number} count */
export function spans(owners, count) {
  const found = agents.map(() => /** @type {Span} */ ([0, 0]));
  for (let i = 0; i < count; i++) {
    if (i === 0 || owners[i - 1] !== owners[i]) found[owners[i]][0] = i;
    found[owners[i]][1] = i + 1;
  }
  return found;
}

/** An agent's colour, as CSS reads it. @param {number} agent */
export const agentColour = (agent) => `rgb(${agents[agent].color.join(" ")})`;

/** What is selected and pointed at (a place on the plots' x axis); parts of the page listen for changes. */
export const shared = {
  selected: -1,
  /** @type {number | null} */
  hoverAt: null,
  /** @type {((what: "selected" | "hover") => void)[]} */
  listeners: [],
  /** @param {(what: "selected" | "hover") => void} listener */
  onChange(listener) {
    this.listeners.push(listener);
  },
  /** @param {number} keyframe */
  select(keyframe) {
    if (keyframe === this.selected || keyframe < 0 || keyframe >= keyframes.count) return;
    this.selected = keyframe;
    this.listeners.forEach((f) => f("selected"));
  },
  /** The frame of an agent at the place pointed at, an index into the trajectory, or −1; pages with plots say it. @type {(agent: number) => number} */
  framePointedAt: (_agent) => -1,
  /** The place on the plots' x axis of a time since each agent's first frame, where frames are played. @type {(seconds: number, frames: number[]) => number | null} */
  placeOfTime: (_seconds, _frames) => null,
  /** @param {number | null} at */
  hover(at) {
    if (at === this.hoverAt) return;
    this.hoverAt = at;
    this.listeners.forEach((f) => f("hover"));
  },
};

/** The image of each keyframe that has one, for the 3-D view and elsewhere. @type {Map<number, HTMLImageElement>} */
export const pictureImages = new Map();

/** The image of a picture; its text is given up. @param {Jpeg} picture */
export function takeImage(picture) {
  const image = new Image();
  image["src"] = "data:image/jpeg;base64," + picture.jpeg;
  picture.jpeg = null;
  if (picture.keyframe !== null) pictureImages.set(picture.keyframe, image);
  return image;
}
