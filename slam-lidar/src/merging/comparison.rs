//! Two maps at a pose: for every piece of surface that both saw, whether it is there in both.
//!
//! Each map's surfels are looked for among the other's rays. Rays that return from a surfel say that it is there, rays that
//! pass through it that it is not. What differs is counted by areas that hang together, what agrees by patches: a pallet's
//! front is one fact, not a hundred points. What tells a place from its double is then weighed for all sensors alike
//! (`backend::verdict`).

use super::patches::{NONE, area, grouped};
use super::robot_map::RobotMap;
use super::surfel::Surfel;
use super::surfels::crossings;
use crate::keyframe::transformed;
use backend::verdict::{Piece, PieceKind};
use geometry::Se3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rays return from a surfel within so many standard deviations of it.
const DEVIATIONS: f32 = 4.0;
/// Rays that pass through a surfel, at least, where it is not there, and so many times as many as return from it.
const PASSES: u32 = 2;
const MAJORITY: u32 = 2;
/// Surface of a thing, square metres: a pallet's or a cabinet's front. What agrees is no more than one fact, however large.
const THING: f64 = 1.0;
/// Smaller patches are no facts, square metres: three cells.
const LEAST: f64 = 0.18;
/// Share of a patch that the other map must have seen, and of that the share that must agree.
const SEEN: f64 = 0.5;
const AGREES: f64 = 0.8;
/// Errors of maps and poses are taken from how far rays end from the surfels that they cross, up to this, metres.
const NEAR: f32 = 0.3;

/// An area that one map holds and the other looks through.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Whether the first map holds it, else the second.
    pub in_first: bool,
    /// Its surface, square metres.
    pub area: f64,
    /// Its middle in the frame of the map that holds it, metres.
    pub middle: [f64; 3],
    /// Rays of the other map that pass through it.
    pub rays: u32,
}

/// What two maps say of each other's surfaces.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Surface that both saw and that agrees, square metres; the lesser of both ways.
    pub shared: f64,
    /// Share of a map's surfels that the other can judge, the lesser of both ways.
    pub overlap: f64,
    /// Of these, the share that agrees, the lesser of both ways.
    #[serde(rename = "agreeing")]
    pub inlier_ratio: f64,
    /// What rays end off the surfels that they cross, standard deviation in metres.
    pub deviation: f64,
    /// Pieces of surface, measured.
    pub pieces: Vec<Piece>,
    /// Areas that are there in one map only, the largest first.
    pub differences: Vec<Difference>,
}

/// What the other map's rays say of a surfel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    There,
    Absent(u32),
    Unseen,
}

/// Some of one map's surfels among the other's rays.
struct OneDirection<'a> {
    source: &'a RobotMap,
    /// Every so many are asked, each of which stands for as many.
    every: usize,
    found: Vec<Found>,
}

/// Compares maps at a pose.
pub fn compare(a: &RobotMap, b: &RobotMap, a_from_b: &Se3) -> Comparison {
    compared(a, b, a_from_b, 1)
}

/// The same by a part of the surfels, each of which stands for as many as are left out: what differs is told apart less well.
pub(super) fn glimpse(a: &RobotMap, b: &RobotMap, a_from_b: &Se3) -> Comparison {
    compared(a, b, a_from_b, GLIMPSED)
}

/// Every so many surfels are a glimpse: over a thousand of a hall's.
const GLIMPSED: usize = 8;

fn compared(a: &RobotMap, b: &RobotMap, a_from_b: &Se3, every: usize) -> Comparison {
    let b_from_a = a_from_b.inverse();
    let deviation = deviation(a, b, a_from_b).max(deviation(b, a, &b_from_a));
    let there = OneDirection::new([a, b], a_from_b, deviation, every);
    let back = OneDirection::new([b, a], &b_from_a, deviation, every);
    let mut differences = there.differences(false);
    differences.extend(back.differences(true));
    differences.sort_by(|x, y| y.area.total_cmp(&x.area).then(y.in_first.cmp(&x.in_first)));
    let total = (there.area(there.seen()) + back.area(back.seen())).max(1e-9);
    let mut pieces = there.agreements(total);
    pieces.extend(back.agreements(total));
    pieces.extend(differences.iter().filter_map(|difference| differing(difference, total)));
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    Comparison {
        shared: there.area(there.inliers()).min(back.area(back.inliers())),
        overlap: share(there.seen(), there.found.len()).min(share(back.seen(), back.found.len())),
        inlier_ratio: share(there.inliers(), there.seen()).min(share(back.inliers(), back.seen())),
        deviation: f64::from(deviation),
        pieces,
        differences,
    }
}

/// What rays of the target end off the source's flat surfels, standard deviation in metres, by the median.
fn deviation(target: &RobotMap, source: &RobotMap, target_from_source: &Se3) -> f32 {
    let of = |surfel: &Surfel| {
        let (moved, mut off) = (surfel.moved(target_from_source), Vec::new());
        for view in target.surfels.views.iter().step_by(3) {
            view.each_crossing(&moved, NEAR, |beyond| {
                if beyond.abs() < NEAR {
                    off.push(beyond.abs());
                }
            });
        }
        off
    };
    let asked: Vec<&Surfel> = source.surfels.all.iter().filter(|surfel| surfel.is_flat).step_by(7).collect();
    let mut off: Vec<f32> = asked.into_par_iter().flat_map_iter(of).collect();
    let half = off.len() / 2;
    if off.is_empty() { 0.0 } else { 1.4826 * *off.select_nth_unstable_by(half, f32::total_cmp).1 }
}

impl<'a> OneDirection<'a> {
    fn new(
        [target, source]: [&'a RobotMap; 2],
        target_from_source: &Se3,
        deviation: f32,
        every: usize,
    ) -> Self {
        let look = |surfel: &Surfel| {
            let moved = surfel.moved(target_from_source);
            let (rays, through) = crossings(&target.surfels.views, &moved, deviation, DEVIATIONS);
            if rays.passes >= PASSES && rays.passes > MAJORITY * rays.hits && through > 0 {
                Found::Absent(rays.passes)
            } else if rays.hits > 0 && rays.hits >= rays.passes {
                Found::There
            } else {
                Found::Unseen
            }
        };
        Self { source, every, found: source.surfels.all.par_iter().step_by(every).map(look).collect() }
    }

    /// Area of so many of the surfels that were asked, square metres.
    fn area(&self, count: usize) -> f64 {
        area(count * self.every)
    }

    fn seen(&self) -> usize {
        self.found.iter().filter(|found| **found != Found::Unseen).count()
    }

    fn inliers(&self) -> usize {
        self.found.iter().filter(|found| **found == Found::There).count()
    }

    /// What the source holds and the target looks through.
    fn differences(&self, in_first: bool) -> Vec<Difference> {
        let asked = self.source.surfels.all.iter().step_by(self.every);
        let absent: Vec<(Surfel, u32)> = asked
            .zip(&self.found)
            .filter_map(|(surfel, found)| match found {
                Found::Absent(rays) => Some((*surfel, *rays)),
                _ => None,
            })
            .collect();
        let alone: Vec<Surfel> = absent.iter().map(|(surfel, _)| *surfel).collect();
        let difference = |group: Vec<usize>| {
            let mut middle = [0.0; 3];
            for &i in &group {
                (0..3).for_each(|k| middle[k] += f64::from(alone[i].middle[k]) / group.len() as f64);
            }
            let rays = group.iter().map(|&i| absent[i].1).sum();
            Difference { in_first, area: self.area(group.len()), middle, rays }
        };
        grouped(&alone, |_| true, |_, _| true).into_iter().map(difference).collect()
    }

    /// Patches of the source that the target sees too. Both maps hold what agrees: each says half of it.
    fn agreements(&self, total: f64) -> Vec<Piece> {
        let patches = &self.source.patches;
        let mut counts = vec![(0usize, 0usize); patches.all.len()];
        let asked = patches.of.iter().step_by(self.every).zip(&self.found);
        for (&patch, found) in asked.filter(|(patch, _)| **patch != NONE) {
            let (there, seen) = &mut counts[patch as usize];
            *there += usize::from(*found == Found::There);
            *seen += usize::from(*found != Found::Unseen);
        }
        let piece = |(patch, &(there, seen)): (&super::patches::Patch, &(usize, usize))| {
            let size = area(patch.cells as usize);
            let is_fact =
                size >= LEAST && self.area(seen) >= SEEN * size && there as f64 >= AGREES * seen as f64;
            is_fact.then(|| Piece {
                kind: PieceKind::Shape,
                share: self.area(there) / total,
                things: 0.5 * (size / THING).min(1.0),
                occurrences: f64::from(patch.occurrences),
                ln_agreement: LN_AGREES,
            })
        };
        patches.all.iter().zip(&counts).filter_map(piece).collect()
    }
}

/// ln of how much likelier a patch agrees that is there in both maps than one of another place: nineteen in twenty of the one kind
/// do, and two in twenty of the other.
const LN_AGREES: f64 = 2.25;
/// Areas that are absent by errors of maps fall off by 1/e with so much surface, square metres: a cell and a bit.
const ERRS: f64 = 0.08;
/// Those of things that are not there fall off with so much.
const THINGS: f64 = 0.8;

/// The piece of an area that is there in one map only: which of the two exponential laws it is likelier of, as often as either occurs.
/// What is as small as errors are says nothing.
fn differing(difference: &Difference, total: f64) -> Option<Piece> {
    let ln_agreement = (THINGS / ERRS).ln() - difference.area * (1.0 / ERRS - 1.0 / THINGS);
    (ln_agreement < 0.0).then(|| Piece {
        kind: PieceKind::Shape,
        share: difference.area / total,
        things: (difference.area / THING).max(1.0),
        occurrences: 1.0,
        ln_agreement,
    })
}

impl Comparison {
    /// Things that agree, each by how seldom the like of it occurs.
    pub fn support(&self) -> f64 {
        let agrees = self.pieces.iter().filter(|piece| piece.ln_agreement > 0.0);
        agrees.map(|piece| piece.things / piece.occurrences).sum()
    }

    /// The largest area that is there in one map only, square metres.
    pub fn absent(&self) -> f64 {
        self.differences.first().map_or(0.0, |difference| difference.area)
    }

    /// The same of the maps in the other order.
    pub(super) fn swapped(mut self) -> Self {
        self.differences.iter_mut().for_each(|difference| difference.in_first = !difference.in_first);
        self
    }
}

impl Difference {
    /// Its middle in the frame of the first map, metres.
    pub fn place(&self, a_from_b: &Se3) -> [f64; 3] {
        if self.in_first {
            return self.middle;
        }
        transformed(a_from_b, self.middle.map(|v| v as f32)).map(f64::from)
    }
}
