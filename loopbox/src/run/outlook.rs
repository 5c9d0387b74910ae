//! What can be said of a recording of images before it is run: what it holds, and which calibration a run would use.

use super::frame_survey::FrameSurvey;
use geometry::{Camera, Distortion, Pinhole};
use serde::Serialize;
use sources::correction::{CameraOptions, correction, described};
use sources::pictures::StatedFocal;
use sources::{FoundCalibration, FrameSource, SourceInfo, sidecar_calibrations};
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
    /// Why a run over it is refused; `None` where it is not.
    pub refused: Option<String>,
}

/// What a run does about the lens.
#[derive(Default)]
struct LensOutlook {
    calibration: Option<String>,
    numbers: Option<CameraNumbers>,
    text: String,
    problems: Vec<String>,
    refused: Option<String>,
}

impl Outlook {
    /// What a run over `source` with these options meets; frames are taken from it, all of them where they need not be decoded for that.
    pub fn of(source: &mut dyn FrameSource, camera: &CameraOptions, fov: Option<f64>) -> Self {
        let info = source.info().clone();
        let is_calibrated = is_calibrated(&info, camera, fov);
        if is_calibrated {
            expect_found_camera(source, camera);
        }
        let seen = FrameSurvey::of(source);
        let mut problems: Vec<String> = seen.problem().into_iter().chain(uncalibrated(&info)).collect();
        let stated = || source.stated_focal(seen.size.unwrap_or_default());
        let lens = match is_calibrated {
            true => of_calibration(&info, camera, seen.size),
            false => of_none(&info, fov, stated),
        };
        problems.extend(lens.problems);
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
            size: seen.size,
            calibration: lens.calibration,
            camera: lens.numbers,
            lens: lens.text,
            facts: source.facts().into_iter().chain(seen.facts()).collect(),
            problems,
            refused: seen.refused().or(lens.refused),
        }
    }
}

/// Holds the images of a source to the calibration that came with it, where that is the one that is used.
pub(super) fn expect_found_camera(source: &mut dyn FrameSource, camera: &CameraOptions) {
    let found = source.info().calibration.clone();
    if let (None, Some(FoundCalibration::Inside { camera, .. })) = (&camera.calibration, found) {
        source.expect_camera(&camera);
    }
}

/// What a run makes of a calibration that it is given or that came along, for images of this size.
fn of_calibration(info: &SourceInfo, camera: &CameraOptions, size: Option<(usize, usize)>) -> LensOutlook {
    let found = match correction(camera, info) {
        Ok(found) => found,
        Err(error) => {
            let refused = Some(format!("{error:#}"));
            return LensOutlook { text: "a run is refused".into(), refused, ..LensOutlook::default() };
        }
    };
    let own = CameraNumbers::of(found.calibrated());
    let refused = size.filter(|size| *size != (own.width, own.height)).map(|(width, height)| {
        format!(
            "the calibration is for images of {}×{} pixels, these have {width}×{height}\nhint: --scale-calib scales it where they show \
             the same, --calib FILE takes another, and --calib none finds the lens from the images",
            own.width, own.height
        )
    });
    LensOutlook {
        calibration: Some(found.origin().to_owned()),
        numbers: Some(own),
        text: described(found.calibrated()),
        problems: found.problem().into_iter().collect(),
        refused,
    }
}

/// What a run does that has no calibration.
fn of_none(info: &SourceInfo, fov: Option<f64>, stated: impl Fn() -> Option<StatedFocal>) -> LensOutlook {
    let text = match (fov, fov.is_none().then(stated).flatten()) {
        (Some(fov), _) => format!("a run finds it from the images, begun with a view of {fov}°"),
        (None, Some(stated)) => format!("a run finds it from the images, begun with {}", stated.origin),
        (None, None) => "a run finds it from the images, or takes that of --calib".into(),
    };
    let sidecars = sidecar_calibrations(info).into_iter().map(|text| text.replace("\nhint: ", "; "));
    LensOutlook { text, problems: sidecars.collect(), ..LensOutlook::default() }
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
