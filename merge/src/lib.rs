//! Merging the maps of several agents by Loop-box: one module per step of the paper, each a function of values.
//!
//! The *source* agent s and the *target* agent t each have keyframes in a world and a unit of length of
//! their own. A loop closure pairs keyframe i of the source with keyframe j of the target. [`verification`] leads from
//! proposed places to a closure that may be believed, [`closure`] follows one through the paper's steps, and
//! [`common_map`] makes one map of all.
//!
//! | module | step | paper |
//! |---|---|---|
//! | [`geometry::Sim3`], [`estimate`] | the similarity between two frames (σ, R, t); the same with its information | §III-B, Eq. 1 |
//! | [`prepared`], [`key_points`] | keyframes made ready: 3-D points at their key points | §IV-C1 |
//! | [`pairing`] | direction of travel, and which neighbours pair up; the four states of Fig. 2 | §IV-B |
//! | [`matching`] | features of two keyframes matched | §IV-C1 |
//! | [`two_view`] | relative pose of one keyframe pair, from matched rays | §IV-C1 |
//! | [`scale_filter`] | scale of one keyframe pair, by a Kalman filter | §IV-C2 |
//! | [`point_alignment`] | all seven degrees of freedom over the same matches | ours |
//! | [`pair`] | these three for one pair | §IV-C |
//! | [`generalised_pose`] | the similarity from matches of several keyframes, where depth on one side suffices | ours |
//! | [`optimal_scale`] | the scale σ* of three adjacent pairs | §IV-C3, Eqs. 4–5, Algorithm 1 |
//! | [`alignment`] | clouds into one frame; the final transform; moving maps | §IV-D1, §IV-E, Eqs. 6–9 |
//! | [`icp`] | fine registration of the clouds and its information matrix | §IV-D2, Eqs. 2–3 |
//! | [`direct`] | refinement of a pair on its images | ours |
//! | [`closure`] | one loop closure through all of these | §IV |
//! | [`acceptance`] | whether it may be believed | ours |
//! | [`place_verdict`] | whether the place is one, or two that share things | ours |
//! | [`verification`] | from places proposed to a closure accepted or refused | §IV-B |
//! | [`frame_pose`] | the pose of one image in a map, to be found again from elsewhere | ours |
//! | [`further`] | more closures once the motion is known | ours |
//! | [`method`] | the paper's baselines, at the same closure | §V-B, Appendix A |
//! | [`merge_graph`] | every agent's place, by the maximum spanning tree of the merges | §V-D |
//! | [`common_map`] | fusion of clouds, poses and graphs; undoing a merge; agents that go on | §IV-E |

pub mod acceptance;
pub mod alignment;
pub mod closure;
pub mod common_map;
pub mod direct;
pub mod estimate;
pub mod frame_pose;
pub mod further;
pub mod generalised_pose;
pub mod icp;
pub mod key_points;
pub mod matching;
pub mod merge_graph;
pub mod method;
pub mod optimal_scale;
pub mod overlap;
pub mod pair;
pub mod pairing;
pub mod place_verdict;
pub mod point_alignment;
pub mod prepared;
pub mod rivals;
pub mod scale_filter;
pub mod two_view;
pub mod verification;

#[cfg(test)]
mod test_support;
