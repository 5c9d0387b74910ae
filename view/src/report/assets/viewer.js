// Draws cloud, trajectory, keyframes and edges.

import { OrbitCamera } from "./camera.js";
import { cloud } from "./cloud.js";
import { COLOURS } from "./colours.js";
import { LINE_FRAGMENT, LINE_VERTEX, Lines, POINT_FRAGMENT, POINT_VERTEX, PictureQuad, program, setSampling } from "./gl.js";
import { quantile, roundStep, unpack } from "./numbers.js";
import { LINE_COLOURS, Overlays, marker } from "./overlays.js";
import { Drawing, data } from "./page.js";
import { pointAt } from "./points.js";
import { agents, keyframes, pictureImages, shared, spans, trajectory } from "./scene.js";
import { surveyScene } from "./survey.js";
import { add, dot, multiply, norm, transform } from "./vectors.js";
/** @import { Block, Box } from "./points.js" */
/** @import { Camera, Colour, Place, Program, Segment, TakesSegments, Vector } from "./types.js" */

/** The box in which nothing is cut away. */
const EVERYWHERE = { low: [-Infinity, -Infinity, -Infinity], high: [Infinity, Infinity, Infinity] };

/**
 * How the scene is shown: the colours' mode, pixels of a point, the largest code of σ, whether the selected keyframe's points are
 * shown alone, what is drawn, the agents shown, and the part that is not cut away.
 * @typedef {{ colour: number, size: number, sigma: number, isolate: boolean, layers: Set<string>, agents: Set<number>, cut: Box | null }} Settings
 */
/**
 * The lines of the scene; of trajectory and keyframes those of each agent.
 * @template L @typedef {{ grid: Lines, edges: Lines, closures: Lines, selected: Lines, trajectory: L[], keyframes: L[] }} SceneLines
 */

/** The scene's lines, empty; each agent's are of a kind. @template {Lines} L @param {WebGL2RenderingContext} gl @param {new (gl: WebGL2RenderingContext) => L} Kind @returns {SceneLines<L>} */
export function sceneLines(gl, Kind) {
  const ofAgents = () => agents.map(() => new Kind(gl));
  return { grid: new Lines(gl), edges: new Lines(gl), closures: new Lines(gl), selected: new Lines(gl), trajectory: ofAgents(), keyframes: ofAgents() };
}

/** Kind of the edges between two agents. */
export const MERGE_EDGE = 3;

export class Viewer extends Drawing {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super(canvas);
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser offers no WebGL 2.");
    this.gl = gl;
    this.scene = surveyScene();
    this.camera = new OrbitCamera();
    /** What is shown, and how. @type {Settings} */
    this.settings = { colour: 0, size: 2, sigma: 255, isolate: false, layers: new Set(), agents: new Set(agents.keys()), cut: null };
    this.covered = 0;
    /** Called when the scene was surveyed anew. @type {(() => void) | null} */
    this.onSurvey = null;
    /** Takes the next image. @type {((image: Blob | null) => void) | null} */
    this.imageTaker = null;
    this.overlays = new Overlays();
    this.frustumSize = this.chooseFrustumSize();
    this.keyframeSpans = spans(keyframes.agent, keyframes.count);
    this.edges = unpack(data.scene.edges, Uint32Array);
    this.markers = agents.map(() => ["start", "end", "here"].map((name) => marker(name, canvas)));
    this.createResources();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.createResources();
      this.selectionChanged();
    });
  }

  /** The colour of an agent's lines; where there is but one, the given colour. @param {number} agent @param {Colour} alone @returns {Colour} */
  lineColour(agent, alone) {
    return agents.length > 1 ? [...agents[agent].color.map((v) => Math.min(1, 0.1 + v / 240)), alone[3]] : alone;
  }

  /** Whether a keyframe's agent is shown. @param {number} keyframe */
  isShown(keyframe) {
    return this.settings.agents.has(keyframes.agent[keyframe]);
  }

  /** The agents shown. */
  shownAgents() {
    return [...agents.keys()].filter((agent) => this.settings.agents.has(agent));
  }

  /** Everything that lives on the graphics card. */
  createResources() {
    const gl = this.gl;
    /** @type {Program} */
    this.pointProgram = program(gl, POINT_VERTEX, POINT_FRAGMENT);
    /** @type {Program} */
    this.lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    /** @type {PictureQuad} */
    this.picture = new PictureQuad(gl);
    /** @type {SceneLines<Lines>} */
    this.lines = sceneLines(gl, Lines);
    this.createCloud();
    this.createColours();
    this.createTrajectory();
    keyframes.agent.forEach((agent, i) => this.pushFrustum(this.lines.keyframes[agent], i, this.frustumSize, this.lineColour(agent, LINE_COLOURS.keyframe)));
    this.lines.keyframes.forEach((lines) => lines.upload());
    this.createEdges();
    this.createGrid();
    this.overlays.create(gl);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Draws segments `[from, to, colour]` of the levelled world over all else, in place of those of that name. @param {string} name @param {Segment[]} segments */
  setOverlay(name, segments) {
    this.overlays.set(name, segments);
    this.redraw();
  }

  createCloud() {
    const gl = this.gl;
    /** @type {WebGLVertexArrayObject} */
    this.cloudArray = gl.createVertexArray();
    gl.bindVertexArray(this.cloudArray);
    /** @type {[location: number, size: number, type: number, values: Uint16Array<ArrayBuffer> | Uint8Array<ArrayBuffer>][]} */
    const attributes = [[0, 4, gl.UNSIGNED_SHORT, cloud.position], [1, 2, gl.UNSIGNED_BYTE, cloud.value]];
    if (cloud.color) attributes.push([2, 3, gl.UNSIGNED_BYTE, cloud.color]);
    attributes.forEach(([location, size, type, values]) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, type, true, 0, 0);
    });
    gl.bindVertexArray(null);
    const { axes } = this.scene;
    const { box_min: low, box_size: size } = data.cloud;
    const columns = [0, 1, 2].map((c) => axes.map((axis) => axis[c] * size[c]));
    const origin = axes.map((axis) => dot(axis, low));
    /** @type {number[]} */
    this.worldFromBox = [...columns[0], 0, ...columns[1], 0, ...columns[2], 0, ...origin, 1];
  }

  createColours() {
    const gl = this.gl;
    /** @type {WebGLTexture} */
    this.colours = gl.createTexture();
    const rows = new Uint8Array([...COLOURS.ordered, ...COLOURS.depth]);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 2, 0, gl.RGB, gl.UNSIGNED_BYTE, rows);
    setSampling(gl, gl.NEAREST);
  }

  /** Joins successive frames; where frames are missing (loss) the line breaks. */
  createTrajectory() {
    const at = (/** @type {number} */ i) => this.trajectoryAt(i);
    this.frameSpans().forEach(([first, end], agent) => {
      const gaps = Array.from(trajectory.frame.slice(first + 1, end), (f, i) => f - trajectory.frame[first + i]);
      const longest = 8 * (gaps.length ? quantile([...gaps].sort((a, b) => a - b), 0.5) : 1);
      const colour = this.lineColour(agent, LINE_COLOURS.trajectory);
      gaps.forEach((gap, i) => {
        if (gap <= longest) this.lines.trajectory[agent].push(at(first + i), at(first + i + 1), colour);
      });
      this.lines.trajectory[agent].upload();
    });
  }

  /** First and end of each agent's frames. */
  frameSpans() {
    return spans(trajectory.agent, trajectory.count);
  }

  /** Where the camera of a frame was, in the levelled world. @param {number} frame @returns {Vector} */
  trajectoryAt(frame) {
    return this.scene.level(Array.from(trajectory.position.subarray(frame * 3, frame * 3 + 3)));
  }

  /** The graph, and the closures between agents with the keyframes they match; of the agents shown. */
  createEdges() {
    const { edges, lines } = this;
    for (let i = 0; i < edges.length; i += 3) {
      const [from, to, kind] = edges.slice(i, i + 3);
      if (!this.isShown(from) || !this.isShown(to)) continue;
      lines.edges.push(this.centre(from), this.centre(to), LINE_COLOURS.edges[kind]);
      if (kind !== MERGE_EDGE) continue;
      lines.closures.push(this.centre(from), this.centre(to), LINE_COLOURS.closure);
      [from, to].forEach((keyframe) => this.pushFrustum(lines.closures, keyframe, this.frustumSize, LINE_COLOURS.closure));
    }
    lines.edges.upload();
    lines.closures.upload();
  }

  createGrid() {
    const { box, heights, size } = this.scene;
    /** @type {number} */
    this.gridStep = roundStep(size / 10);
    const [x0, y0] = [0, 1].map((i) => Math.floor(box.low[i] / this.gridStep - 1) * this.gridStep);
    const [x1, y1] = [0, 1].map((i) => Math.ceil(box.high[i] / this.gridStep + 1) * this.gridStep);
    const z = heights[0];
    /** @param {number} low @param {number} high */
    const count = (low, high) => Math.round((high - low) / this.gridStep);
    for (let i = 0; i <= count(x0, x1); i++) this.lines.grid.push([x0 + i * this.gridStep, y0, z], [x0 + i * this.gridStep, y1, z], LINE_COLOURS.grid);
    for (let i = 0; i <= count(y0, y1); i++) this.lines.grid.push([x0, y0 + i * this.gridStep, z], [x1, y0 + i * this.gridStep, z], LINE_COLOURS.grid);
    this.lines.grid.upload();
  }

  /** Frusta as long as keyframes lie apart, within reason. */
  chooseFrustumSize() {
    const gaps = [];
    for (let i = 1; i < keyframes.count; i++) if (keyframes.agent[i] === keyframes.agent[i - 1]) gaps.push(norm(add(keyframes.column(i, 3), keyframes.column(i - 1, 3), -1)));
    gaps.sort((a, b) => a - b);
    const { size } = this.scene;
    return Math.max(size * 0.008, Math.min(size * 0.03, gaps.length ? quantile(gaps, 0.5) * 0.7 : Infinity));
  }

  /** A keyframe's centre in the levelled world. @param {number} index @returns {Vector} */
  centre(index) {
    return this.scene.level(keyframes.column(index, 3));
  }

  /** Corners of a keyframe's image at depth `size`: top left, top right, bottom left, bottom right. @param {number} index @param {number} size */
  corners(index, size) {
    return this.cornersOf(keyframes.camera(index), [0, 1, 2, 3].map((i) => keyframes.column(index, i)), size);
  }

  /** The same of a camera by its axes and its centre in the world. @param {Camera} camera @param {Vector[]} pose @param {number} size */
  cornersOf({ width, height, fx, fy, cx, cy }, [x, y, z, centre], size) {
    return [[0, 0], [width, 0], [0, height], [width, height]].map(([u, v]) =>
      this.scene.level(add(add(add(centre, x, ((u - 0.5 - cx) / fx) * size), y, ((v - 0.5 - cy) / fy) * size), z, size)));
  }

  /** The edges of a camera's view as far as its image at depth `size`: pairs of points. @param {Camera} camera @param {Vector[]} pose @param {number} size @returns {Vector[][]} */
  frustumEdges(camera, pose, size) {
    const [a, b, c, d] = this.cornersOf(camera, pose, size), eye = this.scene.level(pose[3]);
    return [[a, b], [b, d], [d, c], [c, a], [eye, a], [eye, b], [eye, c], [eye, d]];
  }

  /** @param {TakesSegments} lines @param {number} index @param {number} size @param {Colour} colour */
  pushFrustum(lines, index, size, colour) {
    const pose = [0, 1, 2, 3].map((i) => keyframes.column(index, i));
    this.frustumEdges(keyframes.camera(index), pose, size).forEach(([p, q]) => lines.push(p, q, colour));
  }

  /** Brings the selected keyframe's frustum and picture up to date. */
  selectionChanged() {
    const index = shared.selected;
    this.picture.clear();
    if (index >= 0) {
      const size = this.frustumSize * 3;
      this.pushFrustum(this.lines.selected, index, size, LINE_COLOURS.selected);
      const image = pictureImages.get(index);
      if (image) image.decode().then(() => index === shared.selected && this.showPicture(image, this.corners(index, size)), () => {});
    }
    this.lines.selected.upload();
    this.redraw();
  }

  /** @param {TexImageSource} image @param {Vector[]} corners */
  showPicture(image, corners) {
    this.picture.show(image, corners);
    this.redraw();
  }

  /** Clip from the levelled world, as drawn now. */
  matrix() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return this.camera.clipFromWorld(width || 1, height || 1, this.covered, this.scene.size * 20);
  }

  draw() {
    const gl = this.gl, canvas = this.canvas;
    if (gl.isContextLost() || !canvas.clientWidth) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.063, 0.082, 0.114, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const matrix = this.matrix();
    const { layers } = this.settings;
    if (layers.has("cloud")) this.drawCloud(matrix, ratio);
    if (layers.has("keyframes") && layers.has("picture")) this.drawPicture(matrix);
    this.drawLines(matrix, width, height, ratio);
    this.placeMarkers(matrix);
    if (this.imageTaker) canvas.toBlob(this.imageTaker);
    this.imageTaker = null;
  }

  /** Hands the next image to `take` as a file; a canvas keeps it only until the browser has shown it. @param {(image: Blob | null) => void} take */
  image(take) {
    this.imageTaker = take;
    this.redraw();
  }

  /** Makes ready to draw points: what is the same for all of them. @param {number} ratio */
  beginCloud(ratio) {
    const gl = this.gl, { uniforms, handle } = this.pointProgram, { settings } = this;
    const { codes, heights } = this.scene;
    const { low, high } = settings.cut || EVERYWHERE;
    // Infinity does not reach a shader on every card.
    /** @param {Vector} corner */
    const bounds = (corner) => corner.map((v) => Math.max(-1e30, Math.min(1e30, v)));
    gl.useProgram(handle);
    gl.uniform3fv(uniforms.u_low, bounds(low));
    gl.uniform3fv(uniforms.u_high, bounds(high));
    gl.uniform2f(uniforms.u_heights, heights[0], heights[1]);
    gl.uniform1f(uniforms.u_size, settings.size * ratio);
    gl.uniform1f(uniforms.u_sigma, (settings.sigma + 0.5) / 255);
    gl.uniform2f(uniforms.u_codes, codes[0] / 255, codes[1] / 255);
    gl.uniform1i(uniforms.u_mode, settings.colour);
    gl.uniform1i(uniforms.u_round, settings.size * ratio > 2.5 ? 1 : 0);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
  }

  /** @param {number[]} matrix @param {number} ratio */
  drawCloud(matrix, ratio) {
    const gl = this.gl, { uniforms } = this.pointProgram;
    this.beginCloud(ratio);
    gl.uniformMatrix4fv(uniforms.u_clip_from_box, false, multiply(matrix, this.worldFromBox));
    gl.uniformMatrix4fv(uniforms.u_world_from_box, false, this.worldFromBox);
    gl.uniform3f(uniforms.u_depth, 0, 1, 0);
    gl.uniform1i(uniforms.u_coloured, cloud.color ? 1 : 0);
    gl.bindVertexArray(this.cloudArray);
    for (const { agent, first, end } of this.shownPoints()) {
      gl.uniform3fv(uniforms.u_agent, agents[agent].color.map((v) => v / 255));
      gl.drawArrays(gl.POINTS, first, end - first);
    }
  }

  /** The points shown, but for the cut and the uncertain ones: of each agent the first and the end. */
  shownPoints() {
    const { selected } = shared;
    /** @param {number} agent @param {number[]} span */
    const row = (agent, [first, end]) => ({ agent, first: cloud.starts[first], end: cloud.starts[end] });
    if (this.settings.isolate && selected >= 0) return [row(keyframes.agent[selected], [selected, selected + 1])];
    return this.shownAgents().map((agent) => row(agent, this.keyframeSpans[agent]));
  }

  /** The points shown as blocks (`points.js`). @returns {Block[]} */
  blocks() {
    const held = { matrix: this.worldFromBox, words: cloud.position, wordStride: 4, bytes: cloud.value, byteStride: 2, grey: 0, code: 1, colours: cloud.color };
    return this.settings.layers.has("cloud") ? this.shownPoints().map(({ first, end }) => ({ ...held, first, end })) : [];
  }

  /** The point shown that a place on the canvas means, in the levelled world, or `null`. @param {Place} place */
  pointAt(place) {
    const { clientWidth: width, clientHeight: height } = this.canvas, { sigma, cut } = this.settings;
    return pointAt(this.blocks(), sigma, cut, { clip: this.matrix(), width, height, near: this.camera.near() }, place);
  }

  /** The selected keyframe's picture in its frustum, unless the view is from inside it. @param {number[]} matrix */
  drawPicture(matrix) {
    if (!this.isInsideSelected()) this.picture.draw(matrix);
  }

  isInsideSelected() {
    return shared.selected >= 0 && norm(add(this.camera.eye(), this.centre(shared.selected), -1)) < this.frustumSize;
  }

  /** @param {number[]} matrix @param {number} width @param {number} height @param {number} ratio */
  drawLines(matrix, width, height, ratio) {
    const gl = this.gl, { uniforms, handle } = this.lineProgram, { layers } = this.settings;
    gl.useProgram(handle);
    gl.uniformMatrix4fv(uniforms.u_clip_from_world, false, matrix);
    gl.uniform2f(uniforms.u_viewport, width, height);
    gl.uniform1f(uniforms.u_near, this.camera.near());
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    if (layers.has("grid")) this.lines.grid.draw(this.lineProgram, ratio);
    if (layers.has("edges")) this.lines.edges.draw(this.lineProgram, 1.4 * ratio);
    if (layers.has("keyframes") && !this.isInsideSelected()) this.shownAgents().forEach((agent) => this.lines.keyframes[agent].draw(this.lineProgram, 1.2 * ratio));
    if (layers.has("trajectory")) this.shownAgents().forEach((agent) => this.lines.trajectory[agent].draw(this.lineProgram, 2.4 * ratio));
    gl.disable(gl.DEPTH_TEST);
    if (layers.has("closures") && !this.isInsideSelected()) this.lines.closures.draw(this.lineProgram, 1.3 * ratio);
    if (!this.isInsideSelected()) this.lines.selected.draw(this.lineProgram, 2 * ratio);
    this.overlays.draw(this.lineProgram, ratio);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
  }

  /** Where a point of the levelled world lies on the canvas, CSS pixels; `null` behind the camera. @param {number[]} matrix @param {Vector} point */
  project(matrix, point) {
    const [x, y, , w] = transform(matrix, point);
    if (w < this.camera.near()) return null;
    return [(x / w * 0.5 + 0.5) * this.canvas.clientWidth, (0.5 - y / w * 0.5) * this.canvas.clientHeight];
  }

  /** Dots at each agent's start, its end and its frame pointed at in the plots. @param {number[]} matrix */
  placeMarkers(matrix) {
    this.frameSpans().forEach(([first, end], agent) => {
      const visible = this.settings.agents.has(agent);
      const ends = visible && this.settings.layers.has("trajectory") && end - first > 1;
      const places = [ends ? first : -1, ends ? end - 1 : -1, visible && shared.hoverAt !== null ? shared.framePointedAt(agent) : -1];
      places.forEach((index, i) => {
        const at = index >= 0 ? this.project(matrix, this.trajectoryAt(index)) : null;
        this.markers[agent][i].hidden = !at;
        if (at) this.markers[agent][i].style.transform = `translate(${at[0]}px, ${at[1]}px)`;
      });
    });
  }
}
