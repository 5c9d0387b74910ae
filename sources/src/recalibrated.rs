//! Checks whether all images of a recording have one calibration. Other ones come from a zoom, another mode of the
//! camera, or a recording of two parts.

use crate::camera_topics;
use crate::correction::described;
use crate::pictures::Picture;
use calib::{CameraInfo, Imagery};
use geometry::{Camera, Pinhole};
use nalgebra::Vector2;
use std::sync::Arc;

/// Two calibrations are of different cameras where rays through one pixel are farther apart than this, radians: two pixels of an image 640
/// wide that shows 90°. Calibrations of one lens differ by less from one session to the next, and a focus that follows moves it by less.
const DIFFERENT: f64 = 0.006;

/// The cameras by the calibration messages before and after an image.
pub type Around = [Option<Arc<Camera>>; 2];

/// Follows the calibration messages of a recording beside its images.
#[derive(Debug)]
pub struct Recalibration {
    imagery: Imagery,
    /// What the last message said.
    current: Option<Arc<Camera>>,
    /// The camera that images are expected to be of.
    expected_camera: Option<Camera>,
    first_stamp: Option<f64>,
    /// What is said of images of another camera, and of which.
    reported: Option<(Arc<Camera>, String)>,
}

impl Recalibration {
    /// For the images on the topic `images`.
    pub fn of(images: &str) -> Self {
        let imagery = if camera_topics::is_rectified(images) { Imagery::Rectified } else { Imagery::Raw };
        Self { imagery, current: None, expected_camera: None, first_stamp: None, reported: None }
    }

    /// Sets the camera of the images.
    pub fn expect_camera(&mut self, camera: &Camera) {
        self.expected_camera = Some(*camera);
    }

    /// Reads a calibration message. A message without a calibration changes nothing.
    pub fn see(&mut self, info: anyhow::Result<CameraInfo>) {
        let camera = info.ok().and_then(|info| info.camera(self.imagery, "the message").ok().flatten());
        if let Some(camera) = camera
            && self.current.as_deref() != Some(&camera)
        {
            self.current = Some(Arc::new(camera));
        }
    }

    /// The camera by the messages so far.
    pub fn current(&self) -> Option<Arc<Camera>> {
        self.current.clone()
    }

    /// Checks the picture with this index and stamp, between messages with these cameras, and returns
    /// [`Picture::OfOther`] if another camera took it. A camera's message may lie before or after its image, so a
    /// difference between the two decides nothing.
    pub fn judge(&mut self, picture: Picture, (index, stamp): (u64, f64), around: &Around) -> Picture {
        let first = *self.first_stamp.get_or_insert(stamp);
        let Some(expected) = &self.expected_camera else { return picture };
        let is_other = |camera: &&Arc<Camera>| {
            self.reported.as_ref().is_some_and(|(reported, _)| Arc::ptr_eq(reported, camera))
                || are_different(expected, camera)
        };
        let Some(current) = around.iter().flatten().find(is_other) else { return picture };
        if let Some((camera, text)) = &self.reported
            && Arc::ptr_eq(camera, current)
        {
            return Picture::OfOther(text.clone());
        }
        let after = stamp - first;
        let text = format!(
            "the camera's calibration changes: from frame {index}, {after:.2} s after the first, it is {}, before it was {}; images of \
             another calibration are left out\nhint: run the parts by themselves: up to there with --end {after:.2}, and from there with \
             --start {after:.2} --calib FILE",
            described(current),
            described(expected)
        );
        self.reported = Some((Arc::clone(current), text.clone()));
        Picture::OfOther(text)
    }
}

/// Whether rays through the same pixels of two cameras are apart.
fn are_different(a: &Camera, b: &Camera) -> bool {
    /// As many places across an image, and down.
    const PLACES: usize = 5;
    if a == b {
        return false;
    }
    let &Pinhole { width, height, .. } = a.intrinsics();
    if (width, height) != (b.intrinsics().width, b.intrinsics().height) {
        return true;
    }
    let at = |i: usize, length: usize| i as f64 * (length.max(1) - 1) as f64 / (PLACES - 1) as f64;
    let pixels = (0..PLACES * PLACES).map(|i| Vector2::new(at(i % PLACES, width), at(i / PLACES, height)));
    let angle = |pixel: Vector2<f64>| Some(a.unproject(&pixel)?.angle(&b.unproject(&pixel)?));
    // Where a lens has no ray the other's does not matter.
    pixels.filter_map(angle).any(|angle| angle > DIFFERENT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Distortion, RadTan};

    fn camera(fx: f64, cx: f64, k1: f64) -> Camera {
        let distortion = match k1 {
            0.0 => Distortion::None,
            _ => Distortion::RadTan(RadTan::new(&[k1, 0.0, 0.0, 0.0]).unwrap()),
        };
        Camera::new(Pinhole { width: 640, height: 480, fx, fy: fx, cx, cy: 240.0 }, distortion).unwrap()
    }

    #[test]
    fn another_zoom_mode_or_lens_is_another_camera() {
        let own = camera(500.0, 320.0, 0.0);
        for same in [own, camera(501.0, 320.0, 0.0), camera(500.0, 321.5, 0.0), camera(500.0, 320.0, 0.001)] {
            assert!(!are_different(&own, &same), "{same:?}");
        }
        for other in [camera(520.0, 320.0, 0.0), camera(500.0, 326.0, 0.0), camera(500.0, 320.0, -0.1)] {
            assert!(are_different(&own, &other), "{other:?}");
        }
        let half = Camera::new(
            Pinhole { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 160.0, cy: 120.0 },
            Distortion::None,
        );
        assert!(are_different(&own, &half.unwrap()));
    }
}
