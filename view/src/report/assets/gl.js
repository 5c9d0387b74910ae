// The WebGL 2 programs of the 3-D view, and lines.

/** @import { Colour, Program, Vector } from "./types.js" */

export const POINT_VERTEX = `#version 300 es
layout(location = 0) in vec4 a_position;  // x, y, z over the box; inverse depth over its range
layout(location = 1) in vec2 a_value;     // intensity, code of the relative sigma
layout(location = 2) in vec3 a_colour;    // in the image
uniform mat4 u_clip_from_box, u_world_from_box;
uniform vec3 u_low, u_high;               // the part of the levelled world that is not cut away
uniform vec2 u_heights;                   // heights that the colours span
uniform vec3 u_depth;                     // inverse depth over its range = dot(u_depth, (box z, a_position.w, 1))
uniform float u_size, u_sigma;
uniform vec2 u_codes;                     // codes that the colours of confidence span
uniform int u_mode;
uniform bool u_coloured;                  // whether the points have colours
uniform vec3 u_agent;                     // colour of the agent
uniform sampler2D u_colours;              // row 0: ordered, row 1: depth
out vec3 v_colour;
void main() {
  gl_Position = u_clip_from_box * vec4(a_position.xyz, 1.0);
  gl_PointSize = u_size;
  vec4 homogeneous = u_world_from_box * vec4(a_position.xyz, 1.0);
  vec3 place = homogeneous.xyz / homogeneous.w;
  bool cut = any(lessThan(place, u_low)) || any(greaterThan(place, u_high));
  if (cut || a_value.y > u_sigma) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  float t = u_mode == 1 ? (place.z - u_heights.x) / (u_heights.y - u_heights.x) : u_mode == 2 ? dot(u_depth, vec3(a_position.zw, 1.0)) : (u_codes.y - a_value.y) / (u_codes.y - u_codes.x);
  vec3 mapped = texture(u_colours, vec2(clamp(t, 0.0, 1.0) * 255.0 / 256.0 + 0.5 / 256.0, u_mode == 2 ? 0.75 : 0.25)).rgb;
  if (u_mode == 5) mapped = u_coloured ? a_colour : vec3(a_value.x);
  if (u_mode == 4) mapped = min(u_agent * (0.40 + 1.1 * a_value.x), 1.0);
  v_colour = u_mode == 0 ? vec3(0.10) + 0.90 * vec3(a_value.x) : mapped;
}`;

export const POINT_FRAGMENT = `#version 300 es
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
export const LINE_VERTEX = `#version 300 es
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

export const LINE_FRAGMENT = `#version 300 es
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

/** A linked program with its uniforms' locations by name. @param {WebGL2RenderingContext} gl @param {string} vertex @param {string} fragment @returns {Program} */
export function program(gl, vertex, fragment) {
  const handle = gl.createProgram();
  for (const { type, source } of [{ type: gl.VERTEX_SHADER, source: vertex }, { type: gl.FRAGMENT_SHADER, source: fragment }]) {
    // Only where the graphics card is lost there is none, and then it is made once more when it is back.
    const shader = /** @type {WebGLShader} */ (gl.createShader(type));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(handle, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader) ?? "");
  }
  gl.linkProgram(handle);
  if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(handle) ?? "");
  /** @type {Program["uniforms"]} */
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS); i++) {
    const uniform = gl.getActiveUniform(handle, i);
    if (uniform) uniforms[uniform.name] = gl.getUniformLocation(handle, uniform.name);
  }
  return { handle, uniforms };
}

/** Segments of one width in a buffer: pushed on the machine, drawn as instances of four corners. */
export class Lines {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.array = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    /** @type {number[]} */
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

  /** Adds a segment. @param {Vector} from @param {Vector} to @param {Colour} colour */
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

  /** Gives back what the graphics card holds of them. */
  release() {
    this.gl.deleteBuffer(this.buffer);
    this.gl.deleteVertexArray(this.array);
  }

  /** Draws them with the line program in use. @param {Program} lineProgram @param {number} width */
  draw(lineProgram, width) {
    if (!this.count) return;
    const gl = this.gl;
    gl.uniform1f(lineProgram.uniforms.u_width, width);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }
}

/** How the texture that is bound is read between its pixels. @param {WebGL2RenderingContext} gl @param {number} filter */
export function setSampling(gl, filter) {
  for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) {
    gl.texParameteri(gl.TEXTURE_2D, name, value);
  }
}

/** A picture in the world, by its four corners. */
export class PictureQuad {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = program(gl, PICTURE_VERTEX, PICTURE_FRAGMENT);
    /** @type {{ texture: WebGLTexture, array: WebGLVertexArrayObject, buffer: WebGLBuffer } | null} */
    this.held = null;
  }

  /** Shows an image, its corners top left, top right, bottom left, bottom right. @param {TexImageSource} image @param {Vector[]} corners */
  show(image, corners) {
    const { gl } = this;
    this.clear();
    const texture = gl.createTexture(), array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
    setSampling(gl, gl.LINEAR);
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners.flat()), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
    this.held = { texture, array, buffer };
  }

  /** Shows nothing. */
  clear() {
    const { gl, held } = this;
    if (!held) return;
    gl.deleteTexture(held.texture);
    gl.deleteVertexArray(held.array);
    gl.deleteBuffer(held.buffer);
    this.held = null;
  }

  /** @param {number[]} matrix */
  draw(matrix) {
    const { gl, held } = this;
    if (!held) return;
    gl.useProgram(this.program.handle);
    gl.uniformMatrix4fv(this.program.uniforms.u_clip_from_world, false, matrix);
    gl.bindTexture(gl.TEXTURE_2D, held.texture);
    gl.bindVertexArray(held.array);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}
