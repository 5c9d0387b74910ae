//! What one map shows of its own surface: the measure of what keyframes of one surface see differently.

use super::PlaceParams;
use super::agreement::Agreements;
use super::areas::Spot;
use crate::prepared::PreparedMap;
use backend::sim3_align::{CellMatch, Layer};
use backend::verdict::PieceKind;
use geometry::Sim3;
use map::KeyframeId;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Keyframes before and after one that it may be compared with, of one map.
const AROUND: usize = 20;
/// How many of them it is.
const PARTNERS: usize = 3;

/// A keyframe of one map that is compared with one of another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Looked {
    /// The keyframe.
    pub id: KeyframeId,
    /// How far aside the other is ([`aside`]), radians.
    pub aside: f64,
}

impl Looked {
    /// By where the other is.
    pub fn at(map: &PreparedMap, id: KeyframeId, keyframe_from_other: &Sim3) -> Option<Self> {
        Some(Self { id, aside: aside(depth(map, id)?, keyframe_from_other) })
    }
}

/// A keyframe's cells in a partner: the number of the keyframe among those looked at, which of its partners it is, and its pose.
type SeenByPartner = (usize, usize, Sim3, Vec<CellMatch>);

/// Cells of keyframes of one map in others of it.
pub(super) struct Own {
    seen: Vec<SeenByPartner>,
    /// Of each cell and layer, by the number of the keyframe, the sum of its correlations, and of how many.
    sums: BTreeMap<(usize, usize, Layer), (f64, usize)>,
}

impl Own {
    /// Of keyframes and those of their map that are as far aside of them as those of the other map are: from farther aside edges
    /// cover more and gleams wander. A keyframe without any so far aside says nothing.
    pub fn new(map: &PreparedMap, looked: &[Option<Looked>], params: &PlaceParams) -> Self {
        let numbered = looked.iter().enumerate().filter_map(|(number, looked)| Some((number, (*looked)?)));
        let pairs: Vec<(usize, usize, KeyframeId, KeyframeId)> = numbered
            .flat_map(|(number, looked)| {
                let partners = partners(map, looked).into_iter().enumerate();
                partners.map(move |(rank, partner)| (number, rank, looked.id, partner))
            })
            .collect();
        let found = |&(number, rank, i, j): &(usize, usize, KeyframeId, KeyframeId)| {
            let there = relative(map, i, j)?;
            let cells = map.get(i)?.view().match_cells(map.get(j)?.view(), &there, &params.cells);
            Some((number, rank, map.world_from(i)?, cells))
        };
        let found: Vec<_> = pairs.par_iter().map(found).collect();
        let seen: Vec<_> = found.into_iter().flatten().collect();
        let mut sums: BTreeMap<(usize, usize, Layer), (f64, usize)> = BTreeMap::new();
        for (number, cell) in visible(&seen) {
            let (sum, count) = sums.entry((number, cell.cell, cell.layer)).or_default();
            *sum += cell.correlation;
            *count += 1;
        }
        Self { seen, sums }
    }

    /// How well its map knows a cell of the keyframe that was looked at as number `number`: its mean correlation in other keyframes,
    /// −1 to 1; nothing where none shows it.
    pub fn known(&self, number: usize, cell: &CellMatch) -> Option<f64> {
        self.sums.get(&(number, cell.cell, cell.layer)).map(|(sum, count)| sum / *count as f64)
    }

    /// The same without the keyframe that a match is of.
    fn known_without(&self, number: usize, cell: &CellMatch) -> Option<f64> {
        let &(sum, count) = self.sums.get(&(number, cell.cell, cell.layer))?;
        let own = if cell.is_visible { (cell.correlation, 1) } else { (0.0, 0) };
        (count > own.1).then(|| (sum - own.0) / (count - own.1) as f64)
    }

    /// Of each match of a layer how well other keyframes know the cell, and its correlation.
    pub fn samples(&self, layer: Layer) -> impl Iterator<Item = [f64; 2]> + '_ {
        let of =
            |(number, cell): (usize, &CellMatch)| Some([self.known_without(number, cell)?, cell.correlation]);
        visible(&self.seen).filter(move |(_, cell)| cell.layer == layer).filter_map(of)
    }

    /// Correlations of cells of wear in other keyframes of the map.
    pub fn wear(&self, params: &PlaceParams) -> Vec<f64> {
        let is_wear = |(_, cell): &(usize, &CellMatch)| cell.layer == Layer::Grain && is_wear(cell, params);
        let cells = visible(&self.seen).filter(is_wear);
        cells.map(|(_, cell)| cell.correlation).collect()
    }

    /// The cells in their world, each keyframe's seen by one of its partners, then by the next.
    pub fn passes(&self, agreements: &Agreements, params: &PlaceParams) -> Vec<Vec<Spot>> {
        let mut passes = vec![Vec::new(); PARTNERS];
        for (number, rank, world, cells) in &self.seen {
            let spot =
                |cell: &CellMatch| spot(cell, world, self.known_without(*number, cell)?, agreements, params);
            passes[*rank].extend(cells.iter().filter_map(spot));
        }
        passes
    }
}

/// The cells that nothing can hide, with the number of their keyframe.
fn visible(seen: &[SeenByPartner]) -> impl Iterator<Item = (usize, &CellMatch)> {
    let all = seen.iter().flat_map(|(number, .., cells)| cells.iter().map(move |cell| (*number, cell)));
    all.filter(|(_, cell)| cell.is_visible)
}

/// What a match says of the surface, by how well the cell is known, and where the source's camera is; nothing where the other layer
/// says it.
pub(super) fn spot(
    cell: &CellMatch,
    world_from_source: &Sim3,
    known: f64,
    agreements: &Agreements,
    params: &PlaceParams,
) -> Option<Spot> {
    let kind = match (cell.layer, is_wear(cell, params)) {
        (Layer::Pattern, false) => PieceKind::Look,
        (Layer::Grain, true) => PieceKind::Wear,
        (Layer::Pattern, true) | (Layer::Grain, false) => return None,
    };
    Some(Spot {
        position: *world_from_source * cell.centre,
        width: cell.width * world_from_source.scale,
        kind,
        ln_agreement: agreements.of(cell.layer).ln_ratio(cell, known),
    })
}

/// Whether it is wear if anything shows between the edges.
fn is_wear(cell: &CellMatch, params: &PlaceParams) -> bool {
    cell.contrast <= params.max_wear_contrast && cell.roundness >= params.min_wear_roundness
}

/// How far aside another camera is from a keyframe of this median depth and how far it is turned: the angle that what is seen moves by,
/// radians.
fn aside(depth: f64, keyframe_from_other: &Sim3) -> f64 {
    keyframe_from_other.translation.norm() / depth + keyframe_from_other.rotation.angle()
}

/// The median depth of a keyframe, in its unit.
fn depth(map: &PreparedMap, id: KeyframeId) -> Option<f64> {
    map.map().keyframes.get(&id)?.semi_dense.median_depth()
}

fn relative(map: &PreparedMap, i: KeyframeId, j: KeyframeId) -> Option<Sim3> {
    Some(map.world_from(j)?.inverse() * map.world_from(i)?)
}

/// Those of the keyframes around one that are as far aside, by how nearly; none where all are nearer.
fn partners(map: &PreparedMap, looked: Looked) -> Vec<KeyframeId> {
    let i = looked.id;
    let Some(depth) = depth(map, i) else { return Vec::new() };
    let of = |j: KeyframeId| Some((aside(depth, &relative(map, j, i)?), j));
    let others = map.around(i, AROUND).into_iter().filter(|j| *j != i);
    let mut others: Vec<(f64, KeyframeId)> = others.filter_map(of).collect();
    let off = |(aside, _): &(f64, KeyframeId)| (aside - looked.aside).abs();
    others.sort_by(|a, b| off(a).total_cmp(&off(b)).then(a.1.cmp(&b.1)));
    let is_covered = others.iter().any(|(aside, _)| *aside >= looked.aside);
    others.into_iter().take(if is_covered { PARTNERS } else { 0 }).map(|(_, j)| j).collect()
}
