//! Merging the maps of two agents by Loop-box: one module per step of the paper, each a function of values.
//!
//! The *source* agent s and the *target* agent t each have keyframes in a world and a unit of length of
//! their own. A loop closure pairs keyframe i of the source with keyframe j of the target.
//!
//! | module | step | paper |
//! |---|---|---|
//! | [`pairing`] | direction of travel, and which neighbours pair up | §IV-B |
//! | [`matching`] | features of two keyframes matched | §IV-C1 |
//! | [`two_view`] | relative pose of one keyframe pair, from matched rays | §IV-C1 |
//! | [`scale_filter`] | scale of one keyframe pair, by a Kalman filter | §IV-C2 |
//! | [`optimal_scale`] | the scale σ* of three adjacent pairs | §IV-C3, Eqs. 4–5, Algorithm 1 |
//! | [`alignment`] | clouds into one frame; the final transform; moving a map | §IV-D1, §IV-E, Eqs. 6–9 |
//! | [`merge_graph`] | every agent's place, by the maximum spanning tree of the merges | §V-D |
//!
//! Finding the pair (i, j) and the fine registration of the clouds are not here.
//! | [`icp`] | fine registration of the clouds and its information matrix | §IV-D2, Eqs. 2–3 |
//!
//! Finding the pair (i, j) and its relative rotation are not here.

pub mod acceptance;
pub mod alignment;
pub mod closure;
pub mod common_map;
pub mod direct;
pub mod estimate;
pub mod further;
pub mod icp;
pub mod key_points;
pub mod matching;
pub mod meeting;
pub mod merge_graph;
pub mod optimal_scale;
pub mod pair;
pub mod pairing;
pub mod point_alignment;
pub mod prepared;
pub mod scale_filter;
pub mod two_view;

#[cfg(test)]
mod test_support;
