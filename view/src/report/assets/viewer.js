// Draws cloud, trajectory, keyframes and edges.

const LINE_COLOURS = {
  trajectory: [1, 0.72, 0.2, 1],
  keyframe: [0.46, 0.73, 1, 0.7],
  selected: [1, 0.36, 0.74, 1],
  grid: [0.55, 0.63, 0.74, 0.16],
  closure: [1, 1, 1, 1],
  edges: [[0.6, 0.66, 0.74, 0.5], [0.35, 0.85, 0.72, 0.45], [1, 0.33, 0.36, 1], [0.78, 0.55, 1, 1]],
};

/** The largest of 1, 2, 5 · 10ⁿ that is at most `value`. */
function roundStep(value) {
  const power = Math.pow(10, Math.floor(Math.log10(value)));
  return [5, 2, 1].map((m) => m * power).find((v) => v <= value * 1.0001) || power;
}

/** Kind of the edges between two agents. */
const MERGE_EDGE = 3;

class Viewer extends Drawing {
  constructor(canvas) {
    super(canvas);
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
    if (!this.gl) throw new Error("This browser offers no WebGL 2.");
    this.scene = surveyScene();
    this.camera = new OrbitCamera();
    this.settings = { colour: 0, size: 2, sigma: 255, isolate: false, layers: new Set(), agents: new Set(agents.keys()) };
    this.covered = 0;
    this.frustumSize = this.chooseFrustumSize();
    this.keyframeSpans = spans(keyframes.agent);
    this.frameSpans = spans(trajectory.agent);
    this.edges = unpack(data.scene.edges, Uint32Array);
    this.markers = agents.map(() => ["start", "end", "here"].map((name) => {
      const node = element("div");
      node.className = `marker ${name}`;
      canvas.after(node);
      return node;
    }));
    this.createResources();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.createResources();
      this.selectionChanged();
    });
  }

  /** The colour of an agent's lines; where there is but one, the given colour. */
  lineColour(agent, alone) {
    return agents.length > 1 ? [...agents[agent].color.map((v) => Math.min(1, 0.1 + v / 240)), alone[3]] : alone;
  }

  /** Whether a keyframe's agent is shown. */
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
    this.pointProgram = program(gl, POINT_VERTEX, POINT_FRAGMENT);
    this.lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.pictureProgram = program(gl, PICTURE_VERTEX, PICTURE_FRAGMENT);
    this.lines = {};
    for (const name of ["grid", "edges", "closures", "selected"]) this.lines[name] = new Lines(gl);
    for (const name of ["trajectory", "keyframes"]) this.lines[name] = agents.map(() => new Lines(gl));
    this.pictureQuad = null;
    this.createCloud();
    this.createColours();
    this.createTrajectory();
    keyframes.agent.forEach((agent, i) => this.pushFrustum(this.lines.keyframes[agent], i, this.frustumSize, this.lineColour(agent, LINE_COLOURS.keyframe)));
    this.lines.keyframes.forEach((lines) => lines.upload());
    this.createEdges();
    this.createGrid();
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  createCloud() {
    const gl = this.gl;
    this.cloudArray = gl.createVertexArray();
    gl.bindVertexArray(this.cloudArray);
    [[0, 4, gl.UNSIGNED_SHORT, cloud.position], [1, 2, gl.UNSIGNED_BYTE, cloud.value]].forEach(([location, size, type, values]) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, type, true, 0, 0);
    });
    gl.bindVertexArray(null);
    const { axes, heights } = this.scene;
    const { box_min: low, box_size: size } = data.cloud;
    const columns = [0, 1, 2].map((c) => axes.map((axis) => axis[c] * size[c]));
    const origin = axes.map((axis) => dot(axis, low));
    this.worldFromBox = [...columns[0], 0, ...columns[1], 0, ...columns[2], 0, ...origin, 1];
    const span = heights[1] - heights[0];
    this.heightFromBox = [...columns.map((c) => c[2] / span), (origin[2] - heights[0]) / span];
  }

  createColours() {
    const gl = this.gl;
    this.colours = gl.createTexture();
    const rows = new Uint8Array([...COLOURS.ordered, ...COLOURS.depth]);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 2, 0, gl.RGB, gl.UNSIGNED_BYTE, rows);
    this.setSampling(gl.NEAREST);
  }

  setSampling(filter) {
    const gl = this.gl;
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
  }

  /** Joins successive frames; where frames are missing (loss) the line breaks. */
  createTrajectory() {
    const at = (i) => this.scene.level(Array.from(trajectory.position.subarray(i * 3, i * 3 + 3)));
    this.frameSpans.forEach(([first, end], agent) => {
      const gaps = Array.from(trajectory.frame.slice(first + 1, end), (f, i) => f - trajectory.frame[first + i]);
      const longest = 8 * (gaps.length ? quantile([...gaps].sort((a, b) => a - b), 0.5) : 1);
      const colour = this.lineColour(agent, LINE_COLOURS.trajectory);
      gaps.forEach((gap, i) => {
        if (gap <= longest) this.lines.trajectory[agent].push(at(first + i), at(first + i + 1), colour);
      });
      this.lines.trajectory[agent].upload();
    });
    this.trajectoryAt = at;
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
    this.gridStep = roundStep(size / 10);
    const [x0, y0] = [0, 1].map((i) => Math.floor(box.low[i] / this.gridStep - 1) * this.gridStep);
    const [x1, y1] = [0, 1].map((i) => Math.ceil(box.high[i] / this.gridStep + 1) * this.gridStep);
    const z = heights[0];
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

  /** A keyframe's centre in the levelled world. */
  centre(index) {
    return this.scene.level(keyframes.column(index, 3));
  }

  /** Corners of a keyframe's image at depth `size`: top left, top right, bottom left, bottom right. */
  corners(index, size) {
    const { width, height, fx, fy, cx, cy } = keyframes.camera(index);
    const [x, y, z, c] = [0, 1, 2, 3].map((i) => keyframes.column(index, i));
    return [[0, 0], [width, 0], [0, height], [width, height]].map(([u, v]) =>
      this.scene.level(add(add(add(c, x, ((u - 0.5 - cx) / fx) * size), y, ((v - 0.5 - cy) / fy) * size), z, size)));
  }

  pushFrustum(lines, index, size, colour) {
    const [a, b, c, d] = this.corners(index, size);
    const centre = this.centre(index);
    [[a, b], [b, d], [d, c], [c, a]].forEach(([p, q]) => lines.push(p, q, colour));
    [a, b, c, d].forEach((p) => lines.push(centre, p, colour));
  }

  /** Brings the selected keyframe's frustum and picture up to date. */
  selectionChanged() {
    const index = shared.selected;
    this.pictureQuad = null;
    if (index >= 0) {
      const size = this.frustumSize * 3;
      this.pushFrustum(this.lines.selected, index, size, LINE_COLOURS.selected);
      const image = pictureImages.get(index);
      if (image) image.decode().then(() => index === shared.selected && this.createPicture(image, this.corners(index, size)), () => {});
    }
    this.lines.selected.upload();
    this.redraw();
  }

  createPicture(image, corners) {
    const gl = this.gl;
    const texture = gl.createTexture(), array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
    this.setSampling(gl.LINEAR);
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners.flat()), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
    if (this.picture) {
      gl.deleteTexture(this.picture.texture);
      gl.deleteVertexArray(this.picture.array);
      gl.deleteBuffer(this.picture.buffer);
    }
    this.picture = this.pictureQuad = { texture, array, buffer };
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
  }

  /** Makes ready to draw points: what is the same for all of them. */
  beginCloud(ratio) {
    const gl = this.gl, { uniforms, handle } = this.pointProgram, { settings } = this;
    const { codes } = this.scene;
    gl.useProgram(handle);
    gl.uniform1f(uniforms.u_size, settings.size * ratio);
    gl.uniform1f(uniforms.u_sigma, (settings.sigma + 0.5) / 255);
    gl.uniform2f(uniforms.u_codes, codes[0] / 255, codes[1] / 255);
    gl.uniform1i(uniforms.u_mode, settings.colour);
    gl.uniform1i(uniforms.u_round, settings.size * ratio > 2.5 ? 1 : 0);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
  }

  drawCloud(matrix, ratio) {
    const gl = this.gl, { uniforms } = this.pointProgram, { settings } = this;
    this.beginCloud(ratio);
    gl.uniformMatrix4fv(uniforms.u_clip_from_box, false, multiply(matrix, this.worldFromBox));
    gl.uniform4fv(uniforms.u_height, this.heightFromBox);
    gl.uniform4f(uniforms.u_weight, 0, 0, 0, 1);
    gl.uniform3f(uniforms.u_depth, 0, 1, 0);
    gl.bindVertexArray(this.cloudArray);
    const draw = (agent, [first, end]) => {
      gl.uniform3fv(uniforms.u_agent, agents[agent].color.map((v) => v / 255));
      gl.drawArrays(gl.POINTS, cloud.starts[first], cloud.starts[end] - cloud.starts[first]);
    };
    const { selected } = shared;
    if (settings.isolate && selected >= 0) draw(keyframes.agent[selected], [selected, selected + 1]);
    else this.shownAgents().forEach((agent) => draw(agent, this.keyframeSpans[agent]));
  }

  /** The selected keyframe's picture in its frustum, unless the view is from inside it. */
  drawPicture(matrix) {
    if (!this.pictureQuad || this.isInsideSelected()) return;
    const gl = this.gl;
    gl.useProgram(this.pictureProgram.handle);
    gl.uniformMatrix4fv(this.pictureProgram.uniforms.u_clip_from_world, false, matrix);
    gl.bindTexture(gl.TEXTURE_2D, this.pictureQuad.texture);
    gl.bindVertexArray(this.pictureQuad.array);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  isInsideSelected() {
    return shared.selected >= 0 && norm(add(this.camera.eye(), this.centre(shared.selected), -1)) < this.frustumSize;
  }

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
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
  }

  /** Where a point of the levelled world lies on the canvas, CSS pixels; `null` behind the camera. */
  project(matrix, point) {
    const [x, y, , w] = transform(matrix, point);
    if (w < this.camera.near()) return null;
    return [(x / w * 0.5 + 0.5) * this.canvas.clientWidth, (0.5 - y / w * 0.5) * this.canvas.clientHeight];
  }

  /** Dots at each agent's start, its end and its frame pointed at in the plots. */
  placeMarkers(matrix) {
    this.frameSpans.forEach(([first, end], agent) => {
      const visible = this.settings.agents.has(agent);
      const ends = visible && this.settings.layers.has("trajectory") && end - first > 1;
      const places = [ends ? first : -1, ends ? end - 1 : -1, visible && shared.hoverAt !== null ? framePointedAt(agent) : -1];
      places.forEach((index, i) => {
        const at = index >= 0 ? this.project(matrix, this.trajectoryAt(index)) : null;
        this.markers[agent][i].hidden = !at;
        if (at) this.markers[agent][i].style.transform = `translate(${at[0]}px, ${at[1]}px)`;
      });
    });
  }
}
