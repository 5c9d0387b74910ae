// The cloud's arrays.

import { unpack } from "./numbers.js";
import { data } from "./page.js";

export const cloud = {
  count: data.cloud.count,
  position: unpack(data.cloud.position, Uint16Array),
  value: unpack(data.cloud.value, Uint8Array),
  /** Red, green and blue of each point, where the images have colours. */
  color: data.cloud.color ? unpack(data.cloud.color, Uint8Array) : null,
  /** First point of each keyframe, and the end. @type {number[]} */
  starts: unpack(data.cloud.per_keyframe, Uint32Array).reduce((starts, n) => (starts.push(starts[starts.length - 1] + n), starts), [0]),
  /** A point's place in the world. @param {number} index */
  world(index) {
    return [0, 1, 2].map((i) => data.cloud.box_min[i] + (this.position[index * 4 + i] / 65535) * data.cloud.box_size[i]);
  },
  /** The relative sigma of a code. @param {number} code */
  sigma(code) {
    const [best, worst] = data.cloud.sigma;
    return best * Math.pow(worst / best, code / 255);
  },
  /** The depth of a colour in 0–1. @param {number} t */
  depth(t) {
    const [low, high] = data.cloud.inverse_depth;
    return 1 / (low + t * (high - low));
  },
};
