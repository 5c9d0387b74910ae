//! Direct Sim(3) alignment of two keyframes (Engel 2014, §3.5, Eq. 16–20).
//!
//! Minimises photometric and depth residuals together, each normalised by its variance, over the
//! similarity between the keyframes and an affine change of brightness; coarse to fine. The depth
//! residual is what fixes the scale. A loop is trusted when the alignments both ways agree.

mod band;
mod cells;
mod compare;
mod foreground;
mod level;
mod level_depth;
mod params;
mod patches;
mod reciprocal;
mod residual;
mod surface;
mod view;

#[cfg(test)]
mod tests;

pub use band::{GrainParams, Layer};
pub use cells::{CellMatch, CellParams};
pub use compare::{CompareParams, Comparison, compare};
pub use params::Sim3AlignParams;
pub use patches::{PatchComparison, PatchParams, compare_patches};
pub use reciprocal::{ReciprocalVerdict, reciprocal};
pub use surface::{Surface, SurfaceParams};
pub use view::KeyframeView;

use geometry::{Se3, Sim3};
use level::{LevelProblem, Linearisation};
use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};
use residual::State;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A similarity between two keyframes with its evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Sim3Alignment {
    /// Maps points of the source's camera frame and unit into the target's.
    pub target_from_source: Sim3,
    /// Information of the left perturbation `true = exp(ε) ∘ target_from_source`, tangent order
    /// (υ, ω, λ), brightness eliminated, corrected for the correlation of neighbouring pixels and
    /// for residuals larger than their variances say.
    pub information: SMatrix<f64, 7, 7>,
    /// Brightness change `target = e^a · source + b`, b in grey levels.
    pub brightness: [f64; 2],
    /// Share of the used points whose joint residual lies within the Huber width, 0–1.
    pub inlier_share: f32,
    /// Root mean square photometric residual over the used points, grey levels.
    pub rmse: f32,
    /// Source points, of those used, that project into the target at the finest level.
    pub used: usize,
    /// Share of the source's points that do, 0–1.
    pub overlap: f32,
    /// Share of the used points that meet a pixel with depth in the target, 0–1.
    pub depth_overlap: f32,
}

/// Why two keyframes could not be aligned.
#[derive(Clone, Copy, Debug, PartialEq, Error, Serialize, Deserialize)]
pub enum AlignRefusal {
    /// The starting similarity is not finite.
    #[error("the starting similarity is not finite")]
    InvalidGuess,
    /// A level of the source has too few points with depth.
    #[error("the source has only {points} points with depth at pyramid level {level}")]
    TooFewPoints {
        /// Points there are.
        points: usize,
        /// Pyramid level.
        level: usize,
    },
    /// Too few of the source's points project into the target.
    #[error("only {share} of the source's points project into the target")]
    OutOfView {
        /// Share that does, 0–1.
        share: f32,
    },
    /// Too few points meet a depth in the target: the scale would be guessed.
    #[error("only {share} of the projected points meet a depth in the target")]
    TooLittleDepth {
        /// Share that does, 0–1.
        share: f32,
    },
    /// The normal equations are singular: the images do not fix all seven degrees of freedom.
    #[error("the images do not fix the similarity")]
    Degenerate,
    /// Too few points agree.
    #[error("only {share} of the points agree")]
    FewInliers {
        /// Share that does, 0–1.
        share: f32,
    },
}

/// Aligns `source` with `target`, starting from `guess`.
pub fn align(
    source: &KeyframeView,
    target: &KeyframeView,
    guess: Sim3,
    params: &Sim3AlignParams,
) -> Result<Sim3Alignment, AlignRefusal> {
    align_from(source, target, &[guess], params)
}

/// Aligns `source` with `target` from the best of several starts: each is minimised at the coarsest
/// level, which is cheap, and the one of lowest energy goes on to the finer ones.
///
/// Refuses with the reason of the first start when none can be minimised.
pub fn align_from(
    source: &KeyframeView,
    target: &KeyframeView,
    guesses: &[Sim3],
    params: &Sim3AlignParams,
) -> Result<Sim3Alignment, AlignRefusal> {
    let top = source.levels().min(target.levels()) - 1;
    let finest = params.finest_level.min(top);
    let coarsest = params.coarsest_level.clamp(finest, top);
    let problem = LevelProblem::new(source, target, coarsest, params);
    let mut best = Err(AlignRefusal::InvalidGuess);
    for (i, guess) in guesses.iter().enumerate() {
        let start = State { target_from_source: *guess, brightness: [0.0; 2] };
        let found = if guess.is_valid() { problem.minimise(start) } else { Err(AlignRefusal::InvalidGuess) };
        let better = match (&found, &best) {
            (Ok((_, new)), Ok((_, old))) => problem.score(new) < problem.score(old),
            (Ok(_), Err(_)) => true,
            (Err(_), _) => i == 0,
        };
        if better {
            best = found;
        }
    }
    let (mut state, mut linear) = best?;
    for level in (finest..coarsest).rev() {
        (state, linear) = LevelProblem::new(source, target, level, params).minimise(state)?;
    }
    finish(&state, &linear, params)
}

/// `guess` and turns about the target's camera centre, `angle` radians apart: yaw and pitch to each
/// side, yaw twice as far, and roll. In a coarse image a shift of the camera looks much like a turn,
/// so these cover wrong translations as well.
pub fn turned_starts(guess: Sim3, angle: f64) -> Vec<Sim3> {
    let turns = [
        [0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [1.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        [0.0, -2.0, 0.0],
        [0.0, 0.0, 1.5],
        [0.0, 0.0, -1.5],
    ];
    let turned = |axis: [f64; 3]| {
        Sim3::from(Se3::new(UnitQuaternion::from_scaled_axis(Vector3::from(axis) * angle), Vector3::zeros()))
            * guess
    };
    turns.map(turned).to_vec()
}

/// Judges the alignment at the finest level and marginalises brightness out of its information.
fn finish(
    state: &State,
    linear: &Linearisation,
    params: &Sim3AlignParams,
) -> Result<Sim3Alignment, AlignRefusal> {
    let inlier_share = linear.inlier_share();
    if inlier_share < params.min_inlier_share {
        return Err(AlignRefusal::FewInliers { share: inlier_share });
    }
    let hessian = &linear.hessian;
    let brightness = hessian.fixed_view::<2, 2>(7, 7).try_inverse().ok_or(AlignRefusal::Degenerate)?;
    let coupling = hessian.fixed_view::<7, 2>(0, 7);
    let marginal = hessian.fixed_view::<7, 7>(0, 0) - coupling * brightness * coupling.transpose();
    // Residuals larger than their variances say mean that the variances are too small.
    let residual_scale = linear.mean_energy().max(1.0);
    // Points left out would say what their neighbours say: as much as all know.
    let count = linear.stride as f64;
    let information =
        (marginal + marginal.transpose()) * (0.5 * count / (residual_scale * params.pixel_correlation));
    if information.cholesky().is_none() {
        return Err(AlignRefusal::Degenerate);
    }
    Ok(Sim3Alignment {
        target_from_source: state.target_from_source,
        information,
        brightness: state.brightness,
        inlier_share,
        rmse: linear.photometric_rmse(),
        used: linear.used,
        overlap: linear.overlap(),
        depth_overlap: linear.depth_overlap(),
    })
}

/// Tangent of the nine unknowns: (υ, ω, λ, a, b).
type Vector9 = SVector<f64, 9>;
/// Normal matrix of the nine unknowns.
type Matrix9 = SMatrix<f64, 9, 9>;
