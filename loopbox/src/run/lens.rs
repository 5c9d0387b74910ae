//! The lens of a recording that came without a calibration, found from the recording itself.

use super::{Progress, RunOptions};
use anyhow::{Result, bail};
use calib::format_camera;
use geometry::{Camera, Crop, Distortion, GrayImage, Pinhole, Undistorter};
use map::Map;
use place_recog::ThumbnailIndex;
use slam_direct::self_calibration::{FreeLens, LensPrior, SelfCalibration, self_calibrate};
use slam_direct::{Agent, Frame, Params, TrackingState};
use sources::correction::{doubled_camera, halved_image, halvings};
use sources::{FoundCalibration, FrameSource, Stop, time};

/// Focal lengths over the image's longer side that are begun with, until one makes a map: those of telephones and webcams
/// (a view of 64°), of wide angles (80°), and of narrow lenses (49°).
const USUAL: [f64; 3] = [0.8, 0.6, 1.1];
/// How far, as a deviation of the logarithm, lenses spread around the usual ones.
const USUAL_SPREAD: f64 = 0.35;
/// The same around a field of view that the user gave.
const GIVEN_SPREAD: f64 = 0.1;
/// The map for it is large enough with so many keyframes,
const ENOUGH_KEYFRAMES: usize = 60;
/// and no more than so many frames are looked at.
const MAX_FRAMES: usize = 900;
/// So many frames without a pose end a map.
const LOST: usize = 15;
/// Maps are made anew with the lens found until it changes by less than this.
const CONVERGED: f64 = 0.005;
const MAX_ROUNDS: usize = 5;
/// A focal length that is known worse than this (a tenth of what the usual lenses differ by) is said to be a guess.
const DETERMINED: f64 = 0.03;

/// A lens found.
#[derive(Clone, Debug)]
pub struct FoundLens {
    /// The lens.
    pub camera: Camera,
    /// Standard deviation of its focal length over the focal length.
    pub focal_deviation: f64,
}

impl FoundLens {
    /// Whether the recording's motion determines the focal length.
    pub fn is_determined(&self) -> bool {
        self.focal_deviation < DETERMINED
    }

    /// What was found, for people.
    pub fn text(&self) -> String {
        let &Pinhole { width, fx, .. } = self.camera.intrinsics();
        let view = 2.0 * (width as f64 / (2.0 * fx)).atan().to_degrees();
        let known = if self.is_determined() {
            format!("known to {:.1} %", 100.0 * self.focal_deviation)
        } else {
            "a guess: the camera's motion does not determine it".into()
        };
        format!(
            "no calibration came with it; found from its images: focal length {fx:.0} px (view of {view:.0}°), {known}"
        )
    }

    /// As a calibration that belongs to the recording.
    pub fn calibration(&self) -> FoundCalibration {
        let origin = if self.is_determined() { "self-calibration" } else { "self-calibration (a guess)" };
        FoundCalibration::Inside { origin: origin.into(), camera: Box::new(self.camera) }
    }

    /// As the text of a `camera.yaml`.
    pub fn file(&self) -> String {
        let deviation = 100.0 * self.focal_deviation;
        format!("# Found from a recording; deviation of the focal length {deviation:.1} %.\n")
            + &format_camera(&self.camera, None)
    }
}

/// Finds the lens of a recording, which `open` opens each time from its first frame; `fov` is its horizontal field of
/// view in degrees, where the user knows that.
///
/// Makes a map of the first part with a guess, the lens from the map, a map with that lens, and so on until it stays.
///
/// # Errors
/// When the recording cannot be read, or no part of it can be mapped with any usual lens.
pub fn find_lens(
    open: &dyn Fn() -> Result<Box<dyn FrameSource>>,
    fov: Option<f64>,
    options: &RunOptions,
    stop: &Stop,
    progress: &dyn Progress,
) -> Result<FoundLens> {
    let mut source = open()?;
    let path = source.info().path.display().to_string();
    let Some(first) = images(source.as_mut()).next() else {
        bail!("{path}: there is no image to find the lens from")
    };
    let whole = (first.1.width(), first.1.height());
    let times = halvings(whole.0, options.camera.max_width);
    let (width, height) = (whole.0 >> times, whole.1 >> times);
    let focals: Vec<f64> = match fov {
        Some(degrees) => vec![0.5 * width as f64 / (0.5 * degrees.to_radians()).tan()],
        None => USUAL.map(|share| share * width.max(height) as f64).into(),
    };
    let prior =
        LensPrior { focal: if fov.is_some() { GIVEN_SPREAD } else { USUAL_SPREAD }, ..LensPrior::default() };
    let mut why = String::new();
    for focal in focals {
        let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        let mut camera =
            Camera::new(Pinhole { width, height, fx: focal, fy: focal, cx, cy }, Distortion::None)?;
        let mut found: Option<FoundLens> = None;
        for round in 0..MAX_ROUNDS {
            progress.stage(&format!("finding the lens, round {}", round + 1));
            let map = map_with(&camera, times, open()?.as_mut(), &options.params, stop)?;
            // Only the first guess is one of which the prior was made.
            let prior = if round == 0 { prior } else { LensPrior { focal: f64::INFINITY, ..prior } };
            let better = match self_calibrate(&map, &camera, FreeLens::All, &prior) {
                Ok(SelfCalibration { camera, focal_deviation, .. }) => FoundLens { camera, focal_deviation },
                Err(error) => {
                    why = error.to_string();
                    break;
                }
            };
            let change = (better.camera.intrinsics().fx / camera.intrinsics().fx).ln().abs();
            camera = better.camera;
            found = Some(better);
            if change < CONVERGED || stop.requested() {
                break;
            }
        }
        if let Some(found) = found {
            return Ok(FoundLens { camera: doubled_camera(&found.camera, whole, times)?, ..found });
        }
    }
    bail!(
        "{path}: no calibration came with this recording, and none was found from it: {why}\nhint: give one with --calib \
         FILE, or its horizontal field of view with --fov DEGREES"
    )
}

/// The images of a source that can be read, with index and time stamp.
fn images(source: &mut dyn FrameSource) -> impl Iterator<Item = (u64, GrayImage, f64)> {
    std::iter::from_fn(move || source.next_frame()).filter_map(|frame| {
        Some((frame.index, frame.picture.into_grey().ok()?, time::on_grid(frame.timestamp)))
    })
}

/// The largest map of the first part of a recording, made with this lens of its images halved so often.
fn map_with(
    lens: &Camera,
    halvings: usize,
    source: &mut dyn FrameSource,
    params: &Params,
    stop: &Stop,
) -> Result<Map> {
    let undistorter = Undistorter::new(lens, Crop::default())?;
    let mut params = params.clone();
    // What contradicts the guess is to stay in the map.
    params.mapping.lens_sigma = 0.0;
    let begin = || Agent::new(*undistorter.pinhole(), Box::new(ThumbnailIndex::default()), params.clone());
    let (mut agent, mut best, mut lost) = (begin()?, None::<Map>, 0);
    let size = |map: &Map| map.keyframes.len();
    let finished = |mut agent: Agent, best: Option<Map>| {
        agent.finish();
        let map = agent.map().clone();
        match best {
            Some(best) if size(&best) >= size(&map) => best,
            _ => map,
        }
    };
    let mut newest = f64::NEG_INFINITY;
    for (index, image, timestamp) in images(source).take(MAX_FRAMES) {
        if timestamp <= newest || stop.requested() {
            continue;
        }
        newest = timestamp;
        let Ok(image) = undistorter.undistort(&halved_image(image, halvings)) else { continue };
        let state = agent.process(Frame { index, timestamp, image })?.state;
        lost = if state == TrackingState::Lost { lost + 1 } else { 0 };
        if size(agent.map()) >= ENOUGH_KEYFRAMES {
            break;
        }
        if lost > LOST {
            best = Some(finished(std::mem::replace(&mut agent, begin()?), best));
            lost = 0;
        }
    }
    Ok(finished(agent, best))
}
