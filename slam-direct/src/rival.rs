//! A second motion among the points of a frame: something that was mapped moves against the rest.
//!
//! A frame's pose is refined by all points that are found in it. Where a lorry drives off that the map took for a house, its points and
//! the others each agree with a pose of their own, and a robust fit goes to one of them, or in between. So both motions are fitted, the
//! second one to what does not agree with the first (sequential consensus: Torr and Murray, *Stochastic motion clustering*, 1994), by what each point
//! was found with: the information that [`refine_pose`](crate::track::refine_pose) lowers to what the frame shows hides the difference.

use crate::local_map::LocalMap;
use crate::params::Params;
use crate::track::{INLIER, Matched, TRACKING, View, world_point};
use crate::window::SeenPoint;
use geometry::{Pinhole, Se3};
use std::collections::BTreeMap;

/// Times that either motion is fitted to what is left by the other.
const ROUNDS: usize = 3;

/// Least share of the points that disagree with the first motion which a second one explains. What drives off leaves 0.71 to 0.93; where a jolt
/// bends the rows of an image whose shutter is not known yet, a second pose fits 0.42 to 0.57 of what is bent.
const EXPLAINED: f32 = 0.65;

/// Whether the points `found` move in two ways: a second motion has its share (`track.max_rival`) of those of known depth that agree with
/// either. Of a keyframe's points as many count as agree with the first motion too: where a map has drifted, those of its old keyframes move
/// against those of the new ones, but each keyframe's stay together.
///
/// The matches have the information that they were found with; the pose in the `view` is the refined one.
pub(crate) fn has_two_motions(map: &LocalMap, view: &View, found: &[Matched], params: &Params) -> bool {
    // What has no known depth agrees with many motions, or with a wrong one.
    let found: Vec<&Matched> = found.iter().filter(|m| map.point(m.at).is_known()).collect();
    let points: Vec<SeenPoint> =
        found.iter().map(|m| world_point(map, &view.camera_from_world, &view.motion, m)).collect();
    let motions = Motions { camera: &map.camera, points: &points };
    let all: Vec<usize> = (0..points.len()).collect();
    let (least, few) = (params.track.max_rival, params.keyframes.min_matched);
    let is_many = |count: usize, of: usize| count >= few && count as f32 >= least * of as f32;
    let [_, rest] = motions.split(&all, &view.camera_from_world);
    if !is_many(rest.len(), points.len()) {
        return false;
    }
    let [first, second] = motions.two(&all, &view.camera_from_world);
    if (second.len() as f32) < EXPLAINED * (points.len() - first.len()) as f32 {
        return false;
    }
    let (of_first, of_second) = (by_host(&found, &first), by_host(&found, &second));
    let both = |(host, count): (&usize, &usize)| (*count).min(of_first.get(host).copied().unwrap_or(0));
    let together: usize = of_second.iter().map(both).sum();
    is_many(together, first.len() + second.len())
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

    /// The points that agree with each of two motions, begun at one pose.
    fn two(&self, all: &[usize], start: &Se3) -> [Vec<usize>; 2] {
        let (mut first, mut second) = (*start, *start);
        let mut found = self.agreeing(all, &first, &mut second);
        for _ in 1..ROUNDS {
            let of_second = &found[1];
            let without: Vec<usize> =
                all.iter().copied().filter(|i| of_second.binary_search(i).is_err()).collect();
            first = self.fit(&without, &first);
            found = self.agreeing(all, &first, &mut second);
        }
        found
    }

    /// The points that agree with the first motion, and those of the rest that agree with the second, which is fitted to the rest.
    fn agreeing(&self, all: &[usize], first: &Se3, second: &mut Se3) -> [Vec<usize>; 2] {
        let [of_first, rest] = self.split(all, first);
        *second = self.fit(&rest, second);
        let [of_second, _] = self.split(&rest, second);
        [of_first, of_second]
    }
}
