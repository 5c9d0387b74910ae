//! Joint optimisation of keyframe poses and inverse depths (windowed bundle adjustment).
//!
//! Each patch's photometric error is replaced by its quadratic expansion around the patch's own
//! minimum: `E ≈ ½ (π(x) − z)ᵀ Λ (π(x) − z)`, with z where the patch was found and Λ from the photometric
//! Hessian there. The optimum over poses and depths is the same to second order as that of the
//! photometric error (Engel 2018, Eq. 4–8), but no image is touched while iterating, edges keep their
//! one-dimensional information, and geometric disturbance (motion that changes while rows are read, calibration) enters Λ as
//! what it is: an uncertainty of position.
//!
//! Depths are eliminated by the Schur complement, one scalar per point; what is left couples keyframes that share
//! points and is solved by sparse Cholesky, so that the whole map's optimisation grows with the map and not with its
//! square.

mod border;
mod calibration;
mod linear;
mod pairs;
mod pose;
mod problem;
mod solve;
#[cfg(test)]
mod tests;
mod uncertainty;

pub(crate) use calibration::{Calibration, DistortedPixel};
pub(crate) use pairs::{Pairs, Relative};
pub(crate) use pose::{PoseSolver, SeenPoint, covariance};
pub(crate) use problem::{
    Problem, WindowObservation, WindowPoint, mahalanobis, predict, robust_cost, robust_weight,
};
pub(crate) use solve::{Limits, solve, solve_within};
pub(crate) use uncertainty::{UNKNOWN, least_variance_by_rotation, variance_by_rotation, variances_by_poses};
