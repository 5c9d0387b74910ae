//! A robot's map, ready to be merged: as a whole, and in pieces that are independent of each other.

use super::key_points::{KeyPoint, key_points};
use super::own_depth::{OwnDepth, own_depths};
use super::patches::Patches;
use super::surfels::{CELL, Surfels};
use super::walls::{Walls, walls};
use crate::keyframe::{Keyframe, Seen, Submap, transformed};
use crate::scan_context::ScanContext;
use crate::voxels::{VoxelTable, first_of_each_voxel};
use geometry::Se3;
use rayon::prelude::*;
use std::sync::OnceLock;

/// A piece of a map: the keyframes along some metres of the way.
#[derive(Clone, Debug)]
pub struct Piece {
    /// The keyframe in the middle, by index.
    pub keyframe: usize,
    /// Its pose.
    pub map_from_piece: Se3,
    /// Points in the frame of that keyframe, thinned, metres.
    pub points: Vec<[f32; 3]>,
}

/// A map that can be merged.
#[derive(Clone, Debug)]
pub struct RobotMap {
    /// Everything, in the map's frame.
    pub whole: Submap,
    /// Poses of the keyframes.
    pub poses: Vec<Se3>,
    /// Their descriptors.
    pub contexts: Vec<ScanContext>,
    /// Pieces along the way; no keyframe is in two of them.
    pub pieces: Vec<Piece>,
    /// A point of each cell of surface that several of its keyframes saw, in the map's frame, metres.
    pub settled: Vec<[f32; 3]>,
    /// Pieces of surface that it holds for certain, and its rays.
    pub surfels: Surfels,
    /// Surfels that hang together.
    pub patches: Patches,
    /// Key points, found when a merge first asks for them.
    key_points: OnceLock<Vec<KeyPoint>>,
    /// Its walls, likewise.
    walls: OnceLock<Walls>,
    /// What its own views say of each surfel, likewise.
    own_depths: OnceLock<Vec<OwnDepth>>,
}

/// Length of way of a piece, metres: as far as loops reach on either side of a keyframe, and a few scans at least.
const LENGTH: f64 = 3.0;
/// Grid on which pieces are compared, metres: that of submaps.
const GRID: f32 = 0.5;

/// Keyframes that see a surface in a cell, at least: one may be of something that moves, or look past an edge.
const VIEWS: usize = 2;
/// So many times as many as see through it.
const MAJORITY: usize = 2;

/// A point of each cell of surface that several keyframes saw and few saw through.
fn settled(keyframes: &[Keyframe], whole: &Submap) -> Vec<[f32; 3]> {
    let in_map = |k: &Keyframe| -> Vec<[f32; 3]> {
        k.points.iter().map(|&p| transformed(&k.world_from_sensor, p)).collect()
    };
    let all: Vec<[f32; 3]> = keyframes.iter().flat_map(in_map).collect();
    let mut kept = Vec::new();
    first_of_each_voxel(&all, CELL, &mut VoxelTable::default(), &mut kept);
    let is_settled = |point: &[f32; 3]| {
        let (mut free, mut surface) = (0, 0);
        for sight in &whole.sights {
            match sight.look(*point) {
                Seen::Free => free += 1,
                Seen::Surface => surface += 1,
                Seen::Hidden => {}
            }
        }
        surface >= VIEWS && surface > MAJORITY * free
    };
    kept.par_iter().map(|&i| all[i as usize]).filter(is_settled).collect()
}

impl RobotMap {
    /// Prepares keyframes, whose poses are in one frame.
    pub fn new(keyframes: &[Keyframe]) -> Self {
        let (whole, surfels) =
            rayon::join(|| Submap::new(keyframes.iter(), &Se3::identity()), || Surfels::new(keyframes));
        Self {
            settled: settled(keyframes, &whole),
            whole,
            patches: Patches::new(&surfels.all),
            surfels,
            poses: keyframes.iter().map(|k| k.world_from_sensor).collect(),
            contexts: keyframes.iter().map(|k| k.context.clone()).collect(),
            pieces: spans(keyframes).into_iter().map(|span| piece(keyframes, span)).collect(),
            key_points: OnceLock::new(),
            walls: OnceLock::new(),
            own_depths: OnceLock::new(),
        }
    }

    /// Its walls.
    pub(super) fn walls(&self) -> &Walls {
        self.walls.get_or_init(|| walls(&self.whole))
    }

    /// What its own views say of each of its surfels.
    pub(super) fn own_depths(&self) -> &[OwnDepth] {
        self.own_depths.get_or_init(|| own_depths(&self.surfels, &self.poses))
    }

    /// Whether it comes before another in an order that has nothing to do with how maps were given: what follows from two maps is
    /// computed in one order, so that both orders give the same bits.
    pub fn comes_before(&self, other: &Self) -> bool {
        let numbers = |map: &Self| -> (usize, usize) { (map.poses.len(), map.whole.points.len()) };
        let poses = |map: &Self| {
            map.poses.iter().flat_map(|pose| pose.to_tum().map(f64::to_bits)).collect::<Vec<_>>()
        };
        let points =
            |map: &Self| map.whole.points.iter().flat_map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
        let order = numbers(self).cmp(&numbers(other));
        order
            .then_with(|| poses(self).cmp(&poses(other)))
            .then_with(|| points(self).cmp(&points(other)))
            .is_lt()
    }

    /// Its key points with their descriptors.
    pub(super) fn key_points(&self) -> &[KeyPoint] {
        self.key_points.get_or_init(|| key_points(&self.whole, &self.poses))
    }
}

/// Keyframes in runs of [`LENGTH`] metres of way.
fn spans(keyframes: &[Keyframe]) -> Vec<std::ops::Range<usize>> {
    let (mut spans, mut begin, mut path) = (Vec::new(), 0, 0.0);
    for i in 1..keyframes.len() {
        path += (keyframes[i].world_from_sensor.translation - keyframes[i - 1].world_from_sensor.translation)
            .norm();
        if path > LENGTH {
            spans.push(begin..i);
            (begin, path) = (i, 0.0);
        }
    }
    if begin < keyframes.len() {
        spans.push(begin..keyframes.len());
    }
    spans
}

fn piece(keyframes: &[Keyframe], span: std::ops::Range<usize>) -> Piece {
    let keyframe = (span.start + span.end) / 2;
    let map_from_piece = keyframes[keyframe].world_from_sensor;
    let mut all = Vec::new();
    for k in &keyframes[span] {
        let piece_from_sensor = map_from_piece.inverse() * k.world_from_sensor;
        all.extend(k.points.iter().map(|&p| transformed(&piece_from_sensor, p)));
    }
    let mut kept = Vec::new();
    first_of_each_voxel(&all, GRID, &mut VoxelTable::default(), &mut kept);
    Piece { keyframe, map_from_piece, points: kept.iter().map(|&i| all[i as usize]).collect() }
}
