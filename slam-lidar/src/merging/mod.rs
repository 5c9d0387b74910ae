//! Two maps brought together without a guess, and whether to believe it.
//!
//! In the order of the steps: [`robot_map`] (a map cut into independent pieces), [`mod@candidates`] (places that may be
//! the same, by Scan Context), [`mod@hypotheses`] (pieces registered there; those that agree), [`mod@correlation`] (walls
//! on walls), [`surfels`], [`views`] and [`patches`] (a map's surfaces, its rays, what hangs together), [`comparison`] (what is
//! there in both maps), [`shifts`] (small things that stand otherwise), [`verdict`] (one place or two). More than two maps come into one frame in `merge::merge_graph::rigid`; [`mod@emr`] is the paper's way to a pose, to compare with. All is metric, in SE(3): there is no scale to find.
//!
//! The paper registers key points of whole clouds once and believes a mean distance. Here several pieces must find
//! the same pose by themselves, and what is believed is what each map saw as free and as filled.

pub mod bounds;
pub mod candidates;
pub mod comparison;
pub mod correlation;
pub mod emr;
pub mod hypotheses;
mod key_points;
pub mod lines;
mod own_depth;
pub mod patches;
pub mod robot_map;
pub mod shifts;
pub mod surfel;
pub mod surfels;
#[cfg(test)]
mod tests;
pub mod verdict;
pub mod views;
mod walls;

use crate::closure::{Found, coarse_search, search};
use crate::voxels::{VoxelTable, first_of_each_voxel};
use backend::verdict::{Answer, Prior};
use comparison::{Comparison, glimpse};
use hypotheses::{Cluster, clusters, hypotheses};
use lines::{Line, Test};
use rayon::prelude::*;
use robot_map::RobotMap;
use serde::{Deserialize, Serialize};
use verdict::{Decision, Verdict, confirm, decide, distinct, evidence, is_one, seen};

/// So many clusters of hypotheses are registered with whole maps, thinned.
const FOLLOWED: usize = 16;
/// Of these and of what else is proposed so many, the ones that fit best, are registered with whole maps and looked at: at a site
/// that repeats itself thinned points fit at every repetition.
const LOOKED_AT: usize = 24;
/// Of these so many, the ones that differ least at a glimpse, are judged.
const MAX_EVALUATED: usize = 8;
/// Grid on which whole maps are compared to rank clusters, metres.
const RANKED_ON: f32 = 1.5;

/// How the pose between two maps is found. Whether it is believed is decided alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MergeMethod {
    /// Our own: pieces placed by Scan Context, of which several must agree, and the pose of the other beside them.
    #[default]
    Pieces,
    /// The paper's: key points of whole clouds, matched and put through RANSAC.
    Emr,
}

impl MergeMethod {
    /// All methods, the default first.
    pub const ALL: [Self; 2] = [Self::Pieces, Self::Emr];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pieces => "pieces",
            Self::Emr => "emr",
        }
    }
}

/// Brings `b` into the frame of `a` by one of the methods; `prior` says what may have changed between them. The verdict depends on the
/// maps alone, not on their order or on the number of cores.
pub fn merge_by(method: MergeMethod, a: &RobotMap, b: &RobotMap, prior: &Prior) -> Verdict {
    if b.comes_before(a) { in_order(method, b, a, prior).swapped() } else { in_order(method, a, b, prior) }
}

/// [`merge_by`] our own method, between maps of one day.
pub fn merge(a: &RobotMap, b: &RobotMap) -> Verdict {
    merge_by(MergeMethod::Pieces, a, b, &Prior::default())
}

fn in_order(method: MergeMethod, a: &RobotMap, b: &RobotMap, prior: &Prior) -> Verdict {
    let by_key_points = proposed(a, b);
    let mut ranked = ranked(a, b, proposals(a, b, by_key_points.as_ref()));
    ranked.truncate(LOOKED_AT);
    match (method, by_key_points) {
        (MergeMethod::Pieces, _) => followed(a, b, &ranked, prior, None),
        (MergeMethod::Emr, Some(own)) => {
            // The paper's pose is the only one that may be believed; the others stand beside it.
            ranked.insert(0, Ranked { cluster: own.clone(), is_open: true });
            followed(a, b, &ranked, prior, Some(&own))
        }
        (MergeMethod::Emr, None) => decide(Vec::new(), prior, |_| ()),
    }
}

/// The pose of the paper's chain, which no piece has found by itself.
fn proposed(a: &RobotMap, b: &RobotMap) -> Option<Cluster> {
    let found = emr::propose(a, b)?;
    Some(Cluster { a_from_b: found.a_from_b, pieces: Vec::new(), support: 0.0 })
}

/// Where the maps may belong together, by all that proposes poses.
fn proposals(a: &RobotMap, b: &RobotMap, by_key_points: Option<&Cluster>) -> Vec<Cluster> {
    let mut found = clusters(&hypotheses(a, b), b);
    found.truncate(FOLLOWED);
    // Key points see what descriptors of places do not: two ways with a row of racks between them.
    found.extend(by_key_points.cloned());
    // Walls are seen from everywhere: they propose also what was seen from far apart, and every repetition.
    let alone = |a_from_b| Cluster { a_from_b, pieces: Vec::new(), support: 0.0 };
    found.extend(correlation::peaks(a, b).into_iter().map(alone));
    found
}

/// A cluster, and whether the maps share there what is asked of them, by thinned points.
struct Ranked {
    cluster: Cluster,
    is_open: bool,
}

/// Clusters by how well whole maps fit there, those last that share little and will be refused: repeated structure misleads pieces, the
/// whole less.
fn ranked(a: &RobotMap, b: &RobotMap, found: Vec<Cluster>) -> Vec<Ranked> {
    let mut kept = Vec::new();
    first_of_each_voxel(&b.whole.points, RANKED_ON, &mut VoxelTable::default(), &mut kept);
    let thinned: Vec<[f32; 3]> = kept.iter().map(|&i| b.whole.points[i as usize]).collect();
    let fitted = |cluster: Cluster| {
        let fit = coarse_search(&a.whole, &thinned, &cluster.a_from_b, false);
        (fit.score, Cluster { a_from_b: fit.pose, ..cluster })
    };
    let mut scored: Vec<(f64, Cluster)> = found.into_par_iter().map(fitted).collect();
    scored.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut distinct: Vec<Cluster> = Vec::new();
    for (_, cluster) in scored {
        let same = |other: &&mut Cluster| hypotheses::same_place(&other.a_from_b, &cluster.a_from_b, b);
        match distinct.iter_mut().find(same) {
            // Who else found the place is said of the pose that fits best.
            Some(other) if other.pieces.len() < cluster.pieces.len() => {
                (other.pieces, other.support) = (cluster.pieces, cluster.support);
            }
            Some(_) => {}
            None => distinct.push(cluster),
        }
    }
    let share = |cluster: Cluster| Ranked {
        is_open: seen(&a.whole, &thinned, &cluster.a_from_b).0 >= bounds::OVERLAP,
        cluster,
    };
    let mut marked: Vec<Ranked> = distinct.into_par_iter().map(share).collect();
    // Stable: of either kind those that fit best come first.
    marked.sort_by_key(|ranked| !ranked.is_open);
    marked
}

/// Whole maps registered from what each cluster says, and judged where they come to; only the pose that `own` comes to may be
/// believed, where there is one.
fn followed(a: &RobotMap, b: &RobotMap, ranked: &[Ranked], prior: &Prior, own: Option<&Cluster>) -> Verdict {
    let register = |r: &Ranked| search(&a.whole, &b.whole.points, &r.cluster.a_from_b, false);
    let found: Vec<Found> = ranked.par_iter().map(register).collect();
    // Those that come to one pose are judged once: evidence costs more than the registration.
    let found = distinct(ranked.iter().zip(found).collect(), |(_, found)| found.pose);
    let first = found.first().map(|(_, found)| found.pose);
    let looks: Vec<Comparison> = found.par_iter().map(|(_, found)| glimpse(a, b, &found.pose)).collect();
    let mut looked: Vec<_> = found.into_iter().zip(looks).collect();
    // What one of the maps saw through does not stand there, however well the rest fits: in a hall that is seen from both ends, half-turned
    // poses fit more than the right one, and along a corridor every step of its doors fits as well.
    let begin = usize::from(own.is_some());
    looked[begin..].sort_by(|((one, _), x), ((other, _), y)| {
        other.is_open.cmp(&one.is_open).then(y.inlier_ratio.total_cmp(&x.inlier_ratio))
    });
    looked.truncate(MAX_EVALUATED);
    let judge = |((ranked, found), look): ((&Ranked, Found), Comparison)| {
        evidence(a, b, &ranked.cluster, &found, prior, look)
    };
    let evidence = looked.into_par_iter().map(judge).collect();
    let verdict = decide(evidence, prior, |best| confirm(a, b, best));
    match (own, first, &verdict.best) {
        (Some(_), Some(own), Some(best))
            if verdict.decision == Decision::Accepted && !is_one(&own, &best.a_from_b) =>
        {
            let line = Line { test: Test::Rivals, value: 1.0, bound: 0.0 };
            Verdict { answer: Answer::CannotTell, decision: Decision::Undecided, line, ..verdict }
        }
        _ => verdict,
    }
}
