// What the pages' scripts share: shapes of what they are handed and hand on. Nothing of it is in a page.

/** A vector: x, y, z and, where it is homogeneous, w; as read from a typed array or made anew. */
export type Vector = number[];
/** Red, green, blue and opacity, each in 0–1. */
export type Colour = number[];
/** Numbers one after the other, of whatever kind of array. */
export type Numbers = ArrayLike<number>;
/** The first and the end of a run of indices, or the low and high end of a range. */
export type Span = [number, number];
/** A line in the levelled world. */
export type Segment = [from: Vector, to: Vector, colour: Colour];
/** A place on the screen, CSS pixels right of and below the canvas's corner. */
export type Place = number[];

/** A box along the axes of the levelled world. */
export interface Box {
  low: Vector;
  high: Vector;
}

/** A pinhole camera, pixels. */
export interface Camera {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
}

/** An agent as the program tells of it; a LiDAR has no camera. */
export interface ToldAgent {
  name: string;
  /** Red, green, blue in 0–255. */
  color: number[];
  camera: Camera | null;
}

/** An agent as it is shown. */
export interface Agent extends ToldAgent {
  camera: Camera;
  isLidar: boolean;
}

/** Where the orbiting camera is: angles in radians. */
export interface CameraState {
  target: Vector;
  azimuth: number;
  elevation: number;
  distance: number;
  fov: number;
}

/** A linked program of the graphics card. */
export interface Program {
  handle: WebGLProgram;
  uniforms: Record<string, WebGLUniformLocation | null>;
}

/** Takes segments, one after the other. */
export interface TakesSegments {
  push(from: Vector, to: Vector, colour: Colour): void;
}

/** The levelled world. */
export interface SurveyedScene {
  /** Ahead, left, up in the world. */
  axes: Vector[];
  level(point: Vector): Vector;
  unlevel(point: Vector): Vector;
  /** Of the bulk of the scene. */
  box: Box;
  /** Of all but a few stray points. */
  whole: Box;
  /** The diagonal of `box`. */
  size: number;
  heights: Span;
  /** Codes of σ that the colours span. */
  codes: Span;
}

/** A panel of plots before its axis is known. */
export interface Plotted {
  title: string;
  unit: string;
  values: Float32Array;
}

/** A panel of plots. */
export interface Panel extends Plotted {
  low: number;
  high: number;
}

/** A panel of plots per frame. */
export interface RowPanel extends Panel {
  /** A colour variable. */
  colour: string;
  /** Lines across it. */
  references: [label: string, value: number][];
}

/** The CSS value of a colour variable. */
export type ReadColour = (name: string) => string;
/** What a panel says at its right: text, colour, weight. */
export type Readout = [text: string, colour: string, weight: number];

/** A JPEG that a page holds; once its image is made, its text is given up. */
export interface Jpeg {
  jpeg: string | null;
  /** The keyframe that it belongs to, an index. */
  keyframe: number | null;
  width: number;
  height: number;
}

/** A key image of the gallery with its depth, packed until it is first drawn. */
export interface KeyImage extends Jpeg {
  keyframe: number;
  depth: string | null;
  colours?: Uint8Array;
}

/** A view by its name. */
export type NamedView = "fit" | "top" | "side";

/** A row of a table of two columns. */
export type Labelled = [label: string, value: string];

/** The panel beside the 3-D view. */
export interface ControlsForm extends HTMLFormElement {
  readonly elements: HTMLFormControlsCollection & { colour: RadioNodeList };
}

/** Elements of the pages' HTML that are of a kind of their own. */
interface Kinds {
  controls: ControlsForm;
  "ask-restart": HTMLDialogElement;
  enlarged: HTMLDialogElement;
  pairs: HTMLTableElement;
  times: HTMLTableElement;
  follow: HTMLInputElement;
  "measured-metres": HTMLInputElement;
  overlay: HTMLInputElement;
  "player-at": HTMLInputElement;
  "player-ride": HTMLInputElement;
  "player-speed": HTMLSelectElement;
  "show-depth": HTMLInputElement;
  sigma: HTMLInputElement;
  size: HTMLInputElement;
  bars: HTMLCanvasElement;
  coverage: HTMLCanvasElement;
  "depth-bar": HTMLCanvasElement;
  distance: HTMLCanvasElement;
  graph: HTMLCanvasElement;
  "legend-bar": HTMLCanvasElement;
  picture: HTMLCanvasElement;
  plots: HTMLCanvasElement;
  positions: HTMLCanvasElement;
  scatter: HTMLCanvasElement;
  scene: HTMLCanvasElement;
  tilt: HTMLCanvasElement;
  "trend-ms": HTMLCanvasElement;
  "trend-share": HTMLCanvasElement;
  turns: HTMLCanvasElement;
  vectors: HTMLCanvasElement;
  "enlarged-next": HTMLButtonElement;
  "enlarged-previous": HTMLButtonElement;
  finish: HTMLButtonElement;
  next: HTMLButtonElement;
  pause: HTMLButtonElement;
  previous: HTMLButtonElement;
  record: HTMLButtonElement;
  restart: HTMLButtonElement;
  save: HTMLButtonElement;
}
/** The kind of the element of a name; text of those that are of no kind of their own is never missing. */
export type ElementOf<I extends string> = (I extends keyof Kinds ? Kinds[I] : HTMLElement) & { textContent: string };
