//! Parts a map behind one of its keyframes: what [`LocalMap::append`] joins.

use super::{KeyframeState, LocalMap, PointRef};
use map::Shared;

impl LocalMap {
    /// Takes off the keyframes behind the first `count` as a map of their own, in the same world and unit. Neither part knows what the
    /// other observes of its points; a point that nothing else observes is dropped.
    pub fn split_off(&mut self, count: usize) -> LocalMap {
        let mut later = self.keyframes.split_off(count);
        keep_own(&mut self.keyframes, |keyframe| (keyframe < count).then_some(keyframe));
        keep_own(&mut later, |keyframe| keyframe.checked_sub(count));
        LocalMap { keyframes: later, camera: self.camera, sensor: self.sensor, mask: self.mask.clone() }
    }
}

/// Gives the keyframes their `own` names, and forgets what points have to do with those that have none.
fn keep_own(keyframes: &mut [Shared<KeyframeState>], own: impl Fn(usize) -> Option<usize>) {
    let is_as_it_was = |keyframe: usize| own(keyframe) == Some(keyframe);
    for shared in keyframes {
        let hosts = shared.seen.iter().map(|at| at.host);
        let observers = shared.points.iter().flat_map(|point| &point.observations).map(|seen| seen.keyframe);
        if hosts.chain(observers).all(is_as_it_was) {
            // What is not changed stays shared.
            continue;
        }
        let state = &mut **shared;
        state.seen =
            state.seen.iter().filter_map(|at| Some(PointRef { host: own(at.host)?, ..*at })).collect();
        for point in state.points.iter_mut().filter(|point| !point.observations.is_empty()) {
            point
                .observations
                .retain_mut(|seen| own(seen.keyframe).map(|keyframe| seen.keyframe = keyframe).is_some());
            point.alive &= !point.observations.is_empty();
        }
    }
}
