// The report's 3-D view on a scene that grows: chunks of points with level of detail, lines that follow.

import { Controls } from "../../report/assets/controls.js";
import { LINE_FRAGMENT, LINE_VERTEX, POINT_FRAGMENT, POINT_VERTEX, PictureQuad, program } from "../../report/assets/gl.js";
import { LINE_COLOURS } from "../../report/assets/overlays.js";
import { byId, data } from "../../report/assets/page.js";
import { agents, keyframes, trajectory } from "../../report/assets/scene.js";
import { surveyScene } from "../../report/assets/survey.js";
import { add, multiply, norm } from "../../report/assets/vectors.js";
import { MERGE_EDGE, Viewer, sceneLines } from "../../report/assets/viewer.js";
import { Budget, chunkSphere, frustum, isSeen, shares } from "./detail.js";
import { GrowingLines } from "./lines.js";
import { sampleCloud, store, toWorld } from "./store.js";
/** @import { Block } from "../../report/assets/points.js" */
/** @import { Colour } from "../../report/assets/types.js" */
/** @import { SceneLines } from "../../report/assets/viewer.js" */
/** @import { ChunkPlace, StoredChunk } from "./types.js" */

const LIVE_CAMERA = [1, 0.36, 0.74, 1];
/** Milliseconds between surveys of a growing scene. */
const SURVEY_INTERVAL = 1200;

export class LiveViewer extends Viewer {
  /** How many points may be drawn. */
  budget = new Budget();

  createResources() {
    const gl = this.gl;
    /** @type {WebGLSync | null} */
    this.fence = null;
    this.pointProgram = program(gl, POINT_VERTEX, POINT_FRAGMENT);
    this.lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.picture = new PictureQuad(gl);
    /** @type {SceneLines<GrowingLines>} */
    this.lines = sceneLines(gl, GrowingLines);
    store.chunks.forEach((chunk) => delete chunk.array);
    this.createColours();
    this.redoLines();
    this.overlays.create(gl);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Looks at the whole scene anew: its level, box, colours and sizes. */
  survey() {
    /** The last survey. @type {{ at: number, keyframes: number } | null} */
    this.surveyed = { at: performance.now(), keyframes: keyframes.count };
    sampleCloud();
    this.scene = surveyScene();
    this.frustumSize = this.chooseFrustumSize();
    store.chunks.forEach((chunk) => (chunk.place = null));
    this.redoLines();
    this.setCamera(this.live);
    if (this.onSurvey) this.onSurvey();
  }

  /** Surveys when the scene has outgrown the last one; the level stays once many keyframes agree on it. */
  surveyWhenGrown() {
    const { at, keyframes: then } = this.surveyed || { at: -Infinity, keyframes: 0 };
    if (!keyframes.count || performance.now() - at < SURVEY_INTERVAL) return false;
    if (keyframes.count <= then * 1.04 && then > 0) return false;
    this.survey();
    return true;
  }

  /** Takes in other agents than before, who had these names: who was hidden stays so, and the camera where it is. @param {string[]} before */
  agentsChanged(before) {
    const hidden = new Set(before.filter((_, agent) => !this.settings.agents.has(agent)));
    this.settings.agents = new Set([...agents.keys()].filter((agent) => !hidden.has(agents[agent].name)));
    for (const lines of [...this.lines.trajectory, ...this.lines.keyframes]) lines.release();
    this.lines.trajectory = agents.map(() => new GrowingLines(this.gl));
    this.lines.keyframes = agents.map(() => new GrowingLines(this.gl));
  }

  redoLines() {
    if (!this.lines) return;
    this.createGrid();
    this.lines.keyframes.forEach((lines) => lines.cut(0));
    this.lines.trajectory.forEach((lines) => lines.cut(0));
    /** Of each keyframe which of its agent's it is. @type {number[]} */
    this.slotLines = [];
    /** Keyframes of each agent. @type {number[]} */
    this.agentSlots = agents.map(() => 0);
    this.moved([...Array(keyframes.count).keys()]);
    this.createTrajectory(0);
    this.createEdges();
  }

  /** Keyframes are new or were moved. @param {number[]} slots */
  moved(slots) {
    for (const slot of slots) {
      const agent = keyframes.agent[slot];
      if (this.slotLines[slot] === undefined) this.slotLines[slot] = this.agentSlots[agent]++;
      this.setFrustum(this.lines.keyframes[agent], this.slotLines[slot] * 8, slot, this.frustumSize, this.lineColour(agent, LINE_COLOURS.keyframe));
    }
    this.redraw();
  }

  /** @param {GrowingLines} lines @param {number} first @param {number} slot @param {number} size @param {Colour} colour */
  setFrustum(lines, first, slot, size, colour) {
    let index = first;
    this.pushFrustum({ push: (from, to) => lines.set(index++, from, to, colour) }, slot, size, colour);
  }

  /** The trajectory from a step on; where frames are missing the line breaks. */
  createTrajectory(from = 0) {
    if (!this.slotLines) return;
    // Steps of several agents come only as a whole, agent by agent.
    const first = agents.length > 1 ? 0 : from;
    /** @param {number} i */
    const place = (i) => this.scene.level(Array.from(trajectory.position.subarray(i * 3, i * 3 + 3)));
    const next = agents.map(() => 0);
    if (agents.length === 1) {
      next[0] = Math.max(0, first - 1);
      this.lines.trajectory[0].cut(next[0]);
    }
    for (let i = Math.max(1, first); i < trajectory.count; i++) {
      const agent = trajectory.agent[i];
      const joined = agent === trajectory.agent[i - 1] && trajectory.frame[i] - trajectory.frame[i - 1] <= 12;
      const here = place(i);
      if (agent === trajectory.agent[i - 1]) this.lines.trajectory[agent].set(next[agent]++, joined ? place(i - 1) : here, here, this.lineColour(agent, LINE_COLOURS.trajectory));
    }
    this.redraw();
  }

  createEdges() {
    const { edges, lines } = { edges: store.edges, lines: this.lines };
    for (let i = 0; i < edges.length; i += 3) {
      const [from, to] = [0, 1].map((k) => store.slots.get(edges[i + k])), kind = edges[i + 2];
      if (from === undefined || to === undefined || !this.isShown(from) || !this.isShown(to)) continue;
      lines.closures.push(this.centre(from), this.centre(to), kind === MERGE_EDGE ? LINE_COLOURS.closure : LINE_COLOURS.edges[2]);
    }
    lines.closures.upload();
    lines.edges.upload();
  }

  /** Where the live camera is: axes and centre, or `null`. @param {number[] | null} camera */
  setCamera(camera) {
    /** @type {number[] | null} */
    this.live = camera;
    if (camera && agents.length) {
      const pose = [0, 3, 6, 9].map((at) => camera.slice(at, at + 3));
      this.frustumEdges(agents[0].camera, pose, this.frustumSize * 1.8).forEach(([p, q]) => this.lines.selected.push(p, q, LIVE_CAMERA));
    }
    this.lines.selected.upload();
    this.redraw();
  }

  selectionChanged() {
    this.setCamera(this.live);
  }

  placeMarkers() {
    this.markers.flat().forEach((node) => (node.hidden = true));
  }

  createCloud() {}

  /** Where a chunk lies: its coordinates are pixel and inverse depth, homogeneous, over 65535. @param {StoredChunk} chunk @returns {ChunkPlace} */
  placeOf(chunk) {
    if (chunk.place) return chunk.place;
    const { fx, fy, cx, cy } = chunk.camera, [low, high] = chunk.depth;
    const scale = store.scale[chunk.slot];
    const keyframe = [65535 / fx, 0, 0, 0, 0, 65535 / fy, 0, 0, 0, 0, 0, (high - low) / scale, -cx / fx, -cy / fy, 1, low / scale];
    const columns = [0, 1, 2, 3].map((column) => this.scene.level(keyframes.column(chunk.slot, column)));
    const pose = [...columns[0], 0, ...columns[1], 0, ...columns[2], 0, ...columns[3], 1];
    chunk.sphere = chunk.sphere || chunkSphere(chunk);
    const centre = this.scene.level(toWorld(chunk.slot, chunk.sphere.middle));
    chunk.place = { matrix: multiply(pose, keyframe), centre, radius: chunk.sphere.radius * scale };
    return chunk.place;
  }

  /** Brings a chunk's points to the graphics card. @param {StoredChunk} chunk */
  uploadChunk(chunk) {
    const gl = this.gl, buffer = gl.createBuffer(), array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, chunk.bytes, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 8, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 2, gl.UNSIGNED_BYTE, true, 8, 6);
    const colours = chunk.colours && gl.createBuffer();
    if (colours) {
      gl.bindBuffer(gl.ARRAY_BUFFER, colours);
      gl.bufferData(gl.ARRAY_BUFFER, chunk.colours, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(2);
      gl.vertexAttribPointer(2, 3, gl.UNSIGNED_BYTE, true, 0, 0);
    }
    gl.bindVertexArray(null);
    chunk.array = array;
    chunk.release = () => {
      gl.deleteBuffer(buffer);
      gl.deleteBuffer(colours);
      gl.deleteVertexArray(array);
    };
    return array;
  }

  /** The chunks that are seen, with how much they weigh. @param {number[]} matrix */
  seenChunks(matrix) {
    const planes = frustum(matrix), eye = this.camera.eye(), seen = [];
    for (const chunk of store.chunks.values()) {
      if (!this.settings.agents.has(chunk.agent) || !chunk.count) continue;
      const { matrix: fromChunk, centre, radius } = this.placeOf(chunk);
      if (!isSeen(planes, centre, radius * 1.6)) continue;
      const distance = Math.max(norm(add(centre, eye, -1)) - radius * 0.5, this.camera.near());
      const size = Math.min(1, radius / distance);
      seen.push({ chunk, matrix: fromChunk, count: chunk.count, weight: chunk.count * size * size });
    }
    return seen;
  }

  /** @param {number[]} matrix @param {number} ratio */
  drawCloud(matrix, ratio) {
    const gl = this.gl, { uniforms } = this.pointProgram;
    const seen = this.seenChunks(matrix);
    const counts = shares(seen, this.budget.points);
    this.beginCloud(ratio);
    const [low, high] = data.cloud.inverse_depth, range = high - low;
    let drawn = 0;
    seen.forEach(({ chunk, matrix: m }, i) => {
      if (!counts[i]) return;
      const array = chunk.array ?? this.uploadChunk(chunk);
      const weight = [0, 1, 2, 3].map((c) => m[c * 4 + 3]);
      gl.uniformMatrix4fv(uniforms.u_clip_from_box, false, multiply(matrix, m));
      gl.uniformMatrix4fv(uniforms.u_world_from_box, false, m);
      gl.uniform3f(uniforms.u_depth, weight[2] / range, 0, (weight[3] - low) / range);
      gl.uniform3fv(uniforms.u_agent, agents[chunk.agent].color.map((v) => v / 255));
      gl.uniform1i(uniforms.u_coloured, chunk.colours ? 1 : 0);
      gl.bindVertexArray(array);
      gl.drawArrays(gl.POINTS, 0, counts[i]);
      drawn += counts[i];
    });
    /** Points of the last image. @type {number | undefined} */
    this.drawn = drawn;
    gl.bindVertexArray(null);
  }

  /** The points of the agents shown as blocks (`points.js`): all of them, drawn at the moment or not. @returns {Block[]} */
  blocks() {
    const chunks = [...store.chunks.values()].filter((chunk) => chunk.count && this.settings.agents.has(chunk.agent));
    return chunks.map((chunk) => ({
      matrix: this.placeOf(chunk).matrix, first: 0, end: chunk.count,
      words: chunk.words, wordStride: 4, bytes: chunk.bytes, byteStride: 8, grey: 6, code: 7, colours: chunk.colours,
    }));
  }

  /** Draws, and measures how long the graphics card takes for it; meanwhile no further frame is begun. */
  draw() {
    if (this.fence) {
      this.wanted = true;
      return;
    }
    const gl = this.gl, began = performance.now();
    super.draw();
    if (gl.isContextLost()) return;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (!fence) return;
    this.fence = fence;
    gl.flush();
    const ask = () => {
      if (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return setTimeout(ask, 1);
      gl.deleteSync(fence);
      this.fence = null;
      this.wanted = this.budget.learn(performance.now() - began, this.drawn || 0) || this.wanted;
      this.frames = (this.frames || 0) + 1;
      Object.assign(document.documentElement.dataset, { drawn: this.drawn || 0, points: store.points, frameMs: (performance.now() - began).toFixed(1), frames: this.frames });
      if (this.wanted) {
        this.wanted = false;
        this.redraw();
      }
      return undefined;
    };
    setTimeout(ask, 1);
  }
}

/** The report's controls, for a scene in which nothing is selected. */
export class LiveControls extends Controls {
  /** Offers other agents than before. */
  agentsChanged() {
    const form = byId("controls");
    this.offerAgents(form);
    form.dispatchEvent(new Event("input"));
  }

  keyframeAt() {
    return -1;
  }
}
