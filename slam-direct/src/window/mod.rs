//! Joint optimisation of keyframe poses and inverse depths (windowed bundle adjustment).
//!
//! Each patch's photometric error is replaced by its quadratic expansion around the patch's own minimum, with z where
//! the patch was found and Λ from the photometric Hessian there: `E ≈ ½ (π(x) − z)ᵀ Λ (π(x) − z)`. To second order,
//! the optimum over poses and depths is that of the photometric error (Engel 2018, Eq. 4–8). But no image is read
//! while iterating, and edges keep their one-dimensional information. Geometric disturbance (motion that changes
//! while rows are read, calibration) enters Λ as an uncertainty of position.
//!
//! Depths are eliminated by the Schur complement, one scalar per point. The rest couples keyframes that share points
//! and is solved by sparse Cholesky, so the cost of an optimisation of the whole map grows with the map and not with
//! its square.

mod border;
mod calibration;
mod cost;
mod linear;
mod pairs;
mod pose;
mod problem;
mod solve;
#[cfg(test)]
mod tests;
mod uncertainty;

pub(crate) use calibration::{Calibration, DistortedPixel, OTHER_SHUTTER};
pub(crate) use cost::{mahalanobis, predict, robust_cost, robust_weight};
pub(crate) use pairs::{Pairs, Relative};
pub(crate) use pose::{PoseSolver, SeenPoint, add_residual, covariance, robust_covariance};
pub(crate) use problem::{Problem, WindowObservation, WindowPoint};
pub(crate) use solve::{Limits, solve, solve_within, weigh_sensor};
pub(crate) use uncertainty::{UNKNOWN, least_variance_by_rotation, variance_by_rotation, variances_by_poses};
