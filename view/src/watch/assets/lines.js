// Lines that grow: segments are set by index, and only what changed goes to the graphics card.

import { Lines } from "../../report/assets/gl.js";
import { grown } from "./store.js";
/** @import { Colour, Program, Vector } from "../../report/assets/types.js" */

export class GrowingLines extends Lines {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    super(gl);
    this.values = new Float32Array(0);
    this.held = 0;
    this.count = 0;
    this.changed = [Infinity, 0];
  }

  /** Sets a segment. @param {number} index @param {Vector} from @param {Vector} to @param {Colour} colour */
  set(index, from, to, colour) {
    this.values = grown(this.values, (index + 1) * 10);
    this.values.set(from, index * 10);
    this.values.set(to, index * 10 + 3);
    this.values.set(colour, index * 10 + 6);
    this.count = Math.max(this.count, index + 1);
    this.changed = [Math.min(this.changed[0], index), Math.max(this.changed[1], index + 1)];
  }

  /** Takes segments away from an index on. @param {number} index */
  cut(index) {
    this.count = Math.min(this.count, index);
    this.changed[1] = Math.min(this.changed[1], index);
  }

  /** @param {Program} lineProgram @param {number} width */
  draw(lineProgram, width) {
    const [first, end] = this.changed, gl = this.gl;
    if (end > first) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
      if (this.held < this.values.length) {
        gl.bufferData(gl.ARRAY_BUFFER, this.values, gl.DYNAMIC_DRAW);
        this.held = this.values.length;
      } else {
        gl.bufferSubData(gl.ARRAY_BUFFER, first * 40, this.values.subarray(first * 10, end * 10));
      }
    }
    this.changed = [Infinity, 0];
    super.draw(lineProgram, width);
  }
}
