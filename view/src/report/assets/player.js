// Plays the frames along the path: every agent's camera where it was since its first frame.

import { LINE_COLOURS } from "./overlays.js";
import { byId } from "./page.js";
import { aheadOf, axesOf, framesAt, playedSeconds } from "./playing.js";
import { agents, keyframes, shared, trajectory } from "./scene.js";
/** @import { Controls } from "./controls.js" */
/** @import { Vector } from "./types.js" */

export class Player {
  /** @param {Controls} controls */
  constructor(controls) {
    this.controls = controls;
    this.seconds = 0;
    /** Seconds that are played. */
    this.most = 0;
    /** The first and the end of each agent's frames. @type {number[][]} */
    this.spans = [];
    /** The moment of the last image while it runs, milliseconds; `null` while it stands. @type {number | null} */
    this.last = null;
    byId("play").addEventListener("click", () => this.toggle());
    byId("player-at").addEventListener("input", () => {
      this.stop();
      this.show(Number(byId("player-at").value));
    });
    byId("player-ride").addEventListener("input", () => this.show(this.seconds));
    controls.viewer.canvas.addEventListener("keydown", (event) => {
      if (event.key !== " ") return;
      event.preventDefault();
      this.toggle();
    });
  }

  /** The time that is left to play is none. */
  isOver() {
    return this.seconds >= this.most;
  }

  toggle() {
    if (this.last !== null) return this.stop();
    this.spans = this.controls.viewer.frameSpans();
    this.most = playedSeconds(trajectory.timestamp, this.spans);
    if (!(this.most > 0)) return undefined;
    if (this.isOver()) this.seconds = 0;
    byId("player").hidden = false;
    byId("player-at").max = String(this.most);
    byId("play").setAttribute("aria-pressed", "true");
    byId("play").textContent = "Pause";
    this.last = performance.now();
    return requestAnimationFrame((now) => this.step(now));
  }

  stop() {
    this.last = null;
    byId("play").setAttribute("aria-pressed", "false");
    byId("play").textContent = "Play";
  }

  /** @param {number} now */
  step(now) {
    if (this.last === null) return;
    // A page in the background is given no images: what was missed is not made up for.
    const passed = Math.min(0.25, Math.max(0, (now - this.last) / 1000));
    this.last = now;
    this.show(Math.min(this.most, this.seconds + passed * Number(byId("player-speed").value)));
    if (this.isOver()) this.stop();
    else requestAnimationFrame((next) => this.step(next));
  }

  /** Shows the cameras at a time. @param {number} seconds */
  show(seconds) {
    const { viewer } = this.controls;
    this.seconds = seconds;
    byId("player-at").value = String(seconds);
    byId("player-time").textContent = `${seconds.toFixed(1)} s`;
    const frames = framesAt(trajectory.timestamp, this.spans, seconds);
    const shown = viewer.shownAgents().filter((agent) => frames[agent] >= 0);
    const size = viewer.frustumSize * 2.2;
    viewer.setOverlay("played", shown.flatMap((agent) => {
      const colour = viewer.lineColour(agent, LINE_COLOURS.played);
      return viewer.frustumEdges(agents[agent].camera, this.pose(frames[agent]), size).map(([p, q]) => [p, q, colour]);
    }));
    if (shown.length) this.followKeyframes(shown[0], frames[shown[0]]);
    if (shown.length && byId("player-ride").checked) this.ride(shown[0], frames[shown[0]]);
    const place = shared.placeOfTime(seconds, frames);
    if (place !== null) shared.hover(place);
    document.documentElement.dataset.played = String(frames[shown[0]] ?? -1);
  }

  /** Axes and centre of a frame's camera in the world; of a LiDAR those of one that looks ahead. @param {number} frame @returns {Vector[]} */
  pose(frame) {
    const centre = Array.from(trajectory.position.subarray(frame * 3, frame * 3 + 3));
    const axes = axesOf(trajectory.rotation.subarray(frame * 4, frame * 4 + 4));
    return [...(agents[trajectory.agent[frame]].isLidar ? aheadOf(axes) : axes), centre];
  }

  /** Selects the keyframe that was taken last. @param {number} agent @param {number} frame */
  followKeyframes(agent, frame) {
    const [first, end] = this.controls.viewer.keyframeSpans ? this.controls.viewer.keyframeSpans[agent] : [0, 0];
    let last = -1;
    for (let i = first; i < end && keyframes.frame[i] <= trajectory.frame[frame]; i++) last = i;
    shared.select(last);
  }

  /** Looks out of a frame's camera. @param {number} agent @param {number} frame */
  ride(agent, frame) {
    const { controls } = this, [, , forward, centre] = this.pose(frame);
    controls.lookOutOf(agents[agent].camera, controls.viewer.scene.level(centre), controls.viewer.scene.level(forward), true);
  }
}
