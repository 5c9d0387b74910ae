// The scene as it comes: the report's data, growing.

import { cloud } from "../../report/assets/cloud.js";
import { quantile } from "../../report/assets/numbers.js";
import { data } from "../../report/assets/page.js";
import { keyframes, trajectory } from "../../report/assets/scene.js";

export const store = {
  /** Index of each keyframe by its name in the map. */
  slots: new Map(),
  scale: new Float32Array(0),
  /** Points of keyframes by name: as decoded, with the keyframe's index as `slot` and what drawing keeps of them. */
  chunks: new Map(),
  points: 0,
  edges: new Uint32Array(0),
};

/** A typed array with room for `length`, the old contents kept. */
export function grown(array, length) {
  if (array.length >= length) return array;
  const larger = new array.constructor(Math.max(length, array.length * 2, 64));
  larger.set(array);
  return larger;
}

/** Forgets everything. */
export function forget() {
  store.slots.clear();
  store.chunks.forEach((chunk) => chunk.release && chunk.release());
  store.chunks.clear();
  store.points = 0;
  store.edges = new Uint32Array(0);
  keyframes.count = trajectory.count = cloud.count = 0;
}

/** Takes steps of the trajectory; gives the first of them. */
export function setSteps(steps) {
  const { from, count } = steps;
  trajectory.count = from + count;
  for (const [name, size] of Object.entries({ agent: 1, frame: 1, timestamp: 1, position: 3, rotation: 4 })) {
    trajectory[name] = grown(trajectory[name], trajectory.count * size);
    trajectory[name].set(steps[name], from * size);
  }
  return from;
}

/** Adds or moves a keyframe; gives its index. */
export function place({ id, agent, frame, scale, pose }) {
  let slot = store.slots.get(id);
  if (slot === undefined) {
    slot = keyframes.count++;
    store.slots.set(id, slot);
    for (const name of ["agent", "id", "frame"]) keyframes[name] = grown(keyframes[name], keyframes.count);
    keyframes.pose = grown(keyframes.pose, keyframes.count * 12);
    store.scale = grown(store.scale, keyframes.count);
  }
  keyframes.agent[slot] = agent;
  keyframes.id[slot] = id;
  keyframes.frame[slot] = frame;
  store.scale[slot] = scale;
  keyframes.pose.set(pose, slot * 12);
  const chunk = store.chunks.get(id);
  if (chunk) chunk.matrix = null;
  return slot;
}

/** Takes a keyframe's points, new or measured anew; those of a keyframe that is not placed are of no use. */
export function setChunk(decoded) {
  const { id } = decoded, slot = store.slots.get(id);
  if (slot === undefined) return;
  const chunk = { ...decoded, slot, matrix: null }, before = store.chunks.get(id);
  if (before) {
    store.points -= before.count;
    if (before.release) before.release();
  }
  store.points += chunk.count;
  store.chunks.set(id, chunk);
}

/** A chunk's point in its keyframe's frame, in its own unit. */
export function chunkPoint(chunk, index) {
  const { fx, fy, cx, cy } = chunk.camera, at = index * 4;
  const depth = 1 / (chunk.depth[0] + (chunk.words[at + 2] / 65535) * (chunk.depth[1] - chunk.depth[0]));
  return [((chunk.words[at] - cx) / fx) * depth, ((chunk.words[at + 1] - cy) / fy) * depth, depth];
}

/** A point of a keyframe's frame, in the world. */
export function toWorld(slot, point) {
  const scale = store.scale[slot], pose = keyframes.pose, at = slot * 12;
  return [0, 1, 2].map((r) => pose[at + 9 + r] + scale * (pose[at + r] * point[0] + pose[at + 3 + r] * point[1] + pose[at + 6 + r] * point[2]));
}

/** Draws a sample of all points for the survey of the scene. */
export function sampleCloud() {
  const each = Math.max(4, Math.ceil(8000 / Math.max(1, store.chunks.size)));
  const places = [], codes = [], depths = [];
  for (const chunk of store.chunks.values()) {
    for (let i = 0; i < Math.min(each, chunk.count); i++) {
      const point = chunkPoint(chunk, i);
      places.push(toWorld(chunk.slot, point));
      depths.push(1 / (point[2] * store.scale[chunk.slot]));
      codes.push(0, chunk.bytes[i * 8 + 7]);
    }
  }
  cloud.count = places.length;
  cloud.value = Uint8Array.from(codes);
  cloud.world = (index) => places[index];
  depths.sort((a, b) => a - b);
  if (depths.length) data.cloud.inverse_depth = [quantile(depths, 0.02), Math.max(quantile(depths, 0.98), quantile(depths, 0.02) * 1.01)];
}
