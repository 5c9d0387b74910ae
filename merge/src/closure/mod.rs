//! One loop closure between two maps, from the matched place to the motion that joins them: §IV-B to §IV-D of the
//! paper in their order.
//!
//! ```text
//! place (i, j) → neighbours → pairs z = −1, 0, 1 → σ_z → σ* → clouds aligned → ICP → direct refinement → motion
//! ```
//!
//! The paper ends with ICP on one pair. Here every pair is then refined on its images, and the motion of the maps is
//! the mean of all that agree, weighted by information; the disagreement is evidence for or against the closure.

mod neighbourhood;
mod params;
mod refusal;
mod steps;

pub use neighbourhood::{
    NeighbourhoodParams, NeighbourhoodPose, close_neighbourhood, matches_at, neighbourhood_pose,
};
pub use params::ClosureParams;
pub use refusal::ClosureRefusal;

use crate::alignment::PairPoses;
use crate::direct::{DirectAlignment, DirectRefusal};
use crate::estimate::Estimate;
use crate::icp::{IcpRefusal, Registration};
use crate::optimal_scale::{Neighbourhood, OptimalScale, OptimalScaleRefusal, algorithm_1, inverse_variance};
use crate::pair::{Pair, PairRefusal, ViewPair};
use crate::pairing::Travel;
use crate::prepared::PreparedMap;
use geometry::Sim3;
use map::KeyframeId;
use serde::{Deserialize, Serialize};
use steps::Chosen;

/// What became of one of the three pairs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairOutcome {
    /// Keyframe of the source.
    pub source: KeyframeId,
    /// Keyframe of the target.
    pub target: KeyframeId,
    /// Scale and similarity from the key points.
    pub measured: Result<Pair, PairRefusal>,
    /// The refinement on the images; nothing where the closure ended before.
    pub direct: Option<Result<DirectAlignment, DirectRefusal>>,
    /// target_world_from_source_world as this pair alone has it.
    pub motion: Option<Estimate>,
    /// Whether it went into the closure's motion.
    pub agrees: bool,
}

/// A loop closure between two maps with its evidence. Whether it may be believed is for
/// [`acceptance`](crate::acceptance) to say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Closure {
    /// Whether the agents travelled the same way.
    pub travel: Travel,
    /// The pairs z = −1, 0, 1; `None` where the maps have no such neighbours.
    pub pairs: [Option<PairOutcome>; 3],
    /// Which of them gave the initial guess, an index into `pairs`.
    pub chosen: usize,
    /// Where no pair sufficed alone: what the key points of all keyframes around the place say together.
    pub pooled: Option<Pooled>,
    /// σ_z of the three pairs, target world units per source world unit.
    pub scales: Neighbourhood,
    /// σ* by inverse variance, in the same unit.
    pub scale: OptimalScale,
    /// σ* by the paper's Algorithm 1, to compare.
    pub algorithm_1: Result<OptimalScale, OptimalScaleRefusal>,
    /// The keyframes' poses of the chosen pair.
    pub poses: PairPoses,
    /// T_IG of Eq. 8.
    pub initial_guess: Sim3,
    /// T_Ftrans of §IV-D2: the registration of the chosen pair's clouds.
    pub registration: Result<Registration, IcpRefusal>,
    /// target_world_from_source_world: the mean of the pairs that agree.
    pub motion: Estimate,
    /// The same between the keyframes of the chosen pair, target_from_source.
    pub at_keyframes: Estimate,
    /// How far the points of the chosen target keyframe are from its camera, its unit: the median.
    pub reach: f64,
}

/// What the key points of the keyframes around a place say together of the pose that gave the initial guess.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pooled {
    /// Those that agree with it, each counted once.
    pub matches: usize,
    /// ln of how many sets of as many would if all were wrong.
    pub ln_false_alarms: f64,
}

impl Closure {
    /// The closure with the poses that its keyframes have by now, as long as their depths are as they were; nothing where one is gone.
    /// What single pairs say of the worlds ([`PairOutcome::motion`]) stays as it was.
    pub fn moved(&self, source: &PreparedMap, target: &PreparedMap) -> Option<Self> {
        let chosen = self.pairs[self.chosen].as_ref()?;
        let poses = PairPoses {
            source_world_from_source: source.world_from(chosen.source)?,
            target_world_from_target: target.world_from(chosen.target)?,
        };
        let motion = poses.of_worlds(&self.at_keyframes)?;
        Some(Self { poses, motion, ..self.clone() })
    }

    /// The pairs that went into the motion.
    pub fn consistent_pairs(&self) -> impl Iterator<Item = &PairOutcome> {
        self.pairs.iter().flatten().filter(|pair| pair.agrees)
    }
}

/// Follows one matched place through all steps.
///
/// # Errors
/// When a step that nothing can replace fails: no pair has a scale, the scales contradict each other, or no pair
/// gives a motion.
pub fn close(
    source: &PreparedMap,
    target: &PreparedMap,
    place: ViewPair,
    params: &ClosureParams,
) -> Result<Closure, ClosureRefusal> {
    let keyframes = (place.source, place.target);
    let (travel, views) = steps::neighbours(source, target, place, params);
    let pairs = steps::measure(source, target, views, params);
    let index = steps::choose(&pairs)?;
    let outcome = pairs[index].as_ref().ok_or(ClosureRefusal::NoMotion)?;
    let chosen = Chosen::new(source, target, outcome, params).ok_or(ClosureRefusal::NoMotion)?;
    let scales = steps::scales(source, target, &pairs);
    let volume_ratio = steps::ratio_of_volumes(&chosen);
    let scale = inverse_variance(&scales, volume_ratio, &params.optimal_scale)?;
    let travel = Some(travel).filter(|travel| *travel != Travel::Unknown);
    let start = Start { keyframes, travel, pairs, index, chosen, scales, volume_ratio, scale, pooled: None };
    finish(source, target, start, params)
}

/// What the steps before registration gave.
struct Start {
    /// The keyframes of the place, source and target.
    keyframes: (KeyframeId, KeyframeId),
    /// How the agents travelled, where the matches tell.
    travel: Option<Travel>,
    /// The measured pairs.
    pairs: [Option<PairOutcome>; 3],
    /// Which of them is chosen.
    index: usize,
    /// That one.
    chosen: Chosen,
    /// σ_z of the pairs.
    scales: Neighbourhood,
    /// r_vol of the chosen one.
    volume_ratio: f64,
    /// σ*.
    scale: OptimalScale,
    /// As [`Closure::pooled`].
    pooled: Option<Pooled>,
}

/// Registration, refinement on the images, and the motion on which the pairs agree.
fn finish(
    source: &PreparedMap,
    target: &PreparedMap,
    start: Start,
    params: &ClosureParams,
) -> Result<Closure, ClosureRefusal> {
    let Start { keyframes, travel, mut pairs, index, chosen, scales, volume_ratio, scale, pooled } = start;
    let initial_guess = chosen.initial_guess(&scale);
    let registration = chosen.register(&scale, &initial_guess, params);
    // Clouds of few, far points may slide: the images then start from where the key points are.
    let registered = registration.as_ref().ok().map(|found| found.target_from_source);
    let refinements = [Some(Sim3::identity()), registered];
    let starts: Vec<Sim3> = refinements
        .iter()
        .flatten()
        .map(|refinement| chosen.world_motion(&scale, &initial_guess, refinement))
        .collect();
    steps::refine(source, target, &mut pairs, &starts, params);
    let at_keyframes = steps::motion(&chosen, &mut pairs, params)?;
    let motion = chosen.poses.of_worlds(&at_keyframes).ok_or(ClosureRefusal::NoMotion)?;
    let travel =
        travel.unwrap_or_else(|| steps::travel_of_paths(source, target, keyframes, &motion.a_from_b));
    Ok(Closure {
        travel,
        pairs,
        chosen: index,
        pooled,
        scales,
        scale,
        algorithm_1: algorithm_1(&scales, volume_ratio, &params.optimal_scale),
        initial_guess,
        registration,
        motion,
        at_keyframes,
        reach: chosen.reach(),
        poses: chosen.poses,
    })
}
