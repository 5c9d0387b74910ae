//! Matches and their truth.

use crate::pairs::View;
use features::{Features, squared_distance};
use geometry::hat;
use nalgebra::{Matrix3, Vector2, Vector3};
use std::fmt;

/// Largest distance of a true match from its epipolar line, pixels.
const EPIPOLAR: f64 = 3.0;

/// Largest distance of a true match from its true place, pixels.
const PLACE: f64 = 3.0;

/// What matched, of all pairs.
#[derive(Default)]
pub struct Tally {
    pairs: usize,
    matches: usize,
    epipolar: usize,
    with_depth: usize,
    in_place: usize,
    /// Distances from the true place of those in place, pixels, x and y.
    offsets: Vec<Vector2<f64>>,
    visible: usize,
    repeated: usize,
    thin: usize,
}

impl Tally {
    pub fn add(&mut self, max_ratio: f64, source: (&View, &Features), target: (&View, &Features)) {
        self.pairs += 1;
        let essential = essential(source.0, target.0);
        let mut epipolar = 0;
        for (a, b) in matches(max_ratio, source.1, target.1) {
            let (a, b) = (source.1.keypoints[a].pixel, target.1.keypoints[b].pixel);
            self.matches += 1;
            epipolar += usize::from(sampson(&essential, (source.0, a), (target.0, b)) < EPIPOLAR);
            if let Some(place) = source.0.point(a).and_then(|point| target.0.pixel(&point)) {
                let offset = vector(b) - place;
                self.with_depth += 1;
                if offset.norm() < PLACE {
                    self.in_place += 1;
                    self.offsets.push(offset);
                }
            }
        }
        self.epipolar += epipolar;
        // Too few to tell a pose by.
        self.thin += usize::from(epipolar < 20);
        for keypoint in &source.1.keypoints {
            let Some(place) = source.0.point(keypoint.pixel).and_then(|point| target.0.pixel(&point)) else {
                continue;
            };
            self.visible += 1;
            let near = target.1.keypoints.iter().any(|other| {
                let ratio = other.size / keypoint.size;
                (vector(other.pixel) - place).norm() < 2.0 && ratio < 1.414 && ratio > 0.707
            });
            self.repeated += usize::from(near);
        }
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let pairs = self.pairs.max(1);
        let percent = |a: usize, b: usize| 100.0 * a as f64 / b.max(1) as f64;
        let (matches, epipolar) = (self.matches / pairs, self.epipolar as f64 / pairs as f64);
        let share = percent(self.epipolar, self.matches);
        write!(
            f,
            "{matches:5} matches, epipolar {epipolar:6.1} ({share:4.1} %), {:2} pairs < 20",
            self.thin
        )?;
        if self.with_depth > 0 {
            let in_place = self.in_place as f64 / pairs as f64;
            let share = percent(self.in_place, self.with_depth);
            let repeated = percent(self.repeated, self.visible);
            let mut lengths: Vec<f64> = self.offsets.iter().map(|o| o.norm()).collect();
            lengths.sort_by(f64::total_cmp);
            let mean = self.offsets.iter().sum::<Vector2<f64>>() / self.offsets.len().max(1) as f64;
            let median = lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
            write!(
                f,
                "; in place {in_place:6.1} ({share:4.1} %), off {median:.2} px, mean ({:.2}, {:.2})",
                mean.x, mean.y
            )?;
            write!(f, "; repeated {repeated:4.1} %")?;
        }
        Ok(())
    }
}

fn vector(pixel: [f32; 2]) -> Vector2<f64> {
    Vector2::new(f64::from(pixel[0]), f64::from(pixel[1]))
}

/// Indices of features that are each other's nearest and pass the ratio test on both sides.
fn matches(max_ratio: f64, source: &Features, target: &Features) -> Vec<(usize, usize)> {
    const NONE: (usize, u32, u32) = (0, u32::MAX, u32::MAX);
    let mut of_source = vec![NONE; source.len()];
    let mut of_target = vec![NONE; target.len()];
    let consider = |nearest: &mut (usize, u32, u32), index: usize, distance: u32| {
        if distance < nearest.1 {
            *nearest = (index, distance, nearest.1);
        } else if distance < nearest.2 {
            nearest.2 = distance;
        }
    };
    for (i, a) in source.descriptors.iter().enumerate() {
        for (j, b) in target.descriptors.iter().enumerate() {
            let distance = squared_distance(a, b);
            consider(&mut of_source[i], j, distance);
            consider(&mut of_target[j], i, distance);
        }
    }
    let distinct =
        |n: &(usize, u32, u32)| f64::from(n.1) <= max_ratio * max_ratio * f64::from(n.2) && n.1 < n.2;
    let both = |(i, near): (usize, &(usize, u32, u32))| {
        let back = of_target.get(near.0)?;
        (back.0 == i && distinct(near) && distinct(back)).then_some((i, near.0))
    };
    of_source.iter().enumerate().filter_map(both).collect()
}

/// The matrix E of `bᵀ E a = 0` for the rays a of the source and b of the target.
fn essential(source: &View, target: &View) -> Matrix3<f64> {
    let target_from_source = target.world_from_camera.inverse() * source.world_from_camera;
    hat(&target_from_source.translation) * target_from_source.rotation_matrix()
}

/// The distance of a match from the epipolar geometry to first order (Sampson 1982), in pixels of the source.
fn sampson(essential: &Matrix3<f64>, a: (&View, [f32; 2]), b: (&View, [f32; 2])) -> f64 {
    let ray = |(view, pixel): (&View, [f32; 2])| -> Option<Vector3<f64>> {
        let ray = view.camera.unproject(&vector(pixel))?;
        Some(ray / ray.z)
    };
    let (Some(x), Some(y)) = (ray(a), ray(b)) else { return f64::INFINITY };
    let (line, back) = (essential * x, essential.transpose() * y);
    let squares = line.xy().norm_squared() + back.xy().norm_squared();
    y.dot(&line).abs() / squares.sqrt() * a.0.camera.intrinsics().fx * std::f64::consts::SQRT_2
}
