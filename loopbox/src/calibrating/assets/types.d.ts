// What the pages of a calibration are handed (`report.rs`, `coaching.rs`). Nothing of it is in a page.

/** An image that the board was looked for in. */
export interface View extends Omit<PackedView, "corners"> {
  /** Five numbers a corner: x, y, residual x, residual y, used. */
  corners: Float32Array;
}

/** The same as the page is handed it. */
export interface PackedView {
  name: string;
  used: boolean;
  count: number;
  rms: number | null;
  edge_width: number | null;
  tilt: number | null;
  distance: number | null;
  reason: string | null;
  corners: string;
}

/** A parameter of the calibration. */
export interface Parameter {
  name: string;
  value: string;
  sigma: string;
}

/** Where a calibration that goes on stands. */
export interface CoachStatus {
  state: string;
  images: number;
  views: number;
  share: number;
  cells: number[];
  size: [number, number];
  missing: string[];
  verdict: string;
  result: string;
  waits: boolean;
}
