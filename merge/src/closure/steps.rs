//! The steps of [`close`](super::close), each what its name says.

use super::{ClosureParams, ClosureRefusal, PairOutcome};
use crate::alignment::{self, PairPoses};
use crate::direct::refine_directly;
use crate::estimate::{Estimate, mean};
use crate::icp::{self, Cloud, IcpRefusal, Registration, keyframe_cloud};
use crate::optimal_scale::{Neighbourhood, OptimalScale, PairEstimate, volume_ratio};
use crate::pair::{PairRefusal, ViewPair, measure_pair, view_pair};
use crate::pairing::{Travel, pair_neighbours};
use crate::prepared::{PreparedKeyframe, PreparedMap};
use crate::two_view::TwoViewRefusal;
use geometry::{Se3, Sim3};
use map::KeyframeId;
use nalgebra::{SVector, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Two keyframes to be measured, and what their images gave.
pub(super) type Views = (KeyframeId, KeyframeId, Result<ViewPair, TwoViewRefusal>);

/// The views of z = −1, 0, 1 (§IV-B): the centre, and its neighbours paired by the direction of travel.
pub(super) fn neighbours(
    source: &PreparedMap,
    target: &PreparedMap,
    place: ViewPair,
    params: &ClosureParams,
) -> (Travel, [Option<Views>; 3]) {
    let (sources, i) = around(source, place.source);
    let (targets, j) = around(target, place.target);
    let all: Vec<(usize, usize)> = (0..sources.len())
        .flat_map(|s| (0..targets.len()).map(move |t| (s, t)))
        .filter(|&(s, t)| s != i && t != j)
        .collect();
    let mut views: BTreeMap<(usize, usize), Views> = all
        .into_par_iter()
        .filter_map(|(s, t)| {
            let (a, b) = (source.get(sources[s])?, target.get(targets[t])?);
            Some(((s, t), (sources[s], targets[t], view_pair(a, b, &params.pair))))
        })
        .collect();
    let count = |s: usize, t: usize| {
        let found = views.get(&(s, t)).and_then(|(_, _, views)| views.as_ref().ok());
        found.map_or(0, ViewPair::match_count)
    };
    let lengths = (sources.len(), targets.len());
    let pairing = pair_neighbours((i, j), lengths, count, &params.pairing);
    let travel = pairing.map_or(Travel::Unknown, |pairing| pairing.travel);
    // Where the counts cannot say, either pairing serves: the one with more matches.
    let opposite = match travel {
        Travel::Same => false,
        Travel::Opposite => true,
        Travel::Unknown => pairing.is_some_and(|pairing| pairing.opposite_count > pairing.same_count),
    };
    let mut take = |s: Option<usize>, t: Option<usize>| views.remove(&(s?, t?));
    let (before, after) = (i.checked_sub(1), Some(i + 1));
    let (earlier, later) = (j.checked_sub(1), Some(j + 1));
    let [first, last] = if opposite { [later, earlier] } else { [earlier, later] };
    let (first, last) = (take(before, first), take(after, last));
    (travel, [first, Some((place.source, place.target, Ok(place))), last])
}

/// The direction of travel by the cameras' paths at two keyframes, once the maps lie in one world: what is left to tell
/// it where counts of matches cannot. Unknown where a camera stood, or the paths part by more than 60°.
pub(super) fn travel_of_paths(
    source: &PreparedMap,
    target: &PreparedMap,
    keyframes: (KeyframeId, KeyframeId),
    target_from_source: &Sim3,
) -> Travel {
    let step = |map: &PreparedMap, id: KeyframeId| {
        let (before, after) = map.neighbours(id);
        let at = |id: Option<KeyframeId>| Some(map.world_from(id?)?.translation);
        Some(at(after.or(Some(id)))? - at(before.or(Some(id)))?)
    };
    let Some((a, b)) = step(source, keyframes.0).zip(step(target, keyframes.1)) else {
        return Travel::Unknown;
    };
    let cosine = (target_from_source.rotation * a).dot(&b) / (a.norm() * b.norm());
    match cosine {
        cosine if cosine > 0.5 => Travel::Same,
        cosine if cosine < -0.5 => Travel::Opposite,
        _ => Travel::Unknown,
    }
}

/// A keyframe among its neighbours in time, and its position there.
fn around(map: &PreparedMap, id: KeyframeId) -> (Vec<KeyframeId>, usize) {
    let (before, after) = map.neighbours(id);
    let position = usize::from(before.is_some());
    (before.into_iter().chain([id]).chain(after).collect(), position)
}

/// Scale and similarity of each pair (§IV-C).
pub(super) fn measure(
    source: &PreparedMap,
    target: &PreparedMap,
    views: [Option<Views>; 3],
    params: &ClosureParams,
) -> [Option<PairOutcome>; 3] {
    let outcome = |views: Option<Views>| {
        let (i, j, views) = views?;
        let (a, b) = (source.get(i)?, target.get(j)?);
        let measured =
            views.map_err(PairRefusal::from).and_then(|views| measure_pair(a, b, views, &params.pair));
        Some(PairOutcome { source: i, target: j, measured, direct: None, motion: None, agrees: false })
    };
    let [first, centre, last] = views;
    let (first, (centre, last)) =
        rayon::join(|| outcome(first), || rayon::join(|| outcome(centre), || outcome(last)));
    [first, centre, last]
}

/// The pair that gives the initial guess: the one of most matches (§VI: "only one match out of three based on the
/// keypoints").
pub(super) fn choose(pairs: &[Option<PairOutcome>; 3]) -> Result<usize, ClosureRefusal> {
    let count = |pair: &PairOutcome| pair.measured.as_ref().ok().map(|p| p.views.match_count());
    let counts = pairs.iter().map(|pair| pair.as_ref().and_then(count));
    let best = counts
        .enumerate()
        .filter_map(|(z, count)| Some((count?, z)))
        .max_by_key(|&(count, z)| (count, 2 - z));
    let refusal = || match pairs[1].as_ref().map(|centre| &centre.measured) {
        Some(Err(refusal)) => ClosureRefusal::NoPair(*refusal),
        _ => ClosureRefusal::NoMotion,
    };
    best.map(|(_, z)| z).ok_or_else(refusal)
}

/// The scales of the pairs as Algorithm 1 takes them, in target world units per source world unit: the keyframes
/// of a map may have units of their own.
pub(super) fn scales(
    source: &PreparedMap,
    target: &PreparedMap,
    pairs: &[Option<PairOutcome>; 3],
) -> Neighbourhood {
    std::array::from_fn(|z| {
        let outcome = pairs[z].as_ref()?;
        let pair = outcome.measured.as_ref().ok()?;
        let world = target.world_from(outcome.target)?.scale / source.world_from(outcome.source)?.scale;
        Some(PairEstimate {
            scale: pair.scale.scale * world,
            variance: pair.scale.variance * world * world,
            match_count: pair.views.match_count(),
        })
    })
}

/// r_vol of the chosen pair; 1, which lets the neighbours count, where a cloud has no volume.
pub(super) fn ratio_of_volumes(chosen: &Chosen) -> f64 {
    let (p_s, p_t) = (&chosen.source_cloud.points, &chosen.target_cloud.points);
    volume_ratio(p_s, p_t, &chosen.target_from_source).unwrap_or(1.0)
}

/// The pair that gives the initial guess, with what the next steps need of it.
pub(super) struct Chosen {
    /// The similarity by key points.
    target_from_source: Sim3,
    /// Mean of the source points it rests on.
    centroid: Vector3<f64>,
    /// The keyframes' poses.
    pub poses: PairPoses,
    source_cloud: Cloud,
    target_cloud: Cloud,
}

impl Chosen {
    /// `None` where the pair is not measured, or not in the maps.
    pub(super) fn new(
        source: &PreparedMap,
        target: &PreparedMap,
        outcome: &PairOutcome,
        params: &ClosureParams,
    ) -> Option<Self> {
        let pair = outcome.measured.as_ref().ok()?;
        let used = pair.points.iter().zip(&pair.alignment.inliers).filter(|(_, inlier)| **inlier);
        let sum: Vector3<f64> = used.map(|(point, _)| point.source.position).sum();
        let centroid = sum / pair.alignment.inlier_count as f64;
        let keyframes = (outcome.source, outcome.target);
        Self::at(source, target, keyframes, pair.alignment.target_from_source, centroid, params)
    }

    /// Two keyframes at a similarity that matches gave. `None` where one is not in its map.
    pub(super) fn at(
        source: &PreparedMap,
        target: &PreparedMap,
        (i, j): (KeyframeId, KeyframeId),
        target_from_source: Sim3,
        centroid: Vector3<f64>,
        params: &ClosureParams,
    ) -> Option<Self> {
        let poses = PairPoses {
            source_world_from_source: source.world_from(i)?,
            target_world_from_target: target.world_from(j)?,
        };
        let (i, j) = (source.get(i)?, target.get(j)?);
        let cloud = |k: &PreparedKeyframe| keyframe_cloud(k.depth(), k.camera, &params.cloud);
        let (source_cloud, target_cloud) = rayon::join(|| cloud(i), || cloud(j));
        Some(Self { target_from_source, centroid, poses, source_cloud, target_cloud })
    }

    /// How far the target's points are from its camera, target keyframe units: the median.
    pub(super) fn reach(&self) -> f64 {
        let mut distances: Vec<f64> = self.target_cloud.points.iter().map(|point| point.norm()).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).copied().unwrap_or(0.0)
    }

    /// σ* in target keyframe units per source keyframe unit.
    fn keyframe_scale(&self, scale: &OptimalScale) -> f64 {
        scale.scale * self.poses.source_world_from_source.scale / self.poses.target_world_from_target.scale
    }

    /// T_IG (Eq. 8) with the scale σ* of all pairs in place of this one's, such that the middle of the matched
    /// points stays where it is.
    pub(super) fn initial_guess(&self, scale: &OptimalScale) -> Sim3 {
        let turned = self.target_from_source.rotation * self.centroid * self.keyframe_scale(scale);
        let translation = self.target_from_source * self.centroid - turned;
        alignment::initial_guess(&Se3::new(self.target_from_source.rotation, translation), &self.poses)
    }

    /// T_Ftrans (§IV-D2): +P_t of Eq. 8 onto \*P_s.
    pub(super) fn register(
        &self,
        scale: &OptimalScale,
        initial_guess: &Sim3,
        params: &ClosureParams,
    ) -> Result<Registration, IcpRefusal> {
        let scaling = Sim3 { scale: self.keyframe_scale(scale), ..Sim3::identity() };
        let scaled_source_from_target = *initial_guess * self.poses.assumed_source_from_target();
        let source = self.source_cloud.moved(&scaling);
        let target = self.target_cloud.moved(&scaled_source_from_target);
        icp::register(&target, &source, &Sim3::identity(), &params.icp)
    }

    /// Eq. 9 and §IV-E: target_world_from_source_world.
    pub(super) fn world_motion(&self, scale: &OptimalScale, initial_guess: &Sim3, refinement: &Sim3) -> Sim3 {
        let last = alignment::final_transform(refinement, initial_guess, &self.poses);
        let motions = alignment::world_motions(self.keyframe_scale(scale), &last, &self.poses);
        motions.scaled_source_world_from_target_world.inverse()
            * motions.scaled_source_world_from_source_world
    }
}

/// Refines every pair on its images: from where each of `starts`, target_world_from_source_world, puts it, and from
/// its own key points.
pub(super) fn refine(
    source: &PreparedMap,
    target: &PreparedMap,
    pairs: &mut [Option<PairOutcome>; 3],
    starts: &[Sim3],
    params: &ClosureParams,
) {
    pairs.par_iter_mut().flatten().for_each(|outcome| {
        let keyframes = source.get(outcome.source).zip(target.get(outcome.target));
        let worlds = source.world_from(outcome.source).zip(target.world_from(outcome.target));
        let (Some((i, j)), Some((source_pose, target_pose))) = (keyframes, worlds) else { return };
        let own = outcome.measured.as_ref().ok().map(|pair| pair.alignment.target_from_source);
        let given = starts.iter().map(|start| target_pose.inverse() * *start * source_pose);
        let starts: Vec<Sim3> = own.into_iter().chain(given).collect();
        let direct = refine_directly(i, j, &starts, &params.direct);
        let best = match (&direct, &outcome.measured) {
            (Ok(direct), _) => Some(direct.estimate),
            (Err(_), Ok(pair)) => Some(pair.estimate()),
            (Err(_), Err(_)) => None,
        };
        outcome.motion = best.and_then(|best| best.carried(&target_pose, &source_pose.inverse()));
        outcome.direct = Some(direct);
    });
}

/// target_from_source of the chosen pair's keyframes on which most pairs agree; marks those that do.
///
/// They are compared as what each says of the chosen pair: there an honest drift between neighbours is small, while
/// at the worlds' origins, far away, it would be large.
pub(super) fn motion(
    chosen: &Chosen,
    pairs: &mut [Option<PairOutcome>; 3],
    params: &ClosureParams,
) -> Result<Estimate, ClosureRefusal> {
    let (source, target) = (chosen.poses.source_world_from_source, chosen.poses.target_world_from_target);
    let estimates: Vec<(usize, Estimate)> = pairs
        .iter()
        .enumerate()
        .filter_map(|(z, pair)| Some((z, pair.as_ref()?.motion?.carried(&target.inverse(), &source)?)))
        .filter(|(_, estimate)| is_sharp(estimate, chosen.reach(), params.max_deviation))
        .collect();
    let [translation, rotation, scale] = params.drift;
    let translation = translation * chosen.reach();
    let drift = SVector::from([translation, translation, translation, rotation, rotation, rotation, scale]);
    let chi2 = |a: usize, b: usize| {
        estimates[a].1.squared_distance(&estimates[b].1, &drift).unwrap_or(f64::INFINITY)
    };
    let (members, worst) = largest_consistent(estimates.len(), &chi2, params.max_chi2);
    if estimates.len() > 1 && members.len() == 1 {
        return Err(ClosureRefusal::Disagreement { chi2: worst });
    }
    let consistent: Vec<Estimate> = members.iter().map(|&k| estimates[k].1).collect();
    for &k in &members {
        if let Some(pair) = &mut pairs[estimates[k].0] {
            pair.agrees = true;
        }
    }
    let mean = mean(&consistent).ok_or(ClosureRefusal::NoMotion)?;
    // Neighbouring keyframes share the errors of their depths: three pairs know little more than one.
    Ok(Estimate { information: mean.information / consistent.len() as f64, ..mean })
}

/// Whether a pair is known well enough that its agreement with others means something.
fn is_sharp(estimate: &Estimate, reach: f64, [translation, rotation, scale]: [f64; 3]) -> bool {
    let Some(covariance) = estimate.information.try_inverse() else { return false };
    let variance = covariance.diagonal();
    let within = |first: usize, count: usize, limit: f64| {
        variance.iter().skip(first).take(count).all(|&v| v >= 0.0 && v.sqrt() <= limit)
    };
    within(0, 3, translation * reach) && within(3, 3, rotation) && within(6, 1, scale)
}

/// The largest subset of `count` whose every two have a χ² of at most `limit`, the one of smallest worst χ² among
/// equals. Where no two agree: one alone, with the smallest χ² there is.
fn largest_consistent(count: usize, chi2: &impl Fn(usize, usize) -> f64, limit: f64) -> (Vec<usize>, f64) {
    let (mut best, mut best_worst, mut least) = (Vec::new(), f64::INFINITY, f64::INFINITY);
    for subset in 1usize..1 << count {
        let members: Vec<usize> = (0..count).filter(|k| subset >> k & 1 == 1).collect();
        let mut worst: f64 = 0.0;
        for (n, &a) in members.iter().enumerate() {
            for &b in &members[n + 1..] {
                let apart = chi2(a, b);
                // What is no number is no agreement.
                worst = if apart.is_nan() { f64::INFINITY } else { worst.max(apart) };
                least = least.min(worst);
            }
        }
        let better = members.len() > best.len() || (members.len() == best.len() && worst < best_worst);
        if worst <= limit && better {
            (best, best_worst) = (members, worst);
        }
    }
    if best.len() == 1 { (best, least) } else { (best, best_worst) }
}

#[cfg(test)]
mod tests {
    use super::{is_sharp, largest_consistent};
    use crate::estimate::Estimate;
    use geometry::Sim3;
    use nalgebra::{SMatrix, SVector};

    #[test]
    fn what_is_known_badly_in_any_direction_confirms_nothing() {
        let known_to = |translation: f64, rotation: f64, scale: f64| {
            let [t, r, s] = [translation, rotation, scale].map(|deviation| deviation.powi(-2));
            let information = SMatrix::from_diagonal(&SVector::from([t, t, t, r, r, r, s]));
            is_sharp(&Estimate { a_from_b: Sim3::identity(), information }, 2.0, [0.1, 0.02, 0.1])
        };
        assert!(known_to(0.19, 0.019, 0.09));
        assert!(!known_to(0.21, 0.01, 0.01) && !known_to(0.01, 0.021, 0.01) && !known_to(0.01, 0.01, 0.11));
    }

    /// χ² of every two of three: of 0 and 1, 0 and 2, 1 and 2.
    fn of_three([first, second, third]: [f64; 3]) -> (Vec<usize>, f64) {
        let chi2 = |a: usize, b: usize| match (a.min(b), a.max(b)) {
            (0, 1) => first,
            (0, 2) => second,
            _ => third,
        };
        largest_consistent(3, &chi2, 20.0)
    }

    #[test]
    fn the_largest_set_agrees_in_every_two() {
        assert_eq!(of_three([1.0, 20.0, 3.0]), (vec![0, 1, 2], 20.0));
        assert_eq!(of_three([30.0, 21.0, 3.0]), (vec![1, 2], 3.0));
        // 0 and 2 contradict each other: of the two halves the one that agrees better.
        assert_eq!(of_three([4.0, 21.0, 3.0]), (vec![1, 2], 3.0));
        assert_eq!(of_three([2.0, 21.0, 3.0]), (vec![0, 1], 2.0));
    }

    #[test]
    fn where_none_agree_one_is_left_with_the_least_contradiction() {
        assert_eq!(of_three([50.0, 40.0, 60.0]), (vec![0], 40.0));
        let (alone, least) = of_three([f64::INFINITY; 3]);
        assert_eq!((alone.len(), least), (1, f64::INFINITY));
    }

    #[test]
    fn one_agrees_with_itself_and_none_with_nobody() {
        let never = |_: usize, _: usize| f64::NAN;
        assert_eq!(largest_consistent(1, &never, 20.0).0, [0]);
        assert!(largest_consistent(0, &never, 20.0).0.is_empty());
    }

    /// A χ² that is no number is no agreement.
    #[test]
    fn what_is_no_number_does_not_agree() {
        assert_eq!(of_three([f64::NAN, 3.0, f64::NAN]).0, [0, 2]);
    }
}
