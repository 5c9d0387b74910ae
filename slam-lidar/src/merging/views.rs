//! What each keyframe of a map saw, ray by ray, so that it can be asked whether it saw a piece of surface or looked through it.
//!
//! A ray says nothing but that all before its return is free and that something is there. Where it crosses the plane of a piece
//! of surface, within its extent, its return lies before the plane (something hides it), on it, or beyond it. How far beyond is
//! taken along the normal: a ray that grazes a floor ends metres farther and still on it. Nothing is interpolated between
//! rays, so no margin is needed for their spacing, and none grows with the range.

use super::surfel::Surfel;
use geometry::Se3;
use nalgebra::Vector3;

/// Columns and rows of the bins of directions: a degree each.
const COLUMNS: usize = 360;
const ROWS: usize = 180;
/// Bins on either side of a direction that are looked through, at most: pieces nearer than that fill more are seen in part.
const MOST_BINS: f32 = 4.0;
/// Sine of the angle between a ray and a plane from which on where they cross is known.
const GRAZING: f32 = 0.1;
/// A piece reaches so many standard deviations of its points from their middle: 1.73 fills an even one, less leaves its rim out,
/// where rays pass beside it.
const EXTENT: f32 = 1.4;

/// The rays of a keyframe, sorted by their direction.
#[derive(Clone, Debug)]
pub struct View {
    /// Rows of `sensor_from_map`.
    rows: [[f32; 4]; 3],
    /// First ray of each bin, and the end.
    first: Vec<u32>,
    /// Returns in the sensor's frame, metres, bin by bin.
    returns: Vec<[f32; 3]>,
    /// Largest range of each bin, metres; 0 where there is no ray.
    farthest: Vec<f32>,
}

/// Rays that cross a piece of surface: those that return from it, and those that pass through it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crossings {
    /// Rays that return from it.
    pub hits: u32,
    /// Rays that return from beyond it.
    pub passes: u32,
}

impl View {
    /// Of a keyframe's points, by its pose in the map.
    pub fn new(points: &[[f32; 3]], sensor_from_map: &Se3) -> Self {
        let bins: Vec<u32> = points.iter().map(|&p| bin(p) as u32).collect();
        let mut first = vec![0u32; COLUMNS * ROWS + 1];
        bins.iter().for_each(|&bin| first[bin as usize + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let (mut next, mut returns) = (first.clone(), vec![[0.0; 3]; points.len()]);
        let mut farthest = vec![0.0f32; COLUMNS * ROWS];
        for (&p, &bin) in points.iter().zip(&bins) {
            let bin = bin as usize;
            returns[next[bin] as usize] = p;
            next[bin] += 1;
            farthest[bin] = farthest[bin].max(length(p));
        }
        Self { rows: rows_of(sensor_from_map), first, returns, farthest }
    }

    /// The rays that cross a piece of surface, which lies in the map's frame: on it are those that end within `deviations` standard
    /// deviations of it; `pose` is what the map's pose errs by, standard deviation in metres.
    pub fn cross(&self, surfel: &Surfel, pose: f32, deviations: f32) -> Crossings {
        let mut crossings = Crossings::default();
        let thickness = surfel.deviations[if surfel.is_flat { 0 } else { 2 }];
        let margin = deviations * (thickness * thickness + pose * pose).sqrt();
        self.each_crossing(surfel, margin, |beyond| {
            crossings.passes += u32::from(beyond > margin);
            crossings.hits += u32::from(beyond.abs() <= margin);
        });
        crossings
    }

    /// Calls `visit` with how far beyond a piece of surface each ray ends that crosses it or would, metres along its normal; of rays
    /// that end more than `margin` metres before it, some are left out.
    pub fn each_crossing(&self, surfel: &Surfel, margin: f32, mut visit: impl FnMut(f32)) {
        let middle = self.rows.map(|r| dot([r[0], r[1], r[2]], surfel.middle) + r[3]);
        let range = length(middle);
        let flat = (middle[0] * middle[0] + middle[1] * middle[1]).sqrt();
        let reach = EXTENT * surfel.deviations[2];
        if range < 2.0 * reach || flat < reach {
            return;
        }
        let (degrees, (column, row)) = ((reach / range).to_degrees(), place(middle));
        let (wide, high) = ((degrees * range / flat).min(MOST_BINS), degrees.min(MOST_BINS));
        let rows = (row - high).max(0.0) as usize..=((row + high) as usize).min(ROWS - 1);
        let (left, right) = ((column - wide).floor() as i32, (column + wide).floor() as i32);
        let least = range - reach - margin;
        let mut plane = None;
        for (y, x) in rows.flat_map(|y| (left..=right).map(move |x| (y, x))) {
            let bin = y * COLUMNS + x.rem_euclid(COLUMNS as i32) as usize;
            if self.farthest[bin] < least {
                continue;
            }
            let Plane { normal, offset, sides } = *plane.get_or_insert_with(|| self.plane(surfel, middle));
            if offset.abs() < GRAZING * range {
                return;
            }
            for &end in &self.returns[self.first[bin] as usize..self.first[bin + 1] as usize] {
                // The ray is at `share` of its way when it meets the plane.
                let along = dot(normal, end);
                if along * offset <= 0.0 || along.abs() < GRAZING * length(end) {
                    continue;
                }
                let away = [0, 1, 2].map(|i| offset / along * end[i] - middle[i]);
                let outside = sides.iter().map(|side| dot(*side, away).powi(2)).sum::<f32>();
                if outside <= EXTENT * EXTENT {
                    visit(along.abs() - offset.abs());
                }
            }
        }
    }

    /// The plane of a piece of surface in the sensor's frame. What is not flat is asked on the plane across the line of sight, as wide as its middle axis.
    fn plane(&self, surfel: &Surfel, middle: [f32; 3]) -> Plane {
        let turned = |axis: [f32; 3]| self.rows.map(|r| dot([r[0], r[1], r[2]], axis));
        let side = |axis: [f32; 3], deviation: f32| axis.map(|v| v / deviation.max(THIN));
        let [_, middling, widest] = surfel.deviations;
        if surfel.is_flat {
            let [normal, one, other] = surfel.axes.map(turned);
            return Plane {
                normal,
                offset: dot(normal, middle),
                sides: [side(one, middling), side(other, widest)],
            };
        }
        let (range, flat) = (length(middle), (middle[0] * middle[0] + middle[1] * middle[1]).sqrt());
        let normal = middle.map(|v| v / range);
        let level = [-middle[1] / flat, middle[0] / flat, 0.0];
        let up: [f32; 3] = Vector3::from(normal).cross(&Vector3::from(level)).into();
        Plane { normal, offset: range, sides: [side(level, middling), side(up, middling)] }
    }
}

/// A plane with the two directions in it, over the standard deviations along them.
#[derive(Clone, Copy)]
struct Plane {
    normal: [f32; 3],
    offset: f32,
    sides: [[f32; 3]; 2],
}

/// Least standard deviation across a piece of surface, metres: a line of points has some width.
const THIN: f32 = 0.02;

fn rows_of(pose: &Se3) -> [[f32; 4]; 3] {
    let (r, t) = (pose.rotation_matrix(), pose.translation);
    [0, 1, 2].map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]].map(|v| v as f32))
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(p: [f32; 3]) -> f32 {
    dot(p, p).sqrt()
}

/// Column and row of a direction, with fractions.
fn place(p: [f32; 3]) -> (f32, f32) {
    let flat = (p[0] * p[0] + p[1] * p[1]).sqrt();
    (crate::keyframe::degrees(p[1], p[0]) + 180.0, crate::keyframe::degrees(p[2], flat) + 90.0)
}

fn bin(p: [f32; 3]) -> usize {
    let (column, row) = place(p);
    (row as usize).min(ROWS - 1) * COLUMNS + (column as usize).min(COLUMNS - 1)
}
