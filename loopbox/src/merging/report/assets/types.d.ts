// What the report of a merging is handed (`pair_results.rs`, `matches.rs`, `agents.rs`). Nothing of it is in the page. A number
// that is not finite comes as null.

import type { Jpeg } from "../../../../../view/src/report/assets/types.js";

/** Keyframes of a pair, by their names in their maps. */
export interface Ids {
  source: number;
  target: number;
}

/** A place that was tried. */
export interface Attempt {
  keyframes: Ids;
  match_count: number;
  outcome: string;
}

/** Key-point matches; `pixels` and `depth` are packed. */
export interface Matches {
  count: number;
  with_depth: number;
  candidates: number;
  pixels: string;
  depth: string;
}

/** Direct alignment of two images. */
export interface Direct {
  rmse: number;
  inlier_share: number;
  overlap: number;
}

/** One of the pairs z = −1, 0, 1. */
export interface Pair {
  keyframes: Ids;
  pictures: (number | null)[];
  matches: Matches | null;
  /** With its standard deviation. */
  scale: [number, number] | null;
  direct: Direct | null;
  agrees: boolean;
  verdict: string;
}

/** σ* by an estimator. */
export interface Scale {
  scale: number;
  deviation: number;
  scale_gap: number;
  used: boolean[];
  basis: string;
}

/** What was found, or why it was not. */
export type Outcome<T> = { Ok: T; Err?: undefined } | { Ok?: undefined; Err: string };

/** A closure with its evidence. */
export interface Closure {
  accepted: boolean;
  travel: string;
  evidence: { matches: number; pairs: number; inlier_share: number; agreeing_share: number; rotation_deviation: number; scale_deviation: number };
  pairs: (Pair | null)[];
  chosen: number;
  scale: Scale;
  algorithm_1: Outcome<Scale>;
  registration: Outcome<Direct & { iterations: number; converged: boolean }>;
}

/** What two maps took. */
export interface Seconds {
  places: number;
  meeting: number;
  method: number;
}

/** Two of the maps, indices of the inputs. */
export interface Meeting {
  target: number;
  source: number;
  proposed: number;
  places: Attempt[];
  closure: Closure | null;
  verdict: string;
  refusal: string | null;
  closures: { used: number; rejected: number; failed: number } | null;
  seconds: Seconds;
}

/** A picture, and how many pixels of the keyframe's image make one of it. */
export interface FactoredPicture extends Jpeg {
  factor: number;
}

/** Two agents that closures join. */
export interface Merge {
  agents: [number, number];
  closures: number;
  in_tree: boolean;
}

/** An agent of the group that is shown. */
export interface PlacedAgent {
  keyframes: number;
  way: number[];
  scale: number;
  deviation: { position: number; rotation: number; scale: number };
  confidence: number | null;
}

/** The group that is shown. */
export interface Graph {
  agents: PlacedAgent[];
  merges: Merge[];
  pose_graph: { initial_cost: number; final_cost: number; iterations: number; converged: boolean; suppressed: number } | null;
}

/** Agents that are not shown. */
export interface Group {
  names: string[];
  keyframes: number;
}

/** A column of a table: its head, what it means, and the class of its cells. */
export type Column = string[];
