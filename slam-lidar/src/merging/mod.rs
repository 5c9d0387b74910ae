//! Two maps brought together without a guess, and whether to believe it.
//!
//! In the order of the steps: [`robot_map`] (a map cut into independent pieces), [`mod@candidates`] (places that may be
//! the same, by Scan Context), [`mod@hypotheses`] (pieces registered there; those that agree), [`mod@correlation`] (walls
//! on walls), [`verdict`] (evidence of the whole maps), [`absent`] (what stands in one of them only), [`graph`] (more than two maps in one frame); [`mod@emr`] is the paper's way to a pose, to compare with. All is metric, in SE(3): there is no scale to find.
//!
//! The paper registers key points of whole clouds once and believes a mean distance. Here several pieces must find
//! the same pose by themselves, and what is believed is what each map saw as free and as filled.

pub mod absent;
pub mod candidates;
pub mod correlation;
pub mod emr;
pub mod graph;
pub mod hypotheses;
pub mod robot_map;
#[cfg(test)]
mod tests;
pub mod verdict;

use crate::closure::{Found, search, sketch};
use crate::voxels::{VoxelTable, first_of_each_voxel};
use hypotheses::{Cluster, clusters, hypotheses};
use rayon::prelude::*;
use robot_map::RobotMap;
use serde::{Deserialize, Serialize};
use verdict::{Verdict, bounds, distinct, evidence, judged, seen};

/// So many clusters of hypotheses are registered with whole maps, thinned.
const FOLLOWED: usize = 16;
/// Of these so many, the ones that fit best, are judged: at a site that repeats itself others fit better than the right one.
const JUDGED: usize = 8;
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

/// Brings `b` into the frame of `a` by one of the methods.
pub fn merge_by(method: MergeMethod, a: &RobotMap, b: &RobotMap) -> Verdict {
    match method {
        MergeMethod::Pieces => merge(a, b),
        MergeMethod::Emr => merge_emr(a, b),
    }
}

/// The paper's chain, its one pose refined and judged.
fn merge_emr(a: &RobotMap, b: &RobotMap) -> Verdict {
    followed(a, b, proposed(a, b).as_slice())
}

/// The pose of the paper's chain, which no piece has found by itself.
fn proposed(a: &RobotMap, b: &RobotMap) -> Option<Cluster> {
    let found = emr::propose(a, b)?;
    Some(Cluster { a_from_b: found.a_from_b, pieces: Vec::new(), support: 0.0 })
}

/// Brings `b` into the frame of `a`. The result depends on the maps alone, not on the number of cores.
pub fn merge(a: &RobotMap, b: &RobotMap) -> Verdict {
    let mut ranked = ranked(a, b, proposals(a, b));
    ranked.truncate(JUDGED);
    followed(a, b, &ranked)
}

/// Where the maps may belong together, by all that proposes poses.
fn proposals(a: &RobotMap, b: &RobotMap) -> Vec<Cluster> {
    let (mut found, by_key_points) = rayon::join(|| clusters(&hypotheses(a, b), b), || proposed(a, b));
    found.truncate(FOLLOWED);
    // Key points see what descriptors of places do not: two ways with a row of racks between them.
    found.extend(by_key_points);
    // Walls are seen from everywhere: they propose also what was seen from far apart, and every repetition.
    let alone = |a_from_b| Cluster { a_from_b, pieces: Vec::new(), support: 0.0 };
    found.extend(correlation::peaks(a, b).into_iter().map(alone));
    found
}

/// Clusters by how well whole maps fit there, those last that free space contradicts or that share little: repeated structure
/// misleads pieces, the whole less.
fn ranked(a: &RobotMap, b: &RobotMap, found: Vec<Cluster>) -> Vec<Cluster> {
    let mut kept = Vec::new();
    first_of_each_voxel(&b.whole.points, RANKED_ON, &mut VoxelTable::default(), &mut kept);
    let thinned: Vec<[f32; 3]> = kept.iter().map(|&i| b.whole.points[i as usize]).collect();
    let fitted = |cluster: Cluster| {
        let fit = sketch(&a.whole, &thinned, &cluster.a_from_b, false);
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
    // What one of the maps saw through does not stand there, however well the rest fits: in a hall that is seen from both ends,
    // half-turned poses fit more than the right one. And where little is shared a pose will be refused.
    let is_open = |cluster: &Cluster| {
        let (shared, violated) = seen(&a.whole, &thinned, &cluster.a_from_b);
        shared >= bounds::OVERLAP && violated <= bounds::VIOLATED
    };
    let open: Vec<bool> = distinct.par_iter().map(is_open).collect();
    let mut marked: Vec<(bool, Cluster)> = open.into_iter().zip(distinct).collect();
    // Stable: of either kind those that fit best come first.
    marked.sort_by_key(|(is_open, _)| !is_open);
    marked.into_iter().map(|(_, cluster)| cluster).collect()
}

/// Whole maps registered from what each cluster says, and judged where they come to.
fn followed(a: &RobotMap, b: &RobotMap, clusters: &[Cluster]) -> Verdict {
    let register = |cluster: &Cluster| search(&a.whole, &b.whole.points, &cluster.a_from_b, false);
    let found: Vec<Found> = clusters.par_iter().map(register).collect();
    // Those that come to one pose are judged once: evidence costs more than the registration.
    let found = distinct(clusters.iter().zip(found).collect(), |(_, found)| found.pose);
    judged(found.par_iter().map(|(cluster, found)| evidence(a, b, cluster, found)).collect())
}
