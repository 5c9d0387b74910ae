//! Merging the maps of two agents by Loop-box: one module per step of the paper, each a function of values.
//!
//! The *source* agent s and the *target* agent t each have keyframes in a world and a unit of length of
//! their own. A loop closure pairs keyframe i of the source with keyframe j of the target.
//!
//! | module | step | paper |
//! |---|---|---|
//! | [`scale_filter`] | scale of one keyframe pair, by a Kalman filter | §IV-C2 |
//! | [`optimal_scale`] | the scale σ* of three adjacent pairs | §IV-C3, Eqs. 4–5, Algorithm 1 |
//! | [`alignment`] | clouds into one frame; the final transform; moving a map | §IV-D1, §IV-E, Eqs. 6–9 |
//! | [`icp`] | fine registration of the clouds and its information matrix | §IV-D2, Eqs. 2–3 |
//!
//! Finding the pair (i, j) and its relative rotation are not here.

pub mod alignment;
pub mod estimate;
pub mod icp;
pub mod key_points;
pub mod optimal_scale;
pub mod point_alignment;
pub mod prepared;
pub mod scale_filter;

#[cfg(test)]
mod test_support;
