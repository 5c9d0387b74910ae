// Vectors, matrices (column-major arrays of 16) and the WebGL 2 programs of the 3-D view.

const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => scaled(a, 1 / (norm(a) || 1));

/** The matrix product a·b. */
function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return out;
}

/** A point through a matrix, to `[x, y, z, w]`. */
function transform(m, p) {
  const out = [0, 0, 0, 0];
  for (let r = 0; r < 4; r++) out[r] = m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r];
  return out;
}

/** Perspective projection for a vertical field of view in radians. */
function perspective(fov, aspect, near, far) {
  const f = 1 / Math.tan(fov / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

/** The matrix whose rows are the axes of a view at `eye`: right, up, back. */
function viewMatrix(right, up, back, eye) {
  return [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -dot(right, eye), -dot(up, eye), -dot(back, eye), 1];
}

const POINT_VERTEX = `#version 300 es
layout(location = 0) in vec4 a_position;  // x, y, z over the box; inverse depth over its range
layout(location = 1) in vec2 a_value;     // intensity, code of the relative sigma
uniform mat4 u_clip_from_box;
uniform vec4 u_height, u_weight;          // height over its range = dot(u_height, (box, 1)) / dot(u_weight, (box, 1))
uniform vec3 u_depth;                     // inverse depth over its range = dot(u_depth, (box z, a_position.w, 1))
uniform float u_size, u_sigma;
uniform vec2 u_codes;                     // codes that the colours of confidence span
uniform int u_mode;
uniform vec3 u_agent;                     // colour of the agent
uniform sampler2D u_colours;              // row 0: ordered, row 1: depth
out vec3 v_colour;
void main() {
  gl_Position = u_clip_from_box * vec4(a_position.xyz, 1.0);
  gl_PointSize = u_size;
  if (a_value.y > u_sigma) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  vec4 place = vec4(a_position.xyz, 1.0);
  float t = u_mode == 1 ? dot(u_height, place) / dot(u_weight, place) : u_mode == 2 ? dot(u_depth, vec3(a_position.zw, 1.0)) : (u_codes.y - a_value.y) / (u_codes.y - u_codes.x);
  vec3 mapped = texture(u_colours, vec2(clamp(t, 0.0, 1.0) * 255.0 / 256.0 + 0.5 / 256.0, u_mode == 2 ? 0.75 : 0.25)).rgb;
  if (u_mode == 4) mapped = min(u_agent * (0.40 + 1.1 * a_value.x), 1.0);
  v_colour = u_mode == 0 ? vec3(0.10) + 0.90 * vec3(a_value.x) : mapped;
}`;

const POINT_FRAGMENT = `#version 300 es
precision mediump float;
in vec3 v_colour;
uniform bool u_round;
out vec4 colour;
void main() {
  vec2 d = gl_PointCoord - 0.5;
  if (u_round && dot(d, d) > 0.25) discard;
  colour = vec4(v_colour, 1.0);
}`;

// Lines of any width: four corners per segment, moved apart on the screen.
const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 a_from;
layout(location = 1) in vec3 a_to;
layout(location = 2) in vec4 a_colour;
uniform mat4 u_clip_from_world;
uniform vec2 u_viewport;
uniform float u_width, u_near;
out vec4 v_colour;
void main() {
  vec4 a = u_clip_from_world * vec4(a_from, 1.0), b = u_clip_from_world * vec4(a_to, 1.0);
  v_colour = a_colour;
  if (a.w < u_near && b.w < u_near) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  vec4 a0 = a;
  if (a.w < u_near) a = mix(a, b, (u_near - a.w) / (b.w - a.w));
  if (b.w < u_near) b = mix(b, a0, (u_near - b.w) / (a0.w - b.w));
  vec2 along = (b.xy / b.w - a.xy / a.w) * u_viewport;
  float span = length(along);
  vec2 normal = span > 1e-6 ? vec2(-along.y, along.x) / span : vec2(0.0, 1.0);
  vec4 p = (gl_VertexID & 1) == 0 ? a : b;
  float side = gl_VertexID < 2 ? -1.0 : 1.0;
  gl_Position = p + vec4(normal * side * u_width / u_viewport * p.w, 0.0, 0.0);
}`;

const LINE_FRAGMENT = `#version 300 es
precision mediump float;
in vec4 v_colour;
out vec4 colour;
void main() { colour = vec4(v_colour.rgb * v_colour.a, v_colour.a); }`;

const PICTURE_VERTEX = `#version 300 es
layout(location = 0) in vec3 a_position;
uniform mat4 u_clip_from_world;
out vec2 v_texture;
void main() {
  v_texture = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = u_clip_from_world * vec4(a_position, 1.0);
}`;

const PICTURE_FRAGMENT = `#version 300 es
precision mediump float;
in vec2 v_texture;
uniform sampler2D u_picture;
out vec4 colour;
void main() { colour = vec4(texture(u_picture, v_texture).rgb, 1.0) * 0.93; }`;

/** A linked program with its uniforms' locations by name. */
function program(gl, vertex, fragment) {
  const handle = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(handle, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(handle);
  if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(handle));
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(handle, i);
    uniforms[name] = gl.getUniformLocation(handle, name);
  }
  return { handle, uniforms };
}

/** Segments of one width in a buffer: pushed on the machine, drawn as instances of four corners. */
class Lines {
  constructor(gl) {
    this.gl = gl;
    this.array = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    this.numbers = [];
    this.count = 0;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    [[0, 3, 0], [1, 3, 12], [2, 4, 24]].forEach(([location, size, offset]) => {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, gl.FLOAT, false, 40, offset);
      gl.vertexAttribDivisor(location, 1);
    });
    gl.bindVertexArray(null);
  }

  /** Adds a segment. */
  push(from, to, colour) {
    this.numbers.push(...from, ...to, ...colour);
  }

  /** Sends what was pushed since the last call, replacing what was there. */
  upload() {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(this.numbers), gl.STATIC_DRAW);
    this.count = this.numbers.length / 10;
    this.numbers = [];
  }

  /** Draws them with the line program in use. */
  draw(lineProgram, width) {
    if (!this.count) return;
    const gl = this.gl;
    gl.uniform1f(lineProgram.uniforms.u_width, width);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }
}
