// The scene as it comes: the report's data, growing.

import { cloud } from "../../report/assets/cloud.js";
import { quantile } from "../../report/assets/numbers.js";
import { data } from "../../report/assets/page.js";
import { keyframes, trajectory } from "../../report/assets/scene.js";
/** @import { Vector } from "../../report/assets/types.js" */
/** @import { Chunk, PlacedKeyframe, Steps } from "./decode.js" */
/** @import { StoredChunk } from "./types.js" */

export const store = {
  /** Index of each keyframe by its name in the map. @type {Map<number, number>} */
  slots: new Map(),
  scale: new Float32Array(0),
  /** Points of keyframes by name: as decoded, with the keyframe's index as `slot` and what drawing keeps of them. @type {Map<number, StoredChunk>} */
  chunks: new Map(),
  points: 0,
  edges: new Uint32Array(0),
};

/**
 * A typed array with room for `length`, the old contents kept.
 * @template {Float32Array | Float64Array | Uint32Array} A @param {A} array @param {number} length @returns {A}
 */
export function grown(array, length) {
  if (array.length >= length) return array;
  const Kind = /** @type {new (length: number) => A} */ (array.constructor);
  const larger = new Kind(Math.max(length, array.length * 2, 64));
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

/** Numbers of a step of the trajectory, by what they tell. @type {["agent" | "frame" | "timestamp" | "position" | "rotation", number][]} */
const SIZES = [["agent", 1], ["frame", 1], ["timestamp", 1], ["position", 3], ["rotation", 4]];

/** Takes steps of the trajectory; gives the first of them. @param {Steps} steps */
export function setSteps(steps) {
  const { from, count } = steps;
  trajectory.count = from + count;
  for (const [name, size] of SIZES) {
    Object.assign(trajectory, { [name]: grown(trajectory[name], trajectory.count * size) });
    trajectory[name].set(steps[name], from * size);
  }
  return from;
}

/** Adds or moves a keyframe; gives its index. @param {PlacedKeyframe} keyframe */
export function place({ id, agent, frame, scale, pose }) {
  let slot = store.slots.get(id);
  if (slot === undefined) {
    slot = keyframes.count++;
    store.slots.set(id, slot);
    keyframes.agent = grown(keyframes.agent, keyframes.count);
    keyframes.id = grown(keyframes.id, keyframes.count);
    keyframes.frame = grown(keyframes.frame, keyframes.count);
    keyframes.pose = grown(keyframes.pose, keyframes.count * 12);
    store.scale = grown(store.scale, keyframes.count);
  }
  keyframes.agent[slot] = agent;
  keyframes.id[slot] = id;
  keyframes.frame[slot] = frame;
  store.scale[slot] = scale;
  keyframes.pose.set(pose, slot * 12);
  const chunk = store.chunks.get(id);
  if (chunk) chunk.place = null;
  return slot;
}

/** Takes a keyframe's points, new or measured anew; those of a keyframe that is not placed are of no use. @param {Chunk} decoded */
export function setChunk(decoded) {
  const { id } = decoded, slot = store.slots.get(id);
  if (slot === undefined) return;
  const chunk = { ...decoded, slot, place: null }, before = store.chunks.get(id);
  if (before) {
    store.points -= before.count;
    if (before.release) before.release();
  }
  store.points += chunk.count;
  store.chunks.set(id, chunk);
}

/** A chunk's point in its keyframe's frame, in its own unit. @param {Chunk} chunk @param {number} index @returns {Vector} */
export function chunkPoint(chunk, index) {
  const { fx, fy, cx, cy } = chunk.camera, at = index * 4;
  const depth = 1 / (chunk.depth[0] + (chunk.words[at + 2] / 65535) * (chunk.depth[1] - chunk.depth[0]));
  return [((chunk.words[at] - cx) / fx) * depth, ((chunk.words[at + 1] - cy) / fy) * depth, depth];
}

/** A point of a keyframe's frame, in the world. @param {number} slot @param {Vector} point @returns {Vector} */
export function toWorld(slot, point) {
  const scale = store.scale[slot], pose = keyframes.pose, at = slot * 12;
  return [0, 1, 2].map((r) => pose[at + 9 + r] + scale * (pose[at + r] * point[0] + pose[at + 3 + r] * point[1] + pose[at + 6 + r] * point[2]));
}

/** Draws a sample of all points for the survey of the scene. */
export function sampleCloud() {
  const each = Math.max(4, Math.ceil(8000 / Math.max(1, store.chunks.size)));
  /** @type {Vector[]} */
  const places = [];
  /** @type {number[]} */
  const codes = [], depths = [];
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
