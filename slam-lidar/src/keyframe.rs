//! Keyframes: undistorted scans with their poses, what they tell of free space, and submaps of several.

use crate::scan_context::ScanContext;
use crate::surfaces::{SurfaceMap, SurfaceParams};
use crate::voxels::{VoxelTable, first_of_each_voxel};
use geometry::Se3;
use nalgebra::Vector3;

/// A scan that the map keeps.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// The instant to which pose and points belong, seconds on the recording's clock.
    pub instant: f64,
    /// The sensor's pose.
    pub world_from_sensor: Se3,
    /// Undistorted points in the sensor's frame.
    pub points: Vec<[f32; 3]>,
    /// The descriptor of the place.
    pub context: ScanContext,
}

/// Radius of Scan Contexts, metres: half of the paper's 80 m, which are a street's, tells halls apart too.
const CONTEXT_RADIUS: f32 = 40.0;

impl Keyframe {
    /// A keyframe of points freed from the motion of their sweep.
    pub fn new(instant: f64, world_from_sensor: Se3, points: Vec<[f32; 3]>) -> Self {
        let context = context_of(&points);
        Self { instant, world_from_sensor, points, context }
    }
}

/// The descriptor of a keyframe's points.
pub fn context_of(points: &[[f32; 3]]) -> ScanContext {
    ScanContext::of(points, CONTEXT_RADIUS)
}

/// A point moved.
pub(crate) fn transformed(pose: &Se3, p: [f32; 3]) -> [f32; 3] {
    let q = *pose * Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]));
    [q.x as f32, q.y as f32, q.z as f32]
}

/// Columns and rows of a [`Sight`]: a degree each.
const COLUMNS: usize = 360;
const ROWS: usize = 180;

/// Rings lie so many rows apart at most: those of a sensor with 16 are two degrees apart, and a tilted one's less than
/// three.
const RING_SPACING: usize = 3;

/// How far a keyframe saw in every direction: all before is free.
#[derive(Clone, Debug)]
pub struct Sight {
    /// Rows of `sensor_from_submap`.
    rows: [[f32; 4]; 3],
    /// Nearest and farthest return of each cell, metres; infinite and 0 where there is none.
    ranges: Vec<(f32, f32)>,
}

/// What a point is to a keyframe that looks its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// The keyframe does not look there, or something nearer hides it.
    Hidden,
    /// On a surface that the keyframe saw.
    Surface,
    /// Where the keyframe saw through: it cannot be there.
    Free,
}

/// A point counts as on a surface within this distance, metres and share of the range: poses err, cells are wide.
const MARGIN: (f32, f32) = (0.25, 0.02);

impl Sight {
    fn new(points: &[[f32; 3]], sensor_from_submap: Se3) -> Self {
        let mut ranges = vec![(f32::INFINITY, 0.0f32); COLUMNS * ROWS];
        for &p in points {
            let (cell, range) = cell(p);
            let slot = &mut ranges[cell.1 * COLUMNS + cell.0];
            *slot = (slot.0.min(range), slot.1.max(range));
        }
        let (r, t) = (sensor_from_submap.rotation_matrix(), sensor_from_submap.translation);
        let rows = [0, 1, 2].map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]].map(|v| v as f32));
        Self { rows, ranges }
    }

    /// What a point of the submap's frame is to this keyframe.
    pub fn look(&self, point: [f32; 3]) -> Seen {
        let [x, y, z] = point;
        let ((column, row), range) = cell(self.rows.map(|r| r[0] * x + r[1] * y + r[2] * z + r[3]));
        let margin = MARGIN.0 + MARGIN.1 * range;
        let own = self.ranges[row * COLUMNS + column];
        if own.1 == 0.0 {
            return Seen::Hidden;
        }
        // Beside a nearer surface the neighbours decide: a cell may look past an edge.
        let (mut near, mut far) = own;
        for (dx, dy) in [(1, 1), (COLUMNS - 1, 1), (0, 0), (0, 2)] {
            let y = (row + dy).wrapping_sub(1);
            if y < ROWS {
                let other = self.ranges[y * COLUMNS + (column + dx) % COLUMNS];
                (near, far) = (near.min(other.0), far.max(other.1));
            }
        }
        if range >= near - margin {
            return if range <= far + margin { Seen::Surface } else { Seen::Hidden };
        }
        // Between two rings the sensor saw nothing: along the ground a ring meets it metres behind the one below.
        let beyond = |next: f32| range < next - margin;
        let above = (row + 1..ROWS.min(row + 1 + RING_SPACING)).find_map(|y| self.nearest(column, y));
        let below = (row.saturating_sub(RING_SPACING)..row).rev().find_map(|y| self.nearest(column, y));
        let (Some(above), Some(below)) = (above, below) else { return Seen::Hidden };
        if beyond(above) && beyond(below) { Seen::Free } else { Seen::Hidden }
    }

    /// The nearest return of a cell, if it has any.
    fn nearest(&self, column: usize, row: usize) -> Option<f32> {
        let (near, far) = self.ranges[row * COLUMNS + column];
        (far > 0.0).then_some(near)
    }
}

fn cell(p: [f32; 3]) -> ((usize, usize), f32) {
    let flat = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let column = (degrees(p[1], p[0]) + 180.0) as usize;
    let row = (degrees(p[2], flat) + 90.0) as usize;
    ((column.min(COLUMNS - 1), row.min(ROWS - 1)), (flat * flat + p[2] * p[2]).sqrt())
}

/// The angle of `(x, y)` from the x axis, degrees in ±180, as `atan2` gives it but for 1e-5 (Abramowitz and Stegun 4.4.49): a map
/// is looked at a million times in a merge.
pub(crate) fn degrees(y: f32, x: f32) -> f32 {
    const SERIES: [f32; 9] = [
        1.0,
        -0.333_331_45,
        0.199_935_51,
        -0.142_089,
        0.106_562_64,
        -0.075_289_64,
        0.042_909_614,
        -0.016_165_737,
        0.002_866_225_7,
    ];
    let (long, short) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
    let slope = if long > 0.0 { short / long } else { 0.0 };
    let squared = slope * slope;
    let angle = slope * SERIES.iter().rev().fold(0.0, |sum, c| sum * squared + c);
    let angle = if y.abs() > x.abs() { std::f32::consts::FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { std::f32::consts::PI - angle } else { angle };
    angle.copysign(y).to_degrees()
}

/// Some keyframes in a row as one piece, in the frame of the middle one.
#[derive(Clone, Debug)]
pub struct Submap {
    /// Points, thinned.
    pub points: Vec<[f32; 3]>,
    /// Surfaces on small and on large voxels.
    pub fine: SurfaceMap,
    /// The same on voxels four times as large, which reach farther.
    pub coarse: SurfaceMap,
    /// What each keyframe saw.
    pub sights: Vec<Sight>,
}

/// Smallest voxels of a submap's surfaces, metres.
const FINE: f32 = 0.25;
/// Least extent of a submap's planes, as [`SurfaceParams::width`]: half of a voxel. Poses are known here, so that a strip has the
/// slope of its surface, and its normal tells what a tilt does to a floor that few rings saw.
const WIDTH: f32 = 0.15;
/// Grid on which a submap's points are compared, metres.
const COMPARED: f32 = 0.5;

impl Submap {
    /// Joins keyframes by their poses; `origin` is the pose whose frame the submap takes.
    pub fn new<'a>(keyframes: impl Iterator<Item = &'a Keyframe>, origin: &Se3) -> Self {
        let surfaces =
            |voxel| SurfaceMap::new(SurfaceParams { voxel, width: WIDTH, ..SurfaceParams::default() });
        let mut submap = Self {
            points: Vec::new(),
            fine: surfaces(FINE),
            coarse: surfaces(4.0 * FINE),
            sights: Vec::new(),
        };
        let mut all = Vec::new();
        for keyframe in keyframes {
            let submap_from_sensor = origin.inverse() * keyframe.world_from_sensor;
            all.extend(keyframe.points.iter().map(|&p| transformed(&submap_from_sensor, p)));
            submap.sights.push(Sight::new(&keyframe.points, submap_from_sensor.inverse()));
        }
        submap.fine.insert(all.iter().copied());
        submap.coarse.insert(all.iter().copied());
        let mut kept = Vec::new();
        first_of_each_voxel(&all, COMPARED, &mut VoxelTable::default(), &mut kept);
        submap.points = kept.iter().map(|&i| all[i as usize]).collect();
        submap
    }

    /// What a point is to all keyframes: free where any saw through it, else on a surface where any saw one.
    pub fn look(&self, point: [f32; 3]) -> Seen {
        let mut seen = Seen::Hidden;
        for sight in &self.sights {
            match sight.look(point) {
                Seen::Free => return Seen::Free,
                Seen::Surface => seen = Seen::Surface,
                Seen::Hidden => {}
            }
        }
        seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn degrees_are_those_of_atan2(y in -50.0f32..50.0, x in -50.0f32..50.0) {
            prop_assert!((degrees(y, x) - y.atan2(x).to_degrees()).abs() < 1e-4);
            prop_assert!((degrees(0.0, x) - 0.0f32.atan2(x).to_degrees()).abs() < 1e-4);
            prop_assert_eq!(degrees(0.0, 0.0), 0.0);
        }
    }
}
