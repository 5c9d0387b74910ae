//! Whether frames show the place of a map that they were found at: as for two maps, by what its keyframes saw of their surface and what
//! becomes of it in the frames, which need no depth of their own.

use super::agreement::{Agreement, Agreements};
use super::areas::{Noise, Spot, pieces};
use super::own::{Looked, Own, spot};
use super::worn::Worn;
use super::{PlaceParams, PlaceVerdict, weigh};
use crate::acceptance::PlaceEvidence;
use crate::overlap::share_seen;
use crate::prepared::PreparedMap;
use backend::sim3_align::{CellMatch, KeyframeView, Layer};
use geometry::Sim3;
use map::KeyframeId;
use rayon::prelude::*;

/// Keyframes of the map that are compared with each frame: those that have most of their points in it.
const COMPARED: usize = 2;
/// Least share of a keyframe's points that the frame must have in view, and the cosine of the largest angle between the rays from both:
/// as for keyframes of two maps ([`FurtherParams`](crate::further::FurtherParams)).
const MIN_OVERLAP: f64 = 0.5;
const MIN_COSINE: f64 = 0.766;

/// A frame at the pose that it was found at.
pub struct SeenFrame {
    /// Its pose in the map's world and unit.
    pub world_from_frame: Sim3,
    /// What it shows.
    pub view: KeyframeView,
}

/// A keyframe that is compared with a frame.
struct Pair<'a> {
    keyframe: KeyframeId,
    frame: &'a KeyframeView,
    /// In the keyframe's unit.
    frame_from_keyframe: Sim3,
}

/// Judges whether frames show the place of a map where they were found.
pub fn frames_verdict(map: &PreparedMap, frames: &[SeenFrame], params: &PlaceParams) -> PlaceVerdict {
    let pairs: Vec<Pair> = frames.iter().flat_map(|frame| compared(map, frame)).collect();
    let looked: Vec<Option<Looked>> = pairs
        .iter()
        .map(|pair| Looked::at(map, pair.keyframe, &pair.frame_from_keyframe.inverse()))
        .collect();
    let own = Own::new(map, &looked, params);
    let agreements = Agreements::new(|layer| {
        Agreement::new(own.samples(layer), unrelated(map, &pairs, layer, params).into_iter())
    });
    let noise = Noise::new(&own.passes(&agreements, params), params);
    let spots = |(number, pair): (usize, &Pair)| -> Option<Vec<Spot>> {
        let (view, world) = (map.get(pair.keyframe)?.view(), map.world_from(pair.keyframe)?);
        let cells = view.match_cells(pair.frame, &pair.frame_from_keyframe, &params.cells);
        let of = |cell: &CellMatch| spot(cell, &world, own.known(number, cell)?, &agreements, params);
        Some(cells.iter().filter_map(of).collect())
    };
    let spots: Vec<Option<Vec<Spot>>> = pairs.par_iter().enumerate().map(spots).collect();
    let spots: Vec<Spot> = spots.into_iter().flatten().flatten().collect();
    let weighed = weigh(&pieces(&spots, &noise, params), &params.prior);
    let worn = Worn::new(&own.wear(params), agreements.of(Layer::Grain).unrelated);
    PlaceVerdict { evidence: PlaceEvidence::new(&weighed, &params.prior, worn.grain()), weighed }
}

/// The keyframes that see most of what a frame shows.
fn compared<'a>(map: &PreparedMap, frame: &'a SeenFrame) -> Vec<Pair<'a>> {
    let shares = map.glimpses().iter().filter_map(|glimpse| {
        let frame_from_keyframe = frame.world_from_frame.inverse() * glimpse.world_from_keyframe;
        let camera = frame.view.camera();
        let share = share_seen(&glimpse.points, &frame_from_keyframe, camera, MIN_COSINE, MIN_OVERLAP)?;
        Some((share, Pair { keyframe: glimpse.id, frame: &frame.view, frame_from_keyframe }))
    });
    let mut shares: Vec<(f64, Pair)> = shares.collect();
    // Stable: of equals the earlier one.
    shares.sort_by(|a, b| b.0.total_cmp(&a.0));
    shares.into_iter().take(COMPARED).map(|(_, pair)| pair).collect()
}

/// Contrast and correlation of cells of the keyframes with wrong ones of the frames.
fn unrelated(map: &PreparedMap, pairs: &[Pair], layer: Layer, params: &PlaceParams) -> Vec<[f64; 2]> {
    let found =
        |pair: &Pair| Some(map.get(pair.keyframe)?.view().mismatch_cells(pair.frame, layer, &params.cells));
    let found: Vec<Option<Vec<[f64; 2]>>> = pairs.par_iter().map(found).collect();
    found.into_iter().flatten().flatten().collect()
}
