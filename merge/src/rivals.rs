//! Places that speak for another motion of the maps than a closure: things that repeat, shifted by one.
//!
//! Past a row of equal houses a keyframe of the one map matches keyframes of the other at every house. All pairs along
//! the maps then confirm each of these closures, and where nothing stands before the houses nothing contradicts. What tells is
//! that another place matches nearly as well: of maps that show one place most matches are where the closure has them.

use crate::closure::{Closure, ClosureParams, matches_at};
use crate::pair::{Place, ViewPair, measure_pair, view_pair};
use crate::prepared::PreparedMap;
use geometry::{Sim3, median};
use map::KeyframeId;
use rayon::prelude::*;

/// How far right places may be off by the drift of both maps, parts of the ways between them: as of a loop within one map.
const MAX_DRIFT: f64 = 0.15;
/// How far they may be off besides, parts of the median distance of what the keyframe sees: similarities from key points
/// alone are good to some hundredths.
const MAX_OFFSET: f64 = 0.1;
/// How far they may be turned, degrees.
const MAX_ROTATION: f64 = 15.0;
/// How far apart the keyframes of a place are by the closure if it is to be elsewhere, in the same unit: views that match well
/// are nearer.
const ELSEWHERE: f64 = 0.3;
/// Proposed places elsewhere that are matched, some 5 ms each.
const LOOKED_AT: usize = 4;

/// The most matches γ of a place that speaks for another motion than the closure, over the most of one that speaks for its own;
/// 0 where none does. Asked are the places `matched` so far and some of those `proposed` that are elsewhere by the closure.
pub fn rival_share(
    source: &PreparedMap,
    target: &PreparedMap,
    closure: &Closure,
    matched: &[&ViewPair],
    proposed: &[Place],
    params: &ClosureParams,
) -> f64 {
    let is_matched = |place: &Place| matched.iter().any(|views| views.place() == *place);
    let at = |place: Place| At::new(source, target, closure, place);
    let is_elsewhere = |place: &Place| at(*place).is_some_and(|at| at.is_elsewhere());
    let elsewhere: Vec<Place> = proposed
        .iter()
        .copied()
        .filter(|place| !is_matched(place) && is_elsewhere(place))
        .take(LOOKED_AT)
        .collect();
    let look =
        |place: &Place| view_pair(source.get(place.source)?, target.get(place.target)?, &params.pair).ok();
    let found: Vec<ViewPair> = elsewhere.par_iter().filter_map(look).collect();
    let of_closure =
        closure.consistent_pairs().filter_map(|pair| Some(pair.measured.as_ref().ok()?.views.match_count()));
    let (mut own, mut rival) = (of_closure.max().unwrap_or(0), 0);
    for views in matched.iter().copied().chain(&found) {
        match at(views.place()).and_then(|at| at.agrees(source, target, views, params)) {
            Some(true) => own = own.max(views.match_count()),
            Some(false) => rival = rival.max(views.match_count()),
            None => {}
        }
    }
    rival as f64 / own.max(1) as f64
}

/// Whether the matches of two keyframes speak for the motion of a closure; nothing where they or it cannot be asked.
pub(crate) fn speaks_for(
    source: &PreparedMap,
    target: &PreparedMap,
    closure: &Closure,
    views: &ViewPair,
    params: &ClosureParams,
) -> Option<bool> {
    At::new(source, target, closure, views.place())?.agrees(source, target, views, params)
}

/// A place as the closure's motion has it; lengths in units of its target keyframe.
struct At {
    place: Place,
    /// target_from_source of its keyframes.
    supposed: Sim3,
    /// The ways in both maps between the closure and the place.
    path_lengths: f64,
    /// The median depth of what its target keyframe sees.
    depth: f64,
}

impl At {
    /// Nothing where a keyframe is not in its map or without depth.
    fn new(source: &PreparedMap, target: &PreparedMap, closure: &Closure, place: Place) -> Option<Self> {
        let (source_pose, target_pose) = (source.world_from(place.source)?, target.world_from(place.target)?);
        let chosen = closure.pairs[closure.chosen].as_ref()?;
        let path_length = |map: &PreparedMap, a: KeyframeId, b: KeyframeId| -> Option<f64> {
            Some((map.world_from(a)?.translation - map.world_from(b)?.translation).norm())
        };
        let in_target = closure.motion.a_from_b.scale / target_pose.scale;
        let path_lengths = path_length(source, place.source, chosen.source)? * in_target
            + path_length(target, place.target, chosen.target)? / target_pose.scale;
        let depths = &target.map().keyframes.get(&place.target)?.semi_dense.inverse_depth;
        let mut sample: Vec<f32> =
            depths.iter().step_by(depths.len().div_ceil(256).max(1)).copied().collect();
        let depth = f64::from(median(&mut sample)?).recip();
        let supposed = target_pose.inverse() * closure.motion.a_from_b * source_pose;
        Some(Self { place, supposed, path_lengths, depth })
    }

    /// Whether its keyframes are not where one place is seen from.
    fn is_elsewhere(&self) -> bool {
        self.supposed.translation.norm() > MAX_DRIFT * self.path_lengths + ELSEWHERE * self.depth
    }

    /// Whether its matches speak for the closure's motion: by their own similarity, or where they have none, as most lie where
    /// the closure has them.
    fn agrees(
        &self,
        source: &PreparedMap,
        target: &PreparedMap,
        views: &ViewPair,
        params: &ClosureParams,
    ) -> Option<bool> {
        let (i, j) = (source.get(self.place.source)?, target.get(self.place.target)?);
        Some(match measure_pair(i, j, views.clone(), &params.pair) {
            Ok(pair) => {
                let length = MAX_DRIFT * self.path_lengths + MAX_OFFSET * self.depth;
                agree(&pair.alignment.target_from_source, &self.supposed, length)
            }
            Err(_) => {
                2 * matches_at(source, target, self.place, &self.supposed, params) >= views.match_count()
            }
        })
    }
}

/// Whether two similarities put the source's camera in one place of the target, to a length, and turned alike.
fn agree(found: &Sim3, supposed: &Sim3, length: f64) -> bool {
    (found.translation - supposed.translation).norm() <= length
        && found.rotation.angle_to(&supposed.rotation) <= MAX_ROTATION.to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn places_agree_within_drift_and_rotation() {
        let pose = |x: f64, degrees: f64| {
            let rotation = UnitQuaternion::from_euler_angles(0.0, f64::to_radians(degrees), 0.0);
            Sim3::new(rotation, Vector3::new(x, 0.0, 0.0), 1.3)
        };
        assert!(agree(&pose(0.9, 14.0), &pose(0.0, 0.0), 1.0));
        assert!(!agree(&pose(1.1, 0.0), &pose(0.0, 0.0), 1.0));
        assert!(!agree(&pose(0.0, 16.0), &pose(0.0, 0.0), 1.0));
    }
}
