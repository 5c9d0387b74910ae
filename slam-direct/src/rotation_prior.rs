//! The rotation of a camera between two frames, by their smallest images: the shift at which they are most similar.
//!
//! It works with blur, and with rotations by a third of the image from one frame to the next, where no patch and no
//! gradient connects the frames (the small blurry images of Klein & Murray, ECCV 2008, §3.3).

use geometry::{GrayImage, Pinhole, Pyramid, Se3};
use nalgebra::{UnitQuaternion, Vector3};

/// Least width of the images that are compared, pixels.
const WIDTH: usize = 40;
/// Share of the image by which it may be shifted.
const REACH: f32 = 0.45;
/// Correlation below which nothing is said.
const MIN_SIMILARITY: f32 = 0.4;

/// A frame as it is remembered, some forty pixels wide.
#[derive(Clone, Debug)]
pub(crate) struct RotationPrior {
    image: GrayImage,
    level: usize,
}

impl RotationPrior {
    /// Of the coarsest level that is wide enough.
    pub fn of(pyramid: &Pyramid) -> Self {
        let wide = |level: &usize| pyramid.level(*level).width() >= WIDTH;
        let level = (0..pyramid.len()).rev().find(wide).unwrap_or(0);
        Self { image: pyramid.level(level).clone(), level }
    }

    /// The turn from this frame to another of the same camera, `other_from_this`; `None` when no shift makes them alike.
    pub fn rotation_to(&self, other: &Pyramid, camera: &Pinhole) -> Option<Se3> {
        let (before, now) = (&self.image, other.level(self.level.min(other.len() - 1)));
        let (width, height) = (before.width(), before.height());
        if (now.width(), now.height()) != (width, height) {
            return None;
        }
        let reach = |size: usize| (REACH * size as f32) as i64;
        let shifts = (-reach(height)..=reach(height))
            .flat_map(|dy| (-reach(width)..=reach(width)).map(move |dx| (dx, dy)));
        let scored = shifts.map(|shift| (similarity(before, now, shift), shift));
        // Of equals the first stays.
        let best = scored.reduce(|a, b| if b.0 > a.0 { b } else { a })?;
        if best.0 < MIN_SIMILARITY {
            return None;
        }
        let camera = camera.at_level(self.level);
        let ahead = Vector3::new(best.1.0 as f64 / camera.fx, best.1.1 as f64 / camera.fy, 1.0);
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &ahead)?;
        Some(Se3::new(rotation, Vector3::zeros()))
    }
}

/// Correlation of the parts of two images that show the same after `now` is shifted back, −1–1.
fn similarity(before: &GrayImage, now: &GrayImage, (dx, dy): (i64, i64)) -> f32 {
    let (width, height) = (before.width() as i64, before.height() as i64);
    let (left, right) = ((-dx).max(0) as usize, (width - dx.max(0)) as usize);
    let (mut n, mut a, mut b, mut aa, mut ab, mut bb) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
    for y in (-dy).max(0)..height - dy.max(0) {
        let row = &before.row(y as usize)[left..right];
        let first = (left as i64 + dx) as usize;
        let other = &now.row((y + dy) as usize)[first..first + row.len()];
        // Whole numbers below 2²⁴ are exact in f32, whatever the order of a row's sums.
        let (mut sa, mut sb, mut saa, mut sab, mut sbb) = (0u32, 0u32, 0u32, 0u32, 0u32);
        for (&p, &q) in row.iter().zip(other) {
            let (p, q) = (u32::from(p), u32::from(q));
            sa += p;
            sb += q;
            saa += p * p;
            sab += p * q;
            sbb += q * q;
        }
        n += row.len() as f32;
        a += sa as f32;
        b += sb as f32;
        aa += saa as f32;
        ab += sab as f32;
        bb += sbb as f32;
    }
    let (va, vb) = (aa - a * a / n, bb - b * b / n);
    // Flat images are like nothing: a variance of one grey level.
    if va < n || vb < n {
        return -1.0;
    }
    (ab - a * b / n) / (va * vb).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{CAMERA, View, pose};

    #[test]
    fn a_quick_rotation_is_found() {
        let before = View::new(pose(0.0, 0.0, 0.0, 0.0, 0.0));
        let prior = RotationPrior::of(&before.pyramid);
        for (yaw, pitch) in [(0.0, 0.0), (0.3, 0.0), (-0.25, 0.1), (0.1, -0.12)] {
            let now = View::new(pose(0.05, 0.0, 0.0, yaw, pitch));
            let truth = (now.world_from_camera.inverse() * before.world_from_camera).rotation;
            let rotation = prior.rotation_to(&now.pyramid, &CAMERA).expect("they overlap").rotation;
            assert!(rotation.angle_to(&truth) < 0.05, "{yaw} {pitch}: {}", rotation.angle_to(&truth));
        }
    }

    #[test]
    fn flat_images_say_nothing() {
        let before = View::new(pose(0.0, 0.0, 0.0, 0.0, 0.0));
        let flat = Pyramid::new(GrayImage::filled(CAMERA.width, CAMERA.height, 7), 5);
        assert_eq!(RotationPrior::of(&before.pyramid).rotation_to(&flat, &CAMERA), None);
        assert_eq!(RotationPrior::of(&flat).rotation_to(&before.pyramid, &CAMERA), None);
    }
}
