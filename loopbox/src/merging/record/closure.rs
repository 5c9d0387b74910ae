//! An accepted closure in numbers, step by step.

use geometry::Sim3;
use merge::acceptance::Evidence;
use merge::closure::PairOutcome;
use merge::direct::DirectAlignment;
use merge::icp::Registration;
use merge::optimal_scale::{Basis, OptimalScale, PairEstimate};
use merge::pair::Pair;
use merge::pairing::Travel;
use merge::verification::EvaluatedClosure;
use serde::Serialize;

/// What a step gave, or why it gave nothing.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Step<T> {
    /// Its result.
    Done(T),
    /// Its refusal.
    Refused {
        /// The reason, for people.
        refused: String,
    },
}

/// A closure.
#[derive(Clone, Debug, Serialize)]
pub struct ClosureRecord {
    /// How the agents travelled past the place: `same`, `opposite` or `unknown`.
    pub travel: &'static str,
    /// The keyframe pairs z = −1, 0, 1.
    pub pairs: [Option<PairRecord>; 3],
    /// Which of them gave the initial guess: 0, 1 or 2.
    pub chosen: usize,
    /// σ_z of the pairs, target world units per source world unit.
    pub scales: [Option<ScaleRecord>; 3],
    /// σ* by inverse variance, the same unit.
    pub scale: OptimalScaleRecord,
    /// σ by Algorithm 1 of the paper, to compare.
    pub algorithm_1: Step<OptimalScaleRecord>,
    /// The registration of the chosen pair's clouds.
    pub icp: Step<IcpRecord>,
    /// target_world_from_source_world: the mean of the pairs that agree.
    pub target_from_source: Sim3,
    /// What the verdict rests on.
    pub evidence: Evidence,
}

/// A pair of keyframes.
#[derive(Clone, Debug, Serialize)]
pub struct PairRecord {
    /// Keyframe of the target.
    pub target_keyframe: u32,
    /// Keyframe of the source.
    pub source_keyframe: u32,
    /// What the key points gave.
    pub key_points: Step<KeyPointRecord>,
    /// What the images gave; nothing where the closure ended before.
    pub direct: Option<Step<DirectRecord>>,
    /// Whether the pair went into the closure's motion.
    pub agrees: bool,
}

/// The key points of a pair, in the keyframes' own units.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct KeyPointRecord {
    /// γ: matches that agree with one relative pose.
    pub match_count: usize,
    /// Those with depth on both sides.
    pub points: usize,
    /// σ, target keyframe units per source keyframe unit.
    pub scale: f64,
    /// Its standard deviation.
    pub scale_deviation: f64,
}

/// σ_z of a pair.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ScaleRecord {
    /// σ.
    pub scale: f64,
    /// Its standard deviation.
    pub deviation: f64,
    /// γ.
    pub match_count: usize,
}

/// σ of several pairs together.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OptimalScaleRecord {
    /// σ*.
    pub scale: f64,
    /// Its standard deviation.
    pub deviation: f64,
    /// What it rests on: `agreement`, `single`, `centre` or `neighbourhood`.
    pub basis: &'static str,
    /// Which of the pairs went into it.
    pub used: [bool; 3],
    /// Δ: the largest difference between two scales used.
    pub scale_gap: f64,
    /// γ: the mean number of matches of the pairs used.
    pub match_count: f64,
}

/// The direct alignment of a pair.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DirectRecord {
    /// Root mean square photometric residual, grey levels.
    pub rmse: f32,
    /// Share of the pixels with depth that agree, 0–1.
    pub inlier_share: f32,
    /// Share of the pixels with depth that the other keyframe sees, 0–1.
    pub overlap: f32,
    /// How far the alignments both ways are apart, standard deviations.
    pub reciprocal_error: f64,
}

/// The registration of two clouds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct IcpRecord {
    /// Root mean square distance of the points that agree, target units.
    pub rmse: f64,
    /// Share of the correspondences that agree, 0–1.
    pub inlier_share: f64,
    /// Share of the source points near a target point, 0–1.
    pub overlap: f64,
    /// Iterations made.
    pub iterations: usize,
    /// Whether it came to rest.
    pub converged: bool,
}

impl<T> Step<T> {
    fn of<S, E: std::fmt::Display>(result: &Result<S, E>, record: impl FnOnce(&S) -> T) -> Self {
        match result {
            Ok(done) => Self::Done(record(done)),
            Err(refusal) => Self::Refused { refused: refusal.to_string() },
        }
    }
}

impl ClosureRecord {
    pub(super) fn new(evaluated: &EvaluatedClosure) -> Self {
        let closure = &evaluated.closure;
        Self {
            travel: travel_name(closure.travel),
            pairs: std::array::from_fn(|z| closure.pairs[z].as_ref().map(PairRecord::new)),
            chosen: closure.chosen,
            scales: closure.scales.map(|scale| scale.map(ScaleRecord::new)),
            scale: OptimalScaleRecord::new(&closure.scale),
            algorithm_1: Step::of(&closure.algorithm_1, OptimalScaleRecord::new),
            icp: Step::of(&closure.registration, IcpRecord::new),
            target_from_source: closure.motion.a_from_b,
            evidence: evaluated.verdict.evidence,
        }
    }
}

impl PairRecord {
    fn new(pair: &PairOutcome) -> Self {
        Self {
            target_keyframe: pair.target.0,
            source_keyframe: pair.source.0,
            key_points: Step::of(&pair.measured, KeyPointRecord::new),
            direct: pair.direct.as_ref().map(|direct| Step::of(direct, DirectRecord::new)),
            agrees: pair.agrees,
        }
    }
}

impl KeyPointRecord {
    fn new(pair: &Pair) -> Self {
        Self {
            match_count: pair.views.match_count(),
            points: pair.points.len(),
            scale: pair.scale.scale,
            scale_deviation: pair.scale.variance.sqrt(),
        }
    }
}

impl ScaleRecord {
    fn new(estimate: PairEstimate) -> Self {
        let PairEstimate { scale, variance, match_count } = estimate;
        Self { scale, deviation: variance.sqrt(), match_count }
    }
}

impl OptimalScaleRecord {
    fn new(found: &OptimalScale) -> Self {
        Self {
            scale: found.scale,
            deviation: found.variance.sqrt(),
            basis: match found.basis {
                Basis::Agreement => "agreement",
                Basis::Single => "single",
                Basis::Centre => "centre",
                Basis::Neighbourhood => "neighbourhood",
            },
            used: found.used,
            scale_gap: found.scale_gap,
            match_count: found.match_count,
        }
    }
}

impl DirectRecord {
    fn new(found: &DirectAlignment) -> Self {
        let DirectAlignment { rmse, inlier_share, overlap, reciprocal_error, .. } = *found;
        Self { rmse, inlier_share, overlap, reciprocal_error }
    }
}

impl IcpRecord {
    fn new(found: &Registration) -> Self {
        let Registration { rmse, inlier_share, overlap, iterations, converged, .. } = *found;
        Self { rmse, inlier_share, overlap, iterations, converged }
    }
}

fn travel_name(travel: Travel) -> &'static str {
    match travel {
        Travel::Same => "same",
        Travel::Opposite => "opposite",
        Travel::Unknown => "unknown",
    }
}
