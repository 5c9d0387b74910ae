//! Whether the place that two maps were joined at is one, or two that share things: what both saw of each piece of surface.
//!
//! Every cell of surface that keyframes of both maps see at the poses found is compared there ([`match_cells`](backend::sim3_align::KeyframeView::match_cells)). How
//! alike cells of one surface look is measured where it is known that it is one: between keyframes of one map that are as far aside of each other; how
//! alike unrelated ones look, on cells of the one map and wrong ones of the other. Both depend on the contrast, and hold what
//! noise, blur, exposure and errors of pose and depth make of it. The ratio of both is what a cell says; cells that hang
//! together are one piece, and pieces are weighed as for all sensors ([`backend::verdict`]).

mod agreement;
mod areas;

use crate::acceptance::PlaceEvidence;
use crate::prepared::PreparedMap;
use agreement::Agreement;
use areas::{Spot, pieces};
use backend::params;
use backend::sim3_align::{CellMatch, CellParams};
use backend::verdict::weigh;
pub use backend::verdict::{Answer, Piece, PieceKind, Prior, Weighed};
use geometry::Sim3;
use map::{Edge, KeyframeId};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Keyframes before and after one that it may be compared with, of one map.
const AROUND: usize = 8;
/// How many of them it is.
const PARTNERS: usize = 3;

params! {
    /// How it is judged whether two maps show one place.
    pub struct PlaceParams {
        /// The comparison of cells of surface.
        pub cells: CellParams = CellParams::default(),
        /// Cells that make one thing. Range 1–100: four are a tenth of a view of 75° wide.
        pub cells_of_thing: f64 = 4.0,
        /// Largest contrast of what is wear, standard deviation over mean intensity. Range 0–1. Print and edges have a tenth and
        /// more, grain of plaster, concrete, cloth and paint 1 to 4 %.
        pub max_wear_contrast: f64 = 0.04,
        /// Least ratio of the eigenvalues of a cell's structure tensor that is wear. Range 0–1: an edge has next to none, grain more
        /// than a half.
        pub min_wear_roundness: f64 = 0.4,
        /// What is believed of changes and doubles.
        pub prior: Prior = Prior::default(),
    }
}

/// What is thought of a place.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceVerdict {
    /// In numbers.
    pub evidence: PlaceEvidence,
    /// The pieces of surface that it rests on, each with what it adds.
    pub weighed: Weighed,
}

/// Judges the place of two maps by closures between them, edges from keyframes of the target to such of the source.
pub fn place_verdict(
    source: &PreparedMap,
    target: &PreparedMap,
    edges: &[Edge],
    params: &PlaceParams,
) -> PlaceVerdict {
    let agreement = agreement(source, target, edges, params);
    let spots: Vec<Vec<Spot>> = edges
        .par_iter()
        .map(|edge| spots(source, target, edge, &agreement, params).unwrap_or_default())
        .collect();
    let weighed = weigh(&pieces(&spots.concat(), params), &params.prior);
    PlaceVerdict { evidence: PlaceEvidence::new(&weighed, &params.prior), weighed }
}

/// How alike cells look that are one, and those that are not.
fn agreement(source: &PreparedMap, target: &PreparedMap, edges: &[Edge], params: &PlaceParams) -> Agreement {
    let mut apart: Vec<f64> =
        edges.iter().filter_map(|edge| aside(target, edge.from, &edge.from_from_to)).collect();
    apart.sort_by(f64::total_cmp);
    let apart = apart.get(apart.len() / 2).copied().unwrap_or(0.0);
    let mut same = own_matches(source, edges.iter().map(|edge| edge.to).collect(), apart, params);
    same.extend(own_matches(target, edges.iter().map(|edge| edge.from).collect(), apart, params));
    let other = |edge: &Edge| -> Option<Vec<[f64; 2]>> {
        let (a, b) = (source.get(edge.to)?.view(), target.get(edge.from)?.view());
        Some([a.mismatch_cells(b, &params.cells), b.mismatch_cells(a, &params.cells)].concat())
    };
    let other: Vec<Option<Vec<[f64; 2]>>> = edges.par_iter().map(other).collect();
    Agreement::new(same.into_iter(), other.into_iter().flatten().flatten())
}

/// How far aside another camera is from a keyframe and how far it is turned: the angle that what is seen moves by, radians.
fn aside(map: &PreparedMap, id: KeyframeId, keyframe_from_other: &Sim3) -> Option<f64> {
    let depth = map.map().keyframes.get(&id)?.semi_dense.median_depth()?;
    Some(keyframe_from_other.translation.norm() / depth + keyframe_from_other.rotation.angle())
}

/// Contrast and correlation of the cells of keyframes of one map in others of it, those that are as far aside of each other as
/// keyframes of both maps are.
fn own_matches(
    map: &PreparedMap,
    ids: BTreeSet<KeyframeId>,
    apart: f64,
    params: &PlaceParams,
) -> Vec<[f64; 2]> {
    let relative = |i: KeyframeId, j: KeyframeId| Some(map.world_from(j)?.inverse() * map.world_from(i)?);
    let partners = |&i: &KeyframeId| {
        let off = |j: KeyframeId| Some((aside(map, j, &relative(i, j)?)? - apart).abs());
        let others = map.around(i, AROUND).into_iter().filter(|j| *j != i);
        let mut others: Vec<(f64, KeyframeId)> = others.filter_map(|j| Some((off(j)?, j))).collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        others.into_iter().take(PARTNERS).map(move |(_, j)| (i, j)).collect::<Vec<_>>()
    };
    let pairs: Vec<(KeyframeId, KeyframeId)> = ids.iter().flat_map(partners).collect();
    let found = |&(i, j): &(KeyframeId, KeyframeId)| -> Option<Vec<CellMatch>> {
        Some(map.get(i)?.view().match_cells(map.get(j)?.view(), &relative(i, j)?, &params.cells))
    };
    let found: Vec<Option<Vec<CellMatch>>> = pairs.par_iter().map(found).collect();
    found.into_iter().flatten().flatten().map(|cell| [cell.contrast, cell.correlation]).collect()
}

/// What the keyframes of an edge saw of each other's cells, both ways, in the target's world.
fn spots(
    source: &PreparedMap,
    target: &PreparedMap,
    edge: &Edge,
    agreement: &Agreement,
    params: &PlaceParams,
) -> Option<Vec<Spot>> {
    let (a, b) = (source.get(edge.to)?.view(), target.get(edge.from)?.view());
    let (b_from_a, world_from_b) = (edge.from_from_to, target.world_from(edge.from)?);
    let spot = |world: Sim3| {
        move |cell: &CellMatch| Spot {
            position: world * cell.centre,
            width: cell.width * world.scale,
            contrast: cell.contrast,
            roundness: cell.roundness,
            ln_agreement: agreement.ln_ratio(cell.contrast, cell.correlation),
        }
    };
    let there = a.match_cells(b, &b_from_a, &params.cells);
    let back = b.match_cells(a, &b_from_a.inverse(), &params.cells);
    let there = there.iter().map(spot(world_from_b * b_from_a));
    Some(there.chain(back.iter().map(spot(world_from_b))).collect())
}
