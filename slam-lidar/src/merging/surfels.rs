//! A map as pieces of surface, a cell's each, that several of its keyframes saw.

use super::surfel::Surfel;
use super::views::{Crossings, View};
use crate::keyframe::{Keyframe, transformed};
use crate::surfaces::sorted_eigen;
use crate::voxels::{VoxelTable, cell_at, key_of};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Edge of the cells, metres: half of the smallest thing that tells places apart.
pub const CELL: f32 = 0.25;
/// Thickness up to which the points of a cell are flat, standard deviation in metres: about twice the noise of ranges.
const FLAT: f32 = 0.04;
/// Points of a cell, at least: three are a plane by themselves.
const POINTS: u32 = 5;
/// Keyframes that saw it, at least: one may be of something that moves.
const KEYFRAMES: u32 = 2;
/// So many times as many of the map's own rays must end on a piece as pass through it.
const OWN: u32 = 4;
/// A ray of the map itself ends on a piece within so many standard deviations.
const DEVIATIONS: f32 = 4.0;

/// A map's surfels and views.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    /// The surfels, by where their cells were first seen.
    pub all: Vec<Surfel>,
    /// What its keyframes saw.
    pub views: Vec<View>,
}

#[derive(Clone, Copy, Default)]
struct Sums {
    count: u32,
    keyframes: u32,
    last: u32,
    first: [f64; 3],
    second: [f64; 6],
}

impl Surfels {
    /// Of keyframes, whose poses are in the map's frame.
    pub fn new(keyframes: &[Keyframe]) -> Self {
        let views: Vec<View> =
            keyframes.par_iter().map(|k| View::new(&k.points, &k.world_from_sensor.inverse())).collect();
        let (mut table, mut cells, mut sums) = (VoxelTable::default(), Vec::new(), Vec::<Sums>::new());
        for (number, keyframe) in keyframes.iter().enumerate() {
            for &p in &keyframe.points {
                let p = transformed(&keyframe.world_from_sensor, p);
                let cell = cell_at(p, 1.0 / CELL);
                let (index, new) = table.get_or_insert(key_of(cell));
                if new {
                    cells.push(cell);
                    sums.push(Sums::default());
                }
                sums[index as usize].add(p, cell, number as u32 + 1);
            }
        }
        let found: Vec<Surfel> =
            cells.iter().zip(&sums).filter_map(|(cell, sums)| sums.surfel(*cell)).collect();
        let is_settled = |surfel: &Surfel| {
            let Crossings { hits, passes } = crossings(&views, surfel, 0.0, DEVIATIONS).0;
            hits >= OWN * passes
        };
        let settled: Vec<bool> = found.par_iter().map(is_settled).collect();
        let all = found
            .into_iter()
            .zip(settled)
            .filter_map(|(surfel, settled)| settled.then_some(surfel))
            .collect();
        Self { all, views }
    }
}

/// The rays of all views that cross a surfel, which lies in their map's frame, and how many of the views pass it by.
pub fn crossings(views: &[View], surfel: &Surfel, pose: f32, deviations: f32) -> (Crossings, u32) {
    let (mut sum, mut through) = (Crossings::default(), 0);
    for view in views {
        let Crossings { hits, passes } = view.cross(surfel, pose, deviations);
        (sum.hits, sum.passes) = (sum.hits + hits, sum.passes + passes);
        through += u32::from(passes > hits);
    }
    (sum, through)
}

impl Sums {
    fn add(&mut self, p: [f32; 3], cell: [i32; 3], keyframe: u32) {
        let [x, y, z] = [0, 1, 2].map(|i| f64::from(p[i]) - f64::from(CELL) * (f64::from(cell[i]) + 0.5));
        self.count += 1;
        self.keyframes += u32::from(std::mem::replace(&mut self.last, keyframe) != keyframe);
        self.first = [self.first[0] + x, self.first[1] + y, self.first[2] + z];
        let squares = [x * x, x * y, x * z, y * y, y * z, z * z];
        self.second.iter_mut().zip(squares).for_each(|(sum, v)| *sum += v);
    }

    fn surfel(&self, cell: [i32; 3]) -> Option<Surfel> {
        if self.count < POINTS || self.keyframes < KEYFRAMES {
            return None;
        }
        let n = f64::from(self.count);
        let mean = Vector3::from(self.first) / n;
        let s = self.second.map(|v| v / n);
        let moments = Matrix3::new(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]);
        let (values, vectors) = sorted_eigen(moments - mean * mean.transpose());
        let deviations = values.map(|v| v.sqrt() as f32);
        let middle = [0, 1, 2].map(|i| (mean[i] + f64::from(CELL) * (f64::from(cell[i]) + 0.5)) as f32);
        let axes = [0, 1, 2].map(|k| [0, 1, 2].map(|i| vectors[(i, k)] as f32));
        Some(Surfel { middle, axes, deviations, is_flat: deviations[0] <= FLAT, cell })
    }
}
