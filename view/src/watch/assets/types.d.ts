// What the live page's scripts share: what the program tells them, and what they keep of it. Nothing of it is in a page.

import type { Vector } from "../../report/assets/types.js";
import type { Chunk } from "./decode.js";

/** Whom an agent or a station knows (`neighbourhood.rs`). */
export interface Neighbour {
  name: string;
  address: string | null;
  since_s: number;
  why: string | null;
  received: number;
  wanted: number;
  rate: number;
  lacks: number | null;
}

/** A map that is told. */
export interface RemoteMap {
  name: string;
  keyframes: number;
  missing: number;
  finished: boolean;
  is_lidar: boolean;
  is_joined: boolean;
}

/** Two maps that were looked at. */
export interface PairLine {
  names: string[];
  verdict: string;
  why: string | null;
  is_told: boolean;
}

/** Who is near. */
export interface Neighbourhood {
  listening: string | null;
  links: Neighbour[];
  maps: RemoteMap[];
  meetings: PairLine[];
  trouble: string[];
}

/** Where the scale was not carried on. */
export interface ScaleBreaks {
  count: number;
  frame: number;
  timestamp: number;
  why: string;
}

/** Where a run stands (`status.rs`). */
export interface Status {
  state: string;
  paused: boolean;
  recording: boolean | null;
  frame: number;
  frames: number | null;
  dropped: number;
  losses: number;
  loops: number;
  scale_break: ScaleBreaks | null;
  frames_per_s: number;
  ms: number;
  latency_ms: number | null;
  inlier_share: number;
  matched: number;
  /** Null where it is not finite. */
  rmse: number | null;
  keyframes: number;
  points: number;
  memory_bytes: number | null;
  cpu: number | null;
  camera: number[] | null;
  reason: string | null;
  note: string;
  report: boolean;
  folder: string;
  neighbourhood: Neighbourhood | null;
}

/** A sphere. */
export interface Sphere {
  middle: Vector;
  radius: number;
}

/** A chunk where it lies in the levelled world: the matrix from its own coordinates, and a sphere around its bulk. */
export interface ChunkPlace {
  matrix: number[];
  centre: Vector;
  radius: number;
}

/** Points of a keyframe as they are kept. */
export interface StoredChunk extends Chunk {
  /** The keyframe's index. */
  slot: number;
  /** Where it lies; nothing until that is known, and once it has moved. */
  place: ChunkPlace | null;
  /** Around its bulk, in its keyframe's frame and unit. */
  sphere?: Sphere;
  /** What the graphics card holds of it, and what gives that back. */
  array?: WebGLVertexArrayObject;
  release?: () => void;
}

/** What is done with each kind of message; what it says is read off the wire, so that each knows itself what that is. */
export type Handlers = Record<string, ((value: any) => void) | undefined>;
