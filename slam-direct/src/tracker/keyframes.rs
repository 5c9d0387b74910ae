//! Which keyframe a frame is tracked against, and when it becomes one itself.

use super::located::covisible;
use super::{Located, NEAR, Tracker};
use crate::local_map::LocalMap;
use crate::params::Params;

/// A keyframe is nearer than another one when a frame has departed from it less than so many times as far.
const NEARER: f32 = 0.6;

impl Tracker {
    /// Whether the newest frame should become a keyframe.
    pub fn needs_keyframe(&mut self, map: &LocalMap, located: &Located, params: &Params) -> bool {
        let p = &params.keyframes;
        let overlap = located.searched.len() as f32 / self.most_searched.max(1) as f32;
        let fades = (located.inliers as f32) < p.fading * self.most_found as f32;
        let thins = (located.covered as f32) < p.coverage * self.most_covered as f32;
        let unknown = located.inlier_share() < p.known;
        let near_loss = located.wide_search || unknown;
        near_loss
            || fades
            || thins
            || self.seen.departure(map, self.reference, &self.last, overlap).is_none_or(|d| d.score(p) > 1.0)
    }

    /// Distance of the newest frame from the reference over the reference's median depth.
    pub fn parallax(&self, map: &LocalMap) -> f64 {
        let relative = self.last * map.keyframes[self.reference].camera_from_world.inverse();
        relative.translation.norm() * self.inverse_depth
    }

    /// Changes to the nearest keyframe, by the motion of its points in the image.
    pub fn change_reference(&mut self, map: &LocalMap, located: &Located, params: &Params) {
        let (seen, last) = (&mut self.seen, self.last);
        let mut score = |k: usize| Some(seen.departure(map, k, &last, 1.0)?.score(&params.keyframes));
        let Some(now) = score(self.reference).filter(|&s| s >= 0.5) else { return };
        let nearest = located
            .hosts
            .iter()
            .filter(|&&host| host != self.reference)
            .filter_map(|&host| Some((score(host)?, host)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, best)) = nearest.filter(|n| n.0 < NEARER * now) {
            self.change_to(map, best, params);
        }
    }

    /// Changes to a keyframe with the same view from nearly the same pose, if one is nearer than the reference;
    /// returns whether it did. A view that is in the map needs no further keyframe, or a camera that stays somewhere
    /// would make them for ever. The candidates share points with the frame (Mur-Artal 2015, §V-D); at a place that
    /// is seen from many sides they are more than the keyframes whose points are searched.
    pub fn returns(&mut self, map: &LocalMap, located: &Located, params: &Params) -> bool {
        if located.wide_search || located.inlier_share() < params.keyframes.known {
            return false;
        }
        let (seen, last) = (&mut self.seen, self.last);
        let mut score = |k: usize| Some(seen.departure(map, k, &last, 1.0)?.score(&params.keyframes));
        let Some(now) = score(self.reference) else { return false };
        let seeing = covisible(map, located).into_iter().filter(|&(k, shared)| {
            k != self.reference && shared as f32 >= params.keyframes.found_again * located.inliers as f32
        });
        let nearest =
            seeing.take(NEAR).filter_map(|(k, _)| Some((score(k)?, k))).min_by(|a, b| a.0.total_cmp(&b.0));
        match nearest.filter(|n| n.0 < params.keyframes.known_view.min(NEARER * now)) {
            Some((_, known)) => {
                self.change_to(map, known, params);
                true
            }
            None => false,
        }
    }
}
