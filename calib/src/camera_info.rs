//! The numbers of a ROS `CameraInfo` or a Foxglove `CameraCalibration`, and the camera they make of the images of a topic.
//!
//! Which of them applies follows REP 104 and `image_proc`: K and D belong to images as the sensor took them, P to rectified ones;
//! both are those of the whole sensor, and are moved by the region of interest and divided by the binning
//! (`image_geometry`'s `PinholeCameraModel`). R turns the rectified camera against the one that took the images, which a single
//! camera's pose does not see. A K of zeros is what the message itself calls uncalibrated.

use crate::CalibError;
use crate::formats::{Model, distortion_error};
use geometry::{Camera, Distortion, Pinhole};

/// What a `CameraInfo` says, as it says it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraInfo {
    /// Pixels of the whole sensor.
    pub width: u32,
    /// See `width`.
    pub height: u32,
    /// Name of the distortion's model; may be empty.
    pub model: String,
    /// Terms of the distortion, those that the model does not have filled up with zeros.
    pub d: Vec<f64>,
    /// Camera matrix of the images as taken, 3×3 row by row.
    pub k: Vec<f64>,
    /// Projection of the rectified images, 3×4 row by row; empty or zeros where there is none.
    pub p: Vec<f64>,
    /// How many pixels of the sensor make one of the image, across and down; 0 is 1.
    pub binning: (u32, u32),
    /// The part of the sensor that images show.
    pub roi: Roi,
}

/// A part of the sensor, in its pixels. Without a width it is all of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Roi {
    /// Columns left of it.
    pub x: u32,
    /// Rows above it.
    pub y: u32,
    /// Its columns.
    pub width: u32,
    /// Its rows.
    pub height: u32,
}

/// What was done to images before they came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Imagery {
    /// Nothing: they are as the lens shows them.
    Raw,
    /// They were undistorted.
    Rectified,
}

/// Offset and scale of one axis of an image against the sensor.
#[derive(Clone, Copy)]
struct Axis {
    size: u32,
    offset: u32,
    binning: u32,
}

impl Axis {
    /// The axis of images that show `roi` of the sensor's `whole`.
    fn of(whole: u32, offset: u32, roi: u32, binning: u32) -> Self {
        let (size, offset) = if roi == 0 { (whole, 0) } else { (roi, offset) };
        Self { size, offset, binning: binning.max(1) }
    }

    fn pixels(self) -> usize {
        (self.size / self.binning) as usize
    }

    fn focal(self, whole: f64) -> f64 {
        whole / f64::from(self.binning)
    }

    fn centre(self, whole: f64) -> f64 {
        (whole - f64::from(self.offset)) / f64::from(self.binning)
    }
}

impl CameraInfo {
    /// Whether it says that its camera is not calibrated.
    pub fn is_uncalibrated(&self) -> bool {
        self.k.iter().all(|&number| number == 0.0) && self.p.iter().all(|&number| number == 0.0)
    }

    /// The camera of images of this kind, or `None` where it [is uncalibrated](Self::is_uncalibrated); `name` stands for where
    /// it came from in messages.
    ///
    /// # Errors
    /// When the numbers are no camera.
    pub fn camera(&self, images: Imagery, name: &str) -> Result<Option<Camera>, CalibError> {
        if self.is_uncalibrated() {
            return Ok(None);
        }
        let bad = |key: &str, problem: String, fix: &str| CalibError::BadValue {
            file: name.into(),
            key: key.into(),
            problem,
            fix: fix.into(),
        };
        let has_p = self.p.len() == 12 && self.p[0] != 0.0;
        let (key, [fx, cx, fy, cy]) = match (images, self.k.as_slice()) {
            (Imagery::Rectified, _) if has_p => ("P", [self.p[0], self.p[2], self.p[5], self.p[6]]),
            (_, &[fx, _, cx, _, fy, cy, _, _, _]) => ("K", [fx, cx, fy, cy]),
            (_, other) => {
                let problem = format!("it has {} numbers, not 9", other.len());
                return Err(bad("K", problem, "calibrate again"));
            }
        };
        let across = Axis::of(self.width, self.roi.x, self.roi.width, self.binning.0);
        let down = Axis::of(self.height, self.roi.y, self.roi.height, self.binning.1);
        let pinhole = Pinhole {
            width: across.pixels(),
            height: down.pixels(),
            fx: across.focal(fx),
            fy: down.focal(fy),
            cx: across.centre(cx),
            cy: down.centre(cy),
        };
        let lens = match images {
            Imagery::Rectified => Distortion::None,
            Imagery::Raw => self.lens(name)?,
        };
        let key_of = |number: &str| match number {
            "width" => "width, height".to_owned(),
            number => format!("{key} ({number})"),
        };
        Camera::new(pinhole, lens).map(Some).map_err(|error| CalibError::from_camera(name, key_of, error))
    }

    fn lens(&self, name: &str) -> Result<Distortion, CalibError> {
        if self.d.is_empty() {
            return Ok(Distortion::None);
        }
        let fix = crate::formats::MODEL_FIX;
        let model = Model::of_camera_info(&self.model, &self.d).ok_or_else(|| CalibError::BadValue {
            file: name.into(),
            key: "distortion_model".into(),
            problem: format!("unknown model \"{}\"", self.model),
            fix: fix.into(),
        })?;
        let is_whole = model == Model::RadTan && matches!(self.d.len(), 4 | 5 | 8);
        let lens = if is_whole { model.distortion(&self.d) } else { model.padded_distortion(&self.d) };
        lens.map_err(|error| distortion_error(name, "D", error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a sensor of 1280×960 pixels with a lens that bends.
    fn info() -> CameraInfo {
        CameraInfo {
            width: 1280,
            height: 960,
            model: "plumb_bob".into(),
            d: vec![-0.3, 0.1, 0.001, -0.002, 0.0],
            k: vec![1000.0, 0.0, 640.0, 0.0, 1010.0, 480.0, 0.0, 0.0, 1.0],
            p: vec![900.0, 0.0, 630.0, -90.0, 0.0, 900.0, 470.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..CameraInfo::default()
        }
    }

    fn numbers(info: &CameraInfo, images: Imagery) -> (usize, usize, [f64; 4], bool) {
        let camera = info.camera(images, "info").unwrap().unwrap();
        let Pinhole { width, height, fx, fy, cx, cy } = *camera.intrinsics();
        (width, height, [fx, fy, cx, cy], camera.distortion().is_identity())
    }

    #[test]
    fn images_as_taken_have_k_and_d_and_rectified_ones_p() {
        assert_eq!(numbers(&info(), Imagery::Raw), (1280, 960, [1000.0, 1010.0, 640.0, 480.0], false));
        assert_eq!(numbers(&info(), Imagery::Rectified), (1280, 960, [900.0, 900.0, 630.0, 470.0], true));
        // Drivers whose images are rectified by the sensor leave P out.
        let without = CameraInfo { p: vec![0.0; 12], ..info() };
        assert_eq!(numbers(&without, Imagery::Rectified), (1280, 960, [1000.0, 1010.0, 640.0, 480.0], true));
    }

    #[test]
    fn a_region_is_cut_out_before_pixels_are_binned() {
        let roi = Roi { x: 320, y: 240, width: 640, height: 480 };
        let cut = CameraInfo { roi, ..info() };
        assert_eq!(numbers(&cut, Imagery::Raw), (640, 480, [1000.0, 1010.0, 320.0, 240.0], false));
        let binned = CameraInfo { binning: (2, 2), ..info() };
        assert_eq!(numbers(&binned, Imagery::Raw), (640, 480, [500.0, 505.0, 320.0, 240.0], false));
        let both = CameraInfo { roi, binning: (2, 2), ..info() };
        assert_eq!(numbers(&both, Imagery::Rectified), (320, 240, [450.0, 450.0, 155.0, 115.0], true));
        // Only rows are binned, as sensors that skip lines do.
        let rows = CameraInfo { binning: (1, 2), ..info() };
        assert_eq!(numbers(&rows, Imagery::Raw), (1280, 480, [1000.0, 505.0, 640.0, 240.0], false));
    }

    #[test]
    fn zeros_are_no_calibration() {
        let none = CameraInfo { k: vec![0.0; 9], p: vec![0.0; 12], d: Vec::new(), ..info() };
        assert_eq!(none.camera(Imagery::Raw, "info").unwrap(), None);
        assert_eq!(none.camera(Imagery::Rectified, "info").unwrap(), None);
        let half = CameraInfo { k: vec![0.0; 9], ..info() };
        assert!(half.camera(Imagery::Raw, "info").is_err());
    }

    #[test]
    fn distortions_are_taken_as_files_have_them() {
        let with = |model: &str, d: &[f64]| {
            let info = CameraInfo { model: model.into(), d: d.into(), ..info() };
            info.camera(Imagery::Raw, "topic").map(|camera| *camera.unwrap().distortion())
        };
        let five = with("plumb_bob", &[-0.3, 0.1, 0.001, -0.002, 0.05]).unwrap();
        // Fourteen terms of which the last nine are zero, a model without a name, and both.
        let padded = [&[-0.3, 0.1, 0.001, -0.002, 0.05][..], &[0.0; 9]].concat();
        for (model, d) in
            [("plumb_bob", &padded[..]), ("", &padded[..5]), ("", &padded[..]), ("radtan", &padded)]
        {
            assert_eq!(with(model, d).unwrap(), five, "{model} {}", d.len());
        }
        let fisheye = with("equidistant", &[0.1, 0.01, 0.0, 0.0]).unwrap();
        assert_eq!(with("fisheye", &[0.1, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap(), fisheye);
        for (model, d) in
            [("", &[0.0; 5][..]), ("plumb_bob", &[]), ("none", &[0.0; 8]), ("rational_polynomial", &[0.0; 8])]
        {
            assert!(with(model, d).unwrap().is_identity(), "{model} {}", d.len());
        }
        let thin = [&[-0.3, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0][..], &[0.02, 0.0, 0.0, 0.0]].concat();
        assert!(with("plumb_bob", &thin).unwrap_err().to_string().starts_with("topic: `D`"));
        assert!(with("mei", &[0.1; 4]).unwrap_err().to_string().contains("unknown model \"mei\""));
    }
}
