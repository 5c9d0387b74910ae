//! Key points of a map by the paper: normals, Harris 3-D key points, FPFH.
//!
//! The paper gives no parameters; radii here are multiples of the grid on which maps are compared, as is usual.

use crate::keyframe::Submap;
use crate::surfaces::sorted_eigen;
use crate::voxels::{VoxelTable, cell_at, key_of};
use geometry::Se3;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Radius of the neighbours that give a normal, metres: two and a half steps of the grid.
const NORMAL_RADIUS: f64 = 1.25;
/// Radius of a descriptor, metres: five steps.
const DESCRIPTOR_RADIUS: f64 = 2.5;
/// Radius within which a key point is the strongest, metres.
const APART: f64 = 1.0;
/// Key points of a map, the strongest.
const KEY_POINTS: usize = 1500;
/// Bins of each of the three angles of a descriptor.
const BINS: usize = 11;

/// A descriptor: eleven bins of each of three angles (FPFH).
pub(super) type Descriptor = [f32; 3 * BINS];

/// A key point of a map, metres, with its descriptor.
pub(super) type KeyPoint = (Vector3<f64>, Descriptor);

/// The key points of a map with their descriptors, the strongest first; `poses` are those of its keyframes.
pub(super) fn key_points(map: &Submap, poses: &[Se3]) -> Vec<KeyPoint> {
    Cloud::new(&map.points, poses).described()
}

/// A map's points with normals.
struct Cloud {
    points: Vec<Vector3<f64>>,
    /// Unit normals towards the nearest keyframe; zero where there are too few neighbours.
    normals: Vec<Vector3<f64>>,
    grid: Grid,
}

/// Points in cells as wide as a descriptor's radius.
struct Grid {
    table: VoxelTable,
    cells: Vec<Vec<u32>>,
}

impl Grid {
    fn cell(point: &Vector3<f64>) -> [i32; 3] {
        cell_at([point.x as f32, point.y as f32, point.z as f32], 1.0 / DESCRIPTOR_RADIUS as f32)
    }

    fn new(points: &[Vector3<f64>]) -> Self {
        let mut grid = Self { table: VoxelTable::default(), cells: Vec::new() };
        for (i, point) in points.iter().enumerate() {
            let (cell, new) = grid.table.get_or_insert(key_of(Self::cell(point)));
            if new {
                grid.cells.push(Vec::new());
            }
            grid.cells[cell as usize].push(i as u32);
        }
        grid
    }

    /// Calls `visit` with the points within `radius`, which is no more than a descriptor's, and their distances.
    fn within(
        &self,
        points: &[Vector3<f64>],
        centre: &Vector3<f64>,
        radius: f64,
        mut visit: impl FnMut(usize, f64),
    ) {
        let [x, y, z] = Self::cell(centre);
        for (dx, dy, dz) in
            (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| (x, y, z))))
        {
            let Some(cell) = self.table.get(key_of([x + dx, y + dy, z + dz])) else { continue };
            for &i in &self.cells[cell as usize] {
                let distance = (points[i as usize] - centre).norm();
                if distance <= radius {
                    visit(i as usize, distance);
                }
            }
        }
    }
}

impl Cloud {
    /// Points of a map, metres, and the poses of its keyframes.
    fn new(points: &[[f32; 3]], poses: &[Se3]) -> Self {
        let points: Vec<Vector3<f64>> = points.iter().map(|p| Vector3::from(p.map(f64::from))).collect();
        let grid = Grid::new(&points);
        let normal = |point: &Vector3<f64>| {
            let (mut sum, mut moments, mut count) = (Vector3::zeros(), Matrix3::zeros(), 0.0);
            grid.within(&points, point, NORMAL_RADIUS, |i, _| {
                let p = points[i] - point;
                (sum, moments, count) = (sum + p, moments + p * p.transpose(), count + 1.0);
            });
            if count < 5.0 {
                return Vector3::zeros();
            }
            let (_, axes) = sorted_eigen(moments / count - sum * sum.transpose() / (count * count));
            let normal: Vector3<f64> = axes.column(0).into();
            let seen_from = poses
                .iter()
                .map(|pose| pose.translation - point)
                .reduce(|x, y| if y.norm_squared() < x.norm_squared() { y } else { x });
            if seen_from.is_some_and(|view| view.dot(&normal) < 0.0) { -normal } else { normal }
        };
        let normals = points.par_iter().map(normal).collect();
        Self { points, normals, grid }
    }

    /// Harris' response on normals (Sipiran and Bustos 2011, as the Point Cloud Library has it): the determinant of the
    /// scatter of the normals around; 0 on planes and along edges, 1/27 where three directions meet evenly.
    fn response(&self, point: usize) -> f64 {
        let (mut scatter, mut count) = (Matrix3::zeros(), 0.0);
        self.grid.within(&self.points, &self.points[point], DESCRIPTOR_RADIUS, |i, _| {
            let n = self.normals[i];
            (scatter, count) = (scatter + n * n.transpose(), count + n.norm_squared());
        });
        if count < 5.0 { 0.0 } else { (scatter / count).determinant() }
    }

    /// Key points: those of which no other within [`APART`] has a larger response, the strongest first.
    fn key_points(&self) -> Vec<usize> {
        let responses: Vec<f64> = (0..self.points.len()).into_par_iter().map(|i| self.response(i)).collect();
        let is_strongest = |&i: &usize| {
            let mut strongest = responses[i] > 0.0 && self.normals[i] != Vector3::zeros();
            self.grid.within(&self.points, &self.points[i], APART, |j, _| {
                strongest &= (responses[j], std::cmp::Reverse(j)) <= (responses[i], std::cmp::Reverse(i));
            });
            strongest
        };
        let mut found: Vec<usize> = (0..self.points.len()).filter(is_strongest).collect();
        found.sort_by(|&i, &j| responses[j].total_cmp(&responses[i]).then(i.cmp(&j)));
        found.truncate(KEY_POINTS);
        found
    }

    /// Key points with their descriptors.
    fn described(&self) -> Vec<KeyPoint> {
        let simple: Vec<Descriptor> =
            (0..self.points.len()).into_par_iter().map(|i| self.simple(i)).collect();
        let describe = |i: usize| (self.points[i], self.descriptor(i, &simple));
        self.key_points().into_par_iter().map(describe).collect()
    }

    /// The simplified histogram of a point: how its normal stands to those around (Rusu 2009, Eq. of the Darboux frame).
    fn simple(&self, point: usize) -> Descriptor {
        let mut bins = [0.0f32; 3 * BINS];
        let (p, n) = (self.points[point], self.normals[point]);
        let mut count = 0.0;
        self.grid.within(&self.points, &p, DESCRIPTOR_RADIUS, |i, distance| {
            let (line, other) = (self.points[i] - p, self.normals[i]);
            if distance < 1e-6 || other == Vector3::zeros() {
                return;
            }
            let direction = line / distance;
            let Some(v) = n.cross(&direction).try_normalize(1e-9) else { return };
            let w = n.cross(&v);
            let angles = [
                (v.dot(&other) + 1.0) / 2.0,
                (n.dot(&direction) + 1.0) / 2.0,
                w.dot(&other).atan2(n.dot(&other)) / std::f64::consts::TAU + 0.5,
            ];
            for (k, share) in angles.into_iter().enumerate() {
                bins[k * BINS + ((share * BINS as f64) as usize).min(BINS - 1)] += 1.0;
            }
            count += 1.0;
        });
        bins.map(|bin| bin / f32::max(count, 1.0))
    }

    /// FPFH: the simplified histogram and those around it, weighted by one over their distance; each angle's sums to 1.
    fn descriptor(&self, point: usize, simple: &[Descriptor]) -> Descriptor {
        let mut sum = [0.0f32; 3 * BINS];
        let mut count = 0.0f32;
        self.grid.within(&self.points, &self.points[point], DESCRIPTOR_RADIUS, |i, distance| {
            if i != point && distance > 1e-6 {
                sum.iter_mut().zip(&simple[i]).for_each(|(sum, bin)| *sum += bin / distance as f32);
                count += 1.0;
            }
        });
        let mut bins = simple[point];
        bins.iter_mut().zip(sum).for_each(|(bin, sum)| *bin += sum / count.max(1.0));
        for angle in bins.chunks_exact_mut(BINS) {
            let total: f32 = angle.iter().sum();
            angle.iter_mut().for_each(|bin| *bin /= total.max(1e-6));
        }
        bins
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Random;
    use nalgebra::{UnitQuaternion, Vector6};

    #[test]
    fn a_descriptor_does_not_change_with_the_pose() {
        let point = |i: u64| {
            let mut random = Random::new(i);
            let (u, v) = (6.0 * random.unit(), 6.0 * random.unit());
            match i % 3 {
                0 => Vector3::new(u, v, 0.0),
                1 => Vector3::new(u, 0.0, v),
                _ => Vector3::new(0.0, u, v),
            }
        };
        let cloud = |pose: Se3| {
            let points: Vec<[f32; 3]> =
                (0..600).map(|i| pose * point(i)).map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
            let above = pose * Se3::new(UnitQuaternion::identity(), Vector3::repeat(3.0));
            Cloud::new(&points, &[above]).described()
        };
        let moved = Se3::exp(&Vector6::new(2.0, -1.0, 0.5, 0.1, 0.2, 1.0));
        let (still, turned) = (cloud(Se3::identity()), cloud(moved));
        assert!(still.len() > 5);
        let mut same = 0;
        for (p, descriptor) in &still {
            let twin = turned.iter().find(|(q, _)| (moved * *p - q).norm() < 1e-3);
            let off =
                |other: &Descriptor| descriptor.iter().zip(other).map(|(x, y)| (x - y).abs()).sum::<f32>();
            same += usize::from(twin.is_some_and(|(_, other)| off(other) < 0.15));
        }
        assert!(2 * same > still.len(), "{same} of {}", still.len());
    }
}
