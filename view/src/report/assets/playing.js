// Where the cameras were at a time since their first frames.


/**
 * The axes of a camera, x, y, z, by its rotation as a quaternion x, y, z, w.
 * @param {ArrayLike<number>} quaternion
 */
export function axesOf(quaternion) {
  const [x, y, z, w] = Array.from(quaternion);
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The axes of a camera in a LiDAR (x forward, y left, z up) that looks ahead, by the LiDAR's. @param {number[][]} axes */
export const aheadOf = ([x, y, z]) => [y.map((v) => -v), z.map((v) => -v), x];

/**
 * Of the ascending times from `first` to before `end` the index of the one nearest to `time`; −1 where there are none.
 * @param {ArrayLike<number>} times @param {number} first @param {number} end @param {number} time
 */
export function nearestTime(times, first, end, time) {
  let low = first, high = end;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1;
    else high = middle;
  }
  if (low === end) return end > first ? end - 1 : -1;
  return low > first && time - times[low - 1] < times[low] - time ? low - 1 : low;
}

/**
 * The frame of each agent at so many seconds after its own first frame, as indices into `times`; −1 before the first and after
 * the last. `spans` are the first and the end of each agent's frames.
 * @param {ArrayLike<number>} times @param {number[][]} spans @param {number} seconds
 */
export function framesAt(times, spans, seconds) {
  return spans.map(([first, end]) => {
    if (first >= end || seconds < 0 || seconds > times[end - 1] - times[first]) return -1;
    return nearestTime(times, first, end, times[first] + seconds);
  });
}

/** The longest time that one agent's frames span. @param {ArrayLike<number>} times @param {number[][]} spans */
export const playedSeconds = (times, spans) => spans.reduce((most, [first, end]) => (end > first ? Math.max(most, times[end - 1] - times[first]) : most), 0);
