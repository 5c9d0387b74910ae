//! Surfels that hang together on one plane, and how often the like of each occurs in its map.
//!
//! A wall, the front of a cabinet or of a pallet is a patch. What is made in numbers (a door's frame, an upright of a rack)
//! occurs often in a map and says little about where one is; the front of a cabinet that stands nowhere else says much.

use super::surfel::Surfel;
use super::surfels::CELL;
use crate::voxels::{VoxelTable, key_of};
use nalgebra::Vector3;

/// No patch: the surfel is not flat.
pub const NONE: u32 = u32::MAX;
/// Cosine of the angle between normals of one patch: 20°, which a cell of few points errs by.
const PARALLEL: f32 = 0.94;
/// How far the one lies off the other's plane, metres: twice the thickness that is flat.
const OFF: f32 = 0.08;
/// Cells of a group lie no farther from each other, cells along each axis: rings of 16 lie half a metre apart at 14 m.
const GROUP_REACH: i32 = 2;
/// Two patches are alike whose lower and upper end and width differ by less, metres: more than half of a cell, which their rims err by.
const MAX_DIFFERENCE: f32 = 0.15;
/// Cosine of the steepest slope of a level patch.
const LEVEL: f32 = 0.7;

/// A patch of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Its surfels.
    pub cells: u32,
    /// Patches of its map that are like it, itself included.
    pub occurrences: u32,
}

/// The patches of a map.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    /// The patch of each surfel, or [`NONE`].
    pub of: Vec<u32>,
    /// The patches, by their first surfel.
    pub all: Vec<Patch>,
}

/// What patches are compared by: whether level, their lower and upper end, their width, metres.
type Shape = (bool, [f32; 3]);

impl Patches {
    /// Of a map's surfels.
    pub fn new(surfels: &[Surfel]) -> Self {
        let mut of = vec![NONE; surfels.len()];
        let groups = grouped(surfels, |surfel| surfel.is_flat, is_one_plane);
        for (number, group) in groups.iter().enumerate() {
            group.iter().for_each(|&surfel| of[surfel] = number as u32);
        }
        let shapes: Vec<Shape> = groups.iter().map(|group| shape(surfels, group)).collect();
        let patch = |(group, own): (&Vec<usize>, &Shape)| Patch {
            cells: group.len() as u32,
            occurrences: shapes.iter().filter(|other| is_similar(own, other)).count() as u32,
        };
        Self { of, all: groups.iter().zip(&shapes).map(patch).collect() }
    }
}

/// Surfels for which `is_asked` holds, in groups of those that lie side by side and `belong` together; by their first.
pub fn grouped(
    surfels: &[Surfel],
    is_asked: impl Fn(&Surfel) -> bool,
    belong: impl Fn(&Surfel, &Surfel) -> bool,
) -> Vec<Vec<usize>> {
    let (mut table, mut at) = (VoxelTable::default(), Vec::new());
    for (i, surfel) in surfels.iter().enumerate().filter(|(_, surfel)| is_asked(surfel)) {
        // A map has one surfel a cell.
        if table.get_or_insert(key_of(surfel.cell)).1 {
            at.push(i);
        }
    }
    let width = 2 * GROUP_REACH + 1;
    let (mut reached, mut groups) = (vec![false; at.len()], Vec::new());
    for start in 0..at.len() {
        if std::mem::replace(&mut reached[start], true) {
            continue;
        }
        let (mut open, mut group) = (vec![start], Vec::new());
        while let Some(next) = open.pop() {
            let own = &surfels[at[next]];
            group.push(at[next]);
            let [x, y, z] = own.cell;
            for k in 0..width.pow(3) {
                let [dx, dy, dz] = [k % width, k / width % width, k / width.pow(2)].map(|d| d - GROUP_REACH);
                let Some(other) = table.get(key_of([x + dx, y + dy, z + dz])) else { continue };
                let other = other as usize;
                if !reached[other] && belong(own, &surfels[at[other]]) {
                    reached[other] = true;
                    open.push(other);
                }
            }
        }
        groups.push(group);
    }
    groups
}

/// Area of so many surfels, square metres.
pub fn area(cells: usize) -> f64 {
    cells as f64 * f64::from(CELL * CELL)
}

fn is_one_plane(one: &Surfel, other: &Surfel) -> bool {
    let [n, m] = [one.axes[0], other.axes[0]].map(Vector3::from);
    let apart = Vector3::from(other.middle) - Vector3::from(one.middle);
    n.dot(&m).abs() > PARALLEL && n.dot(&apart).abs() < OFF && m.dot(&apart).abs() < OFF
}

fn shape(surfels: &[Surfel], group: &[usize]) -> Shape {
    let normal = group.iter().map(|&i| surfels[i].axes[0][2].abs()).sum::<f32>() / group.len().max(1) as f32;
    let is_level = normal > LEVEL;
    // Along the wall, or across the level patch.
    let first = group.first().map_or([1.0, 0.0, 0.0], |&i| surfels[i].axes[0]);
    let flat = first[0].hypot(first[1]).max(1e-6);
    let along = if is_level { [1.0, 0.0] } else { [-first[1] / flat, first[0] / flat] };
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for &i in group {
        let surfel = &surfels[i];
        let place = [surfel.middle[2], along[0] * surfel.middle[0] + along[1] * surfel.middle[1]];
        let axes = [[0.0, 0.0, 1.0], [along[0], along[1], 0.0]];
        for (k, axis) in axes.into_iter().enumerate() {
            // An even surface reaches 1.73 standard deviations from its middle.
            let reach = 1.73 * deviation_along(surfel, axis);
            (low[k], high[k]) = (low[k].min(place[k] - reach), high[k].max(place[k] + reach));
        }
    }
    (is_level, [low[0], high[0], high[1] - low[1]])
}

fn deviation_along(surfel: &Surfel, axis: [f32; 3]) -> f32 {
    let part =
        |k: usize| (Vector3::from(surfel.axes[k]).dot(&Vector3::from(axis)) * surfel.deviations[k]).powi(2);
    (part(0) + part(1) + part(2)).sqrt()
}

fn is_similar(one: &Shape, other: &Shape) -> bool {
    one.0 == other.0 && (0..3).all(|k| (one.1[k] - other.1[k]).abs() < MAX_DIFFERENCE)
}
