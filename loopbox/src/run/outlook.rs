//! What can be said of a recording of images before it is run: what it holds, and which calibration a run would use.

use geometry::{Camera, Distortion, Pinhole};
use serde::Serialize;
use sources::correction::{CameraOptions, correction, described};
use sources::{FoundCalibration, FrameSource, SourceInfo};
use std::fmt;

/// Whether a run over this source uses a calibration that was given or came with it, and does not find the lens from the images; `fov`
/// is the field of view that the user gives, where that is so.
pub fn is_calibrated(source: &SourceInfo, camera: &CameraOptions, fov: Option<f64>) -> bool {
    let comes_along = match &source.calibration {
        _ if fov.is_some() || camera.leave_found => false,
        None | Some(FoundCalibration::Uncalibrated { .. }) => false,
        Some(FoundCalibration::Recorded { files, .. }) => files.camera.is_some(),
        Some(_) => true,
    };
    camera.calibration.is_some() || comes_along
}

/// What of the recording says that its camera is not calibrated.
pub fn uncalibrated(source: &SourceInfo) -> Option<String> {
    match &source.calibration {
        Some(FoundCalibration::Uncalibrated { origin }) => {
            Some(format!("{origin}: it says that the camera is not calibrated (K is zero)"))
        }
        _ => None,
    }
}

/// The numbers of a calibration.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CameraNumbers {
    /// `pinhole`, `radtan`, `kb4` or `fov`.
    model: &'static str,
    /// Pixels of an image.
    width: usize,
    height: usize,
    /// Focal lengths and principal point, pixels.
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

impl CameraNumbers {
    fn of(camera: &Camera) -> Self {
        let &Pinhole { width, height, fx, fy, cx, cy } = camera.intrinsics();
        let model = match camera.distortion() {
            Distortion::None => "pinhole",
            Distortion::RadTan(_) => "radtan",
            Distortion::KannalaBrandt(_) => "kb4",
            Distortion::Fov(_) => "fov",
        };
        Self { model, width, height, fx, fy, cx, cy }
    }
}

/// What can be said of a recording without reading all of it.
#[derive(Debug, Serialize)]
pub struct Outlook {
    /// Where it lies.
    pub path: String,
    /// Its kind, for people.
    pub kind: &'static str,
    /// Frames in it, where that can be told.
    pub frames: Option<u64>,
    /// Seconds from the first to the last, where that can be told.
    pub duration_s: Option<f64>,
    /// Frames a second.
    pub frames_per_s: Option<f64>,
    /// Width and height of the first image, pixels.
    pub size: Option<(usize, usize)>,
    /// Where the calibration comes from that a run uses; `None` where it finds the lens from the images.
    pub calibration: Option<String>,
    /// The numbers of that calibration.
    pub camera: Option<CameraNumbers>,
    /// What a run does about its lens, in words.
    pub lens: String,
    /// What else there is to say of it, as label and text.
    pub facts: Vec<(&'static str, String)>,
    /// What is wrong with it.
    pub problems: Vec<String>,
}

impl Outlook {
    /// What a run over `source` with these options meets; the first image is taken from it.
    pub fn of(source: &mut dyn FrameSource, camera: &CameraOptions, fov: Option<f64>) -> Self {
        let info = source.info().clone();
        let mut problems = Vec::new();
        let size = match source.next_frame().map(|frame| frame.picture.into_grey()) {
            Some(Ok(image)) => Some((image.width(), image.height())),
            Some(Err(reason)) => {
                problems.push(format!("the first image is unreadable: {reason}"));
                None
            }
            None => {
                problems.push("there is no image".to_owned());
                None
            }
        };
        problems.extend(uncalibrated(&info));
        let (mut calibration, mut numbers) = (None, None);
        let lens = if is_calibrated(&info, camera, fov) {
            match correction(camera, &info) {
                Ok(found) => {
                    let own = CameraNumbers::of(found.calibrated());
                    if let Some((width, height)) = size.filter(|size| *size != (own.width, own.height)) {
                        problems.push(format!(
                            "the calibration is for images of {}×{} pixels, these have {width}×{height}",
                            own.width, own.height
                        ));
                    }
                    problems.extend(found.problem());
                    (calibration, numbers) = (Some(found.origin().to_owned()), Some(own));
                    described(found.calibrated())
                }
                Err(error) => {
                    problems.push(format!("{error:#}").replace("\nhint: ", "; "));
                    "a run is refused".into()
                }
            }
        } else {
            let whole = size.unwrap_or_default();
            let stated = source.stated_focal(whole).filter(|_| fov.is_none());
            match (fov, stated) {
                (Some(fov), _) => format!("a run finds it from the images, begun with a view of {fov}°"),
                (None, Some(stated)) => {
                    format!("a run finds it from the images, begun with {}", stated.origin)
                }
                (None, None) => "a run finds it from the images, or takes that of --calib".into(),
            }
        };
        problems.extend(source.problems());
        problems.extend(source.warning());
        let rate =
            info.frame_count.zip(info.duration).filter(|(count, duration)| *count > 1 && *duration > 0.0);
        Self {
            path: info.path.display().to_string(),
            kind: info.kind,
            frames: info.frame_count,
            duration_s: info.duration,
            frames_per_s: rate.map(|(count, duration)| (count - 1) as f64 / duration),
            size,
            calibration,
            camera: numbers,
            lens,
            facts: source.facts(),
            problems,
        }
    }
}

impl fmt::Display for Outlook {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unknown = || "unknown".to_owned();
        let number = |value: Option<f64>, unit| value.map_or_else(unknown, |v| format!("{v:.2} {unit}"));
        writeln!(f, "recording    {}", self.path)?;
        writeln!(f, "kind         {}", self.kind)?;
        writeln!(f, "frames       {}", self.frames.map_or_else(unknown, |n| n.to_string()))?;
        writeln!(f, "duration     {}", number(self.duration_s, "s"))?;
        writeln!(f, "rate         {}", number(self.frames_per_s, "frames/s"))?;
        writeln!(f, "size         {}", self.size.map_or_else(unknown, |(w, h)| format!("{w}×{h}")))?;
        writeln!(
            f,
            "calibration  {}",
            self.calibration.as_deref().unwrap_or("none that can be used came with it")
        )?;
        writeln!(f, "lens         {}", self.lens)?;
        self.facts.iter().try_for_each(|(label, text)| writeln!(f, "{label:<12} {text}"))?;
        self.problems.iter().try_for_each(|problem| writeln!(f, "problem      {problem}"))
    }
}
