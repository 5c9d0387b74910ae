// The cloud's arrays, and what its distribution says about the scene's size.

const cloud = {
  count: data.cloud.count,
  position: unpack(data.cloud.position, Uint16Array),
  value: unpack(data.cloud.value, Uint8Array),
  /** First point of each keyframe, and the end. */
  starts: unpack(data.cloud.per_keyframe, Uint32Array).reduce((starts, n) => (starts.push(starts[starts.length - 1] + n), starts), [0]),
  /** A point's place in the world. */
  world(index) {
    return [0, 1, 2].map((i) => data.cloud.box_min[i] + (this.position[index * 4 + i] / 65535) * data.cloud.box_size[i]);
  },
  /** The relative sigma of a code. */
  sigma(code) {
    const [best, worst] = data.cloud.sigma;
    return best * Math.pow(worst / best, code / 255);
  },
  /** The depth of a colour in 0–1. */
  depth(t) {
    const [low, high] = data.cloud.inverse_depth;
    return 1 / (low + t * (high - low));
  },
};

/** The levelled world: axes, box of the bulk of the scene, range of heights and of sigma codes. */
function surveyScene() {
  const axes = levelledAxes();
  const level = (p) => axes.map((axis) => dot(axis, p));
  const step = Math.max(1, Math.floor(cloud.count / 20000));
  const samples = [[], [], []];
  const codes = [];
  for (let i = 0; i < cloud.count; i += step) {
    level(cloud.world(i)).forEach((v, axis) => samples[axis].push(v));
    codes.push(cloud.value[i * 2 + 1]);
  }
  [...samples, codes].forEach((list) => list.sort((a, b) => a - b));
  const bulk = (share) => samples.map((s) => (s.length ? quantile(s, share) : Infinity * (share < 0.5 ? 1 : -1)));
  const box = { low: bulk(0.02), high: bulk(0.98) };
  const widen = (p) => p.forEach((v, i) => {
    box.low[i] = Math.min(box.low[i], v);
    box.high[i] = Math.max(box.high[i], v);
  });
  for (let i = 0; i < keyframes.count; i++) widen(level(keyframes.column(i, 3)));
  for (let i = 0; i < trajectory.count; i++) widen(level(Array.from(trajectory.position.subarray(i * 3, i * 3 + 3))));
  if (!Number.isFinite(box.low[0])) Object.assign(box, { low: [-1, -1, -1], high: [1, 1, 1] });
  const size = norm(add(box.high, box.low, -1)) || 1;
  const heights = samples[2].length ? [quantile(samples[2], 0.02), quantile(samples[2], 0.98)] : [0, 1];
  if (heights[1] <= heights[0]) heights[1] = heights[0] + size * 1e-3;
  const span = codes.length ? [quantile(codes, 0.02), quantile(codes, 0.98)] : [0, 255];
  return { axes, level, box, size, heights, codes: span[1] > span[0] ? span : [span[0] - 1, span[0] + 1] };
}
