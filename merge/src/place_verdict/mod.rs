//! Whether the place that two maps were joined at is one, or two that share things: what both saw of each piece of surface.
//!
//! Every cell of surface that keyframes of both maps see at the poses found is compared there ([`match_cells`](backend::sim3_align::KeyframeView::match_cells)).
//! What it should look like there if it is one surface, its own map says (`own`): keyframes that are as far aside of each
//! other show what noise, blur, exposure, gleams and errors of pose and depth make of each cell, and how large the areas are that
//! differ and are one. How alike unrelated cells look is measured on cells of the one map and wrong ones of the other, by their contrast. The
//! ratio of both is what a cell says. A cell is compared twice, as a whole and [between its edges](Layer::Grain) only: edges are made in
//! numbers and outweigh the grain around them. Where little of what is bare is known again by its own map, what looks like wear is made in numbers (`worn`).
//! Cells that hang together are one piece (`areas`), and pieces are weighed as for all sensors
//! ([`backend::verdict`]).

mod agreement;
mod areas;
mod own;
mod seen;
mod worn;

use crate::acceptance::PlaceEvidence;
use crate::prepared::PreparedMap;
use agreement::{Agreement, Agreements};
use areas::{Noise, Spot, pieces};
use backend::params;
use backend::sim3_align::{CellMatch, CellParams, Layer};
use backend::verdict::weigh;
pub use backend::verdict::{Answer, Piece, PieceKind, Prior, Weighed};
use map::Edge;
use own::{Looked, Own, spot};
use rayon::prelude::*;
pub use seen::{SeenFrame, frames_verdict};
use serde::{Deserialize, Serialize};
use worn::Worn;

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
        /// From which `ln p(… | unrelated) − ln p(… | one surface)` on what all keyframes saw of a cell differs. Range 0–5: at 1 it
        /// is e times likelier of another surface.
        pub min_difference: f64 = 1.0,
        /// What is believed of changes and doubles.
        pub prior: Prior = Prior::default(),
    }
}

/// What is thought of a place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    let sides = Sides::new(source, target, edges, params);
    let agreements = Agreements::new(|layer| {
        let same = sides.of_source.samples(layer).chain(sides.of_target.samples(layer));
        Agreement::new(same, unrelated(source, target, edges, layer, params).into_iter())
    });
    let passes =
        [sides.of_source.passes(&agreements, params), sides.of_target.passes(&agreements, params)].concat();
    let noise = Noise::new(&passes, params);
    let spots: Vec<Vec<Spot>> = edges
        .par_iter()
        .enumerate()
        .map(|edge| spots(source, target, edge, &sides, &agreements, params).unwrap_or_default())
        .collect();
    let wear = [sides.of_source.wear(params), sides.of_target.wear(params)].concat();
    let worn = Worn::new(&wear, agreements.of(Layer::Grain).unrelated);
    let prior = worn.prior(&params.prior);
    let weighed = weigh(&pieces(&spots.concat(), &noise, params), &prior);
    PlaceVerdict { evidence: PlaceEvidence::new(&weighed, &prior, worn.grain()), weighed }
}

/// What both maps show of their own surface.
struct Sides {
    of_source: Own,
    of_target: Own,
}

impl Sides {
    fn new(source: &PreparedMap, target: &PreparedMap, edges: &[Edge], params: &PlaceParams) -> Self {
        let of_source = edges.iter().map(|edge| Looked::at(source, edge.to, &edge.from_from_to.inverse()));
        let of_target = edges.iter().map(|edge| Looked::at(target, edge.from, &edge.from_from_to));
        Self {
            of_source: Own::new(source, &of_source.collect::<Vec<_>>(), params),
            of_target: Own::new(target, &of_target.collect::<Vec<_>>(), params),
        }
    }
}

/// Contrast and correlation of cells of either map with wrong ones of the other.
fn unrelated(
    source: &PreparedMap,
    target: &PreparedMap,
    edges: &[Edge],
    layer: Layer,
    params: &PlaceParams,
) -> Vec<[f64; 2]> {
    let found = |edge: &Edge| -> Option<Vec<[f64; 2]>> {
        let (a, b) = (source.get(edge.to)?.view(), target.get(edge.from)?.view());
        Some([a.mismatch_cells(b, layer, &params.cells), b.mismatch_cells(a, layer, &params.cells)].concat())
    };
    let found: Vec<Option<Vec<[f64; 2]>>> = edges.par_iter().map(found).collect();
    found.into_iter().flatten().flatten().collect()
}

/// What the keyframes of an edge saw of each other's cells, both ways, in the target's world.
fn spots(
    source: &PreparedMap,
    target: &PreparedMap,
    (number, edge): (usize, &Edge),
    sides: &Sides,
    agreements: &Agreements,
    params: &PlaceParams,
) -> Option<Vec<Spot>> {
    let (a, b) = (source.get(edge.to)?.view(), target.get(edge.from)?.view());
    let (b_from_a, world_from_b) = (edge.from_from_to, target.world_from(edge.from)?);
    let world_from_a = world_from_b * b_from_a;
    let of_a = |cell: &CellMatch| {
        spot(cell, &world_from_a, sides.of_source.known(number, cell)?, agreements, params)
    };
    let of_b = |cell: &CellMatch| {
        spot(cell, &world_from_b, sides.of_target.known(number, cell)?, agreements, params)
    };
    let there = a.match_cells(b, &b_from_a, &params.cells);
    let back = b.match_cells(a, &b_from_a.inverse(), &params.cells);
    Some(there.iter().filter_map(of_a).chain(back.iter().filter_map(of_b)).collect())
}
