// The camera that orbits in the levelled frame (z up).

import { add, cross, dot, multiply, perspective, scaled, viewMatrix } from "./vectors.js";
/** @import { Box, CameraState, Vector } from "./types.js" */

const FIELD_OF_VIEW = 0.8; // radians, vertical

/** A turntable camera: looks at `target` from `distance`, angles in radians. */
export class OrbitCamera {
  constructor() {
    /** @type {Vector} */
    this.target = [0, 0, 0];
    this.azimuth = Math.PI;
    this.elevation = 0.5;
    this.distance = 10;
    this.fov = FIELD_OF_VIEW;
  }

  /** Right, up and back (from the target to the eye). */
  axes() {
    const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    const back = [ce * ca, ce * sa, se];
    const right = [-sa, ca, 0];
    return { right, up: cross(back, right), back };
  }

  eye() {
    return add(this.target, this.axes().back, this.distance);
  }

  near() {
    return this.distance * 0.01;
  }

  /** Clip from levelled world, for a canvas whose first `covered` pixels on the left are not free. @param {number} width @param {number} height @param {number} covered @param {number} reach */
  clipFromWorld(width, height, covered, reach) {
    const { right, up, back } = this.axes();
    const projection = perspective(this.fov, width / height, this.near(), this.distance + reach);
    projection[8] = -covered / width;
    return multiply(projection, viewMatrix(right, up, back, this.eye()));
  }

  /** Turns by pixels of a drag. @param {number} dx @param {number} dy */
  orbit(dx, dy) {
    this.azimuth -= dx * 0.006;
    this.elevation = Math.max(-1.57, Math.min(1.57, this.elevation + dy * 0.006));
  }

  /** Length in the target's plane that one pixel covers. @param {number} height */
  unitsPerPixel(height) {
    return (2 * Math.tan(this.fov / 2) * this.distance) / height;
  }

  /** Moves with the ground under a drag of pixels. @param {number} dx @param {number} dy @param {number} height */
  pan(dx, dy, height) {
    const { right, up } = this.axes();
    const unit = this.unitsPerPixel(height);
    this.target = add(add(this.target, right, -dx * unit), up, dy * unit);
  }

  /** Changes the distance, keeping what is `(x, y)` pixels right of and below the middle in place. @param {number} factor @param {number} x @param {number} y @param {number} height */
  zoom(factor, x, y, height) {
    this.pan(-x * (1 - factor), -y * (1 - factor), height);
    this.distance *= factor;
  }

  /** The state that shows a box of the levelled world from the given angles. @param {Box} box @param {number} azimuth @param {number} elevation @param {number} aspect @returns {CameraState} */
  fitted(box, azimuth, elevation, aspect) {
    const camera = Object.assign(new OrbitCamera(), { azimuth, elevation });
    const { right, up, back } = camera.axes();
    const centre = scaled(add(box.low, box.high), 0.5);
    const tanY = Math.tan(FIELD_OF_VIEW / 2), tanX = tanY * aspect;
    let distance = 1e-6;
    for (let corner = 0; corner < 8; corner++) {
      const p = [0, 1, 2].map((i) => (corner >> i & 1 ? box.high[i] : box.low[i]) - centre[i]);
      distance = Math.max(distance, dot(p, back) + Math.max(Math.abs(dot(p, right)) / tanX, Math.abs(dot(p, up)) / tanY));
    }
    return { target: centre, azimuth, elevation, distance: distance * 1.04, fov: FIELD_OF_VIEW };
  }

  /** The state that looks out of a keyframe; roll is given up. @param {Vector} centre @param {Vector} forward @param {number} distance @param {number} fov @returns {CameraState} */
  through(centre, forward, distance, fov) {
    const back = scaled(forward, -1);
    return {
      target: add(centre, forward, distance),
      azimuth: Math.atan2(back[1], back[0]),
      elevation: Math.asin(Math.max(-1, Math.min(1, back[2]))),
      distance,
      fov,
    };
  }

  /** A state between two others, the azimuth going the shorter way. @param {CameraState} a @param {CameraState} b @param {number} t @returns {CameraState} */
  static between(a, b, t) {
    /** @param {number} u @param {number} v */
    const mix = (u, v) => u + t * (v - u);
    const turn = Math.atan2(Math.sin(b.azimuth - a.azimuth), Math.cos(b.azimuth - a.azimuth));
    return {
      target: a.target.map((v, i) => mix(v, b.target[i])),
      azimuth: a.azimuth + t * turn,
      elevation: mix(a.elevation, b.elevation),
      distance: Math.exp(mix(Math.log(a.distance), Math.log(b.distance))),
      fov: mix(a.fov, b.fov),
    };
  }

  /** @returns {CameraState} */
  state() {
    const { target, azimuth, elevation, distance, fov } = this;
    return { target, azimuth, elevation, distance, fov };
  }
}
