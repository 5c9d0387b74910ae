//! A second motion among the points of a frame: something that was mapped moves against the rest.
//!
//! A frame's pose is refined by all points that are found in it. Where a lorry drives off that the map took for a house, its points and
//! the others each agree with a pose of their own, and a robust fit goes to one of them, or in between. So both motions are fitted, the
//! second one to what does not agree with the first (sequential consensus: Torr and Murray, *Stochastic motion clustering*, 1994), by what each point
//! was found with: the information that [`refine_pose`](crate::track::refine_pose) lowers to what the frame shows hides the difference.

mod bend;

use crate::local_map::{LocalMap, Matched};
use crate::params::Params;
use crate::track::{INLIER, TRACKING, View, world_point};
use crate::window::SeenPoint;
use geometry::{Pinhole, Se3};
use std::collections::BTreeMap;

/// Times that either motion is fitted to what is left by the other.
const ROUNDS: usize = 3;

/// Least share of the points that disagree with the first motion which a second one explains. What drives off leaves 0.71 to 0.93; where a jolt
/// bends the rows of an image whose shutter is not known yet, a second pose fits 0.42 to 0.57 of what is bent.
const EXPLAINED: f32 = 0.65;

/// Share of the points of known depth that agree with a second motion, and with no bent image, in still surroundings: less in 99 of 100 frames of each
/// shared recording.
const STILL: f32 = 0.065;

/// How the points of known depth that are found in a frame agree with its pose.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Agreement {
    /// Share of them that disagree with the pose by the information that they were found with, 0–1; 0 where few do.
    pub against: f32,
    /// Share of those that agree with either of two motions that agree with the second; 0 where few do, or where it leaves much unexplained. Of a
    /// keyframe's points as many count as agree with the first motion too: where a map has drifted, those of its old keyframes move against those of
    /// the new ones, but each keyframe's stay together.
    pub second_motion: f32,
    /// Whether one bent image explains what agrees with the second motion too, but for no more than still surroundings have: 0.8 to 1 of it where a
    /// focal length is 15 to 30 % off or a shutter is left out.
    pub is_bent: bool,
}

/// Compares the points `found` with the pose in the `view`, which is the refined one, by the information that they were found with.
pub(crate) fn agreement(map: &LocalMap, view: &View, found: &[Matched], params: &Params) -> Agreement {
    // What has no known depth agrees with many motions, or with a wrong one.
    let found: Vec<&Matched> = found.iter().filter(|m| map.point(m.at).is_known()).collect();
    let points: Vec<SeenPoint> =
        found.iter().map(|m| world_point(map, &view.camera_from_world, &view.motion, m)).collect();
    let motions = Motions { camera: &map.camera, points: &points };
    let all: Vec<usize> = (0..points.len()).collect();
    let few = params.keyframes.min_matched;
    let [_, rest] = motions.split(&all, &view.camera_from_world);
    if rest.len() < few {
        return Agreement::default();
    }
    let against = rest.len() as f32 / points.len() as f32;
    let one_motion = Agreement { against, ..Agreement::default() };
    if against < STILL {
        return one_motion;
    }
    let [first, second] = motions.two(&all, &view.camera_from_world, few);
    if (second.len() as f32) < EXPLAINED * (points.len() - first.len()) as f32 {
        return one_motion;
    }
    let (of_first, of_second) = (by_host(&found, &first), by_host(&found, &second));
    let both = |(host, count): (&usize, &usize)| (*count).min(of_first.get(host).copied().unwrap_or(0));
    let together: usize = of_second.iter().map(both).sum();
    if together < few {
        return one_motion;
    }
    let bent = bend::inliers(&map.camera, &view.camera_from_world, &points);
    let unexplained = second.iter().filter(|i| bent.binary_search(i).is_err()).count();
    let of_either = (first.len() + second.len()) as f32;
    let is_bent = (unexplained as f32) < STILL * of_either;
    Agreement { against, second_motion: together as f32 / of_either, is_bent }
}

/// How much the frames so far say that a part of the map moves, by the shares that agreed with a second motion (cumulative sum: Page,
/// *Continuous inspection schemes*, Biometrika 1954). It takes two frames of `max_rival`, for a jolt is over by then, or more of less: what gathers
/// speed slowly has a share that hardly grows.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Evidence(f32);

impl Evidence {
    /// With the share of one more frame.
    pub fn with(self, share: f32, max_rival: f32) -> Self {
        Self((self.0 + share.min(max_rival) - STILL).max(0.0))
    }

    /// Whether it suffices.
    pub fn is_enough(self, max_rival: f32) -> bool {
        // Two equal summands are compared with their sum.
        self.0 >= 1.999 * (max_rival - STILL).max(0.0)
    }
}

/// How many of the matches `of` lie in each keyframe.
fn by_host(found: &[&Matched], of: &[usize]) -> BTreeMap<usize, usize> {
    let mut counts = BTreeMap::new();
    of.iter().for_each(|&i| *counts.entry(found[i].at.host).or_default() += 1);
    counts
}

struct Motions<'a> {
    camera: &'a Pinhole,
    points: &'a [SeenPoint],
}

impl Motions<'_> {
    /// Those that agree with a pose, and those that do not.
    fn split(&self, of: &[usize], pose: &Se3) -> [Vec<usize>; 2] {
        let (agree, differ) = of.iter().partition(|&&i| self.points[i].squared(self.camera, pose) < INLIER);
        [agree, differ]
    }

    fn fit(&self, of: &[usize], start: &Se3) -> Se3 {
        let points: Vec<SeenPoint> = of.iter().map(|&i| self.points[i]).collect();
        TRACKING.solve(self.camera, start, &points)
    }

    /// The points that agree with each of two motions, begun at one pose. Where fewer than `few` agree with the second at once there is none.
    fn two(&self, all: &[usize], start: &Se3, few: usize) -> [Vec<usize>; 2] {
        let (mut first, mut second) = (*start, *start);
        let mut found = self.inliers_of_both(all, &first, &mut second);
        if found[1].len() < few {
            return found;
        }
        for _ in 1..ROUNDS {
            let of_second = &found[1];
            let without: Vec<usize> =
                all.iter().copied().filter(|i| of_second.binary_search(i).is_err()).collect();
            first = self.fit(&without, &first);
            found = self.inliers_of_both(all, &first, &mut second);
        }
        found
    }

    /// The points that agree with the first motion, and those of the rest that agree with the second, which is fitted to the rest.
    fn inliers_of_both(&self, all: &[usize], first: &Se3, second: &mut Se3) -> [Vec<usize>; 2] {
        let [of_first, rest] = self.split(all, first);
        *second = self.fit(&rest, second);
        let [of_second, _] = self.split(&rest, second);
        [of_first, of_second]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_frames_with_a_second_motion_are_enough_one_is_not_and_weak_ones_add_up() {
        let after = |shares: &[f32]| {
            let all = shares.iter().fold(Evidence::default(), |evidence, share| evidence.with(*share, 0.2));
            all.is_enough(0.2)
        };
        assert!(after(&[0.2, 0.2]) && after(&[0.02, 0.35, 0.25]));
        assert!(!after(&[0.9]) && !after(&[0.24, 0.02]) && !after(&[0.06; 50]));
        assert!(after(&[0.17, 0.19, 0.18]) && !after(&[0.17, 0.19]));
        // What was is forgotten.
        assert!(!after(&[0.2, 0.0, 0.0, 0.2, 0.0, 0.0, 0.2]));
    }
}
