// Warnings of a run that stay on its page.

/** @param {{ count: number, frame: number, timestamp: number, why: string }} found the newest place, and how many there are */
export function scaleBreakText({ count, frame, timestamp, why }) {
  const last = count > 1 ? `${count} times, the last time` : "once,";
  return `The scale was not carried on: ${last} some keyframes before frame ${frame} at ${timestamp.toFixed(2)} s (${why}). What is mapped since then is a fragment of its own, with a unit of its own, until a place joins them.`;
}
