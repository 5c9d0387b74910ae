//! The lens of a recording that came without a calibration, found from the recording itself; `live` does it of a camera, `finding`
//! asks for it where a run needs it.

mod finding;
mod live;
mod searching;

use super::diagnosis::ImageStatistics;
use super::{Progress, RunOptions};
use anyhow::{Result, bail};
use calib::format_camera;
use geometry::sensor::Lens;
use geometry::{Camera, Crop, Distortion, GrayImage, Pinhole, Undistorter};
use map::Map;
use place_recog::ThumbnailIndex;
use searching::Search;
use slam_direct::self_calibration::{
    FreeLens, LensPrior, SelfCalibration, SelfCalibrationError, self_calibrate,
};
use slam_direct::{Agent, Frame, Params, TrackingState};
use sources::correction::{DrawnMask, NARROWEST_VIEW, WIDEST_VIEW, halved_image, halvings};
use sources::pictures::StatedFocal;
use sources::{FoundCalibration, FrameSource, SourceOptions, Stop, time};
use std::path::PathBuf;
use std::sync::Arc;

pub use live::find_live_lens;

/// Focal lengths over the image's longer side that are begun with, until one makes a map: those of telephones and webcams
/// (a view of 64°), of wide angles (80°), and of narrow lenses (49°).
const USUAL: [f64; 3] = [0.8, 0.6, 1.1];
/// How far, as a deviation of the logarithm, lenses spread around the usual ones.
const USUAL_SPREAD: f64 = 0.35;
/// The same around a field of view that the user gave, or that images' metadata state: lengths rounded to millimetres, and
/// videos that are a tenth or so of the view narrower than photographs.
const STATED_SPREAD: f64 = 0.1;
/// The map for it is large enough with so many keyframes,
const ENOUGH_KEYFRAMES: usize = 60;
/// and no more than so many frames are looked at.
const MAX_FRAMES: usize = 900;
/// So many frames without a pose end a map.
const LOST: usize = 15;
/// Maps are made anew with the lens found until its focal length changes by less than it is known to, but at least and at most this:
/// each leaves a fifth of what the one before was off.
const CONVERGED: [f64; 2] = [0.001, 0.005];
const MAX_ROUNDS: usize = 5;
/// What the joint optimisation's one radial term may miss of a distortion that is left to it, over what is expected of calibrations
/// (`mapping.lens_sigma`). Of rectified road cameras it misses a seventh at most, of a Kinect as much as all of that.
const MISSED: f64 = 0.25;
/// Less than this, as a share of the corner's distance from the middle, is undone as it was found: that is about a pixel of 640 × 480,
/// and to leave it out gained nothing.
const LEAST_BEND: f64 = 2e-3;
/// A focal length that is known worse than this (a tenth of what the usual lenses differ by) is said to be a guess.
const DETERMINED: f64 = 0.03;

/// A lens found.
#[derive(Clone, Debug)]
pub struct FoundLens {
    /// The lens.
    pub camera: Camera,
    /// Standard deviation of its focal length over the focal length.
    pub focal_deviation: f64,
    /// What was known of it before, for people.
    pub stated: Option<String>,
}

/// A recording that can be opened again.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Its file or folder.
    pub path: PathBuf,
    /// How it is read.
    pub options: SourceOptions,
}

impl Recording {
    /// The recording from its first frame.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn open(&self) -> Result<Box<dyn FrameSource>> {
        sources::open(&self.path, &self.options)
    }
}

/// The first part of a recording, to be mapped anew with other lenses.
#[derive(Clone)]
pub(super) struct FirstPart {
    pub recording: Recording,
    /// How often its images are halved.
    pub halvings: usize,
    /// What of them is not used.
    pub mask: Option<DrawnMask>,
    pub params: Params,
    pub stop: Stop,
}

impl FirstPart {
    /// Its map with a lens; `looked_at` is told each frame.
    fn map(&self, lens: &Camera, looked_at: &dyn Fn(&Frame)) -> Result<Map> {
        let lens = (lens, self.halvings, self.mask.as_ref());
        map_with(lens, self.recording.open()?.as_mut(), &self.params, &self.stop, looked_at)
    }

    /// Its lens, begun with one that is known to be wrong; nothing where it does not tell.
    pub fn lens_from(&self, wrong: &Camera) -> Option<SelfCalibration> {
        refined(wrong, USUAL_SPREAD, &|lens, _| self.map(lens, &|_| ()), &self.stop).ok()?.ok()
    }
}

/// A focal length to begin with.
struct Guess {
    /// Pixels of the images that are tracked.
    focal: f64,
    /// How far it may be off, as a deviation of the logarithm.
    spread: f64,
    /// Who says so, for people; `None` of usual lenses.
    stated: Option<String>,
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
        let begun = self.stated.as_ref().map_or_else(String::new, |stated| format!(", begun with {stated}"));
        format!(
            "no calibration came with it; found from its images{begun}: focal length {fx:.0} px (view of {view:.0}°), {known}"
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
        let left = match self.camera.distortion() {
            Distortion::None => " Its distortion is none, or so little that each map finds it.",
            _ => "",
        };
        format!("# Found from a recording; deviation of the focal length {deviation:.1} %.{left}\n")
            + &format_camera(&self.camera, None)
    }
}

/// Finds the lens of a recording; `fov` is its horizontal field of view in degrees, where the user knows that.
///
/// Makes a map of the first part with a guess, the lens from the map, a map with that lens, and so on until it stays. The
/// guess is `fov`, else the focal length in the metadata of the images or the video, else a usual one. Where the map knows less of the focal
/// length than was stated, that is kept.
///
/// # Errors
/// When the recording cannot be read, or no part of it can be mapped with any usual lens.
pub fn find_lens(
    recording: &Recording,
    fov: Option<f64>,
    options: &RunOptions,
    stop: &Stop,
    progress: &dyn Progress,
) -> Result<FoundLens> {
    let mut source = recording.open()?;
    let path = source.info().path.display().to_string();
    let mut why = None;
    let pictures = std::iter::from_fn(|| source.next_frame()).map(|frame| frame.picture);
    let Some((first, image)) = pictures
        .filter_map(|picture| match picture.clone().into_grey() {
            Ok(image) => Some((picture, image)),
            Err(reason) => {
                why.get_or_insert(reason);
                None
            }
        })
        .next()
    else {
        bail!("{path}: no image can be read: {}", why.unwrap_or_else(|| "there is none".into()))
    };
    let whole = (image.width(), image.height());
    let times = halvings(whole.0, options.camera.max_width);
    let first_part = FirstPart {
        recording: recording.clone(),
        halvings: times,
        mask: options.camera.drawn_mask(whole)?,
        params: options.params.clone(),
        stop: stop.clone(),
    };
    let map_with = |lens: &Camera, round: usize| {
        progress.stage(&format!("finding the lens, round {}", round + 1));
        first_part.map(lens, &|frame| progress.looked_at(frame))
    };
    let stated = first.stated_focal(whole).or_else(|| source.stated_focal(whole));
    let guesses = guesses(fov, stated, whole, times);
    let search =
        Search { whole, times, params: &options.params, map_with: &map_with, stop, is_repeated: true };
    match search.by(guesses)? {
        Ok(found) => Ok(found),
        Err(why) => {
            let why = match why {
                // It is not the lens that kept a map from being made.
                SelfCalibrationError::TooSmall { keyframes: 0, .. } => why_nothing_was_mapped(recording)?,
                why => why.to_string(),
            };
            bail!(
                "{path}: no calibration came with this recording, and none was found from it: {why}\nhint: give one with --calib \
                 FILE, or its horizontal field of view with --fov DEGREES"
            )
        }
    }
}

/// What about its first images kept a recording from being mapped.
fn why_nothing_was_mapped(recording: &Recording) -> Result<String> {
    let (mut source, mut statistics) = (recording.open()?, ImageStatistics::default());
    images(source.as_mut()).take(MAX_FRAMES).for_each(|(_, image, _)| statistics.add(&image));
    Ok(statistics.why_nothing_was_tracked(None, None))
}

/// A lens, or why a map does not determine it, where the recording can be read.
type Found = Result<Result<SelfCalibration, SelfCalibrationError>>;

/// The lens by maps that are made with the one found before, beginning with `start`, until it stays; `spread` is how far that
/// one's focal length may be off.
fn refined(
    start: &Camera,
    spread: f64,
    map_with: &dyn Fn(&Camera, usize) -> Result<Map>,
    stop: &Stop,
) -> Found {
    let found_with = |lens: &Camera, prior: &LensPrior, round: usize| {
        Ok(self_calibrate(&map_with(lens, round)?, lens, FreeLens::All, prior))
    };
    settled(start, spread, &found_with, stop)
}

/// The same by what is found of a map that is made with a lens, with the number of the round.
fn settled(
    start: &Camera,
    spread: f64,
    found_with: &dyn Fn(&Camera, &LensPrior, usize) -> Found,
    stop: &Stop,
) -> Found {
    let mut found: Option<SelfCalibration> = None;
    for round in 0..MAX_ROUNDS {
        let lens = found.as_ref().map_or(*start, |found| found.camera);
        // Only the first guess is one of which the prior was made.
        let focal = if round == 0 { spread } else { f64::INFINITY };
        let prior = LensPrior { focal, ..LensPrior::default() };
        let better = match (found_with(&lens, &prior, round)?, found) {
            (Ok(better), _) => better,
            (Err(_), Some(found)) => return Ok(Ok(found)),
            (Err(error), None) => return Ok(Err(error)),
        };
        let change = (better.camera.intrinsics().fx / lens.intrinsics().fx).ln().abs();
        if change < better.focal_deviation.clamp(CONVERGED[0], CONVERGED[1]) || stop.requested() {
            return Ok(Ok(better));
        }
        // A lens that does not stay is known no better than by what the last round changed it, and after all of them, where that is much, not
        // at all: it may go on.
        let goes_on = round + 1 == MAX_ROUNDS && change >= DETERMINED;
        let unsettled = if goes_on { f64::INFINITY } else { change };
        found = Some(SelfCalibration { focal_deviation: better.focal_deviation.max(unsettled), ..better });
    }
    Ok(found.ok_or(SelfCalibrationError::Undetermined))
}

/// The lens that was found, without its distortion where that is as little as the joint optimisation expects of a calibration and
/// its one term can say it: all of the recording tells it better than its first part, in which two terms fit what else is off
/// as well, and the images need not be resampled.
fn left_to_the_map(found: &SelfCalibration, params: &Params) -> Result<Camera> {
    let mapping = &params.mapping;
    let is_little = |(lens, missed): (Lens, f64)| {
        (LEAST_BEND..mapping.lens_sigma).contains(&lens.terms[0].abs())
            && missed < MISSED * mapping.lens_sigma
    };
    let is_found_again = found.keyframes >= mapping.calibrate_from;
    if is_found_again && Lens::nearest(&found.camera).is_some_and(is_little) {
        return Ok(Camera::new(*found.camera.intrinsics(), Distortion::None)?);
    }
    Ok(found.camera)
}

/// What to begin with, in this order, for images of `whole` size that are halved so often.
fn guesses(
    fov: Option<f64>,
    stated: Option<StatedFocal>,
    whole: (usize, usize),
    halvings: usize,
) -> impl Iterator<Item = Guess> {
    let (width, height) = (whole.0 >> halvings, whole.1 >> halvings);
    let given = fov.map(|degrees| Guess {
        focal: 0.5 * width as f64 / (0.5 * degrees.to_radians()).tan(),
        spread: STATED_SPREAD,
        stated: Some(format!("a view of {degrees}°")),
    });
    let view = |focal: f64| 2.0 * (0.5 * whole.0 as f64 / focal).atan().to_degrees();
    let in_metadata = || {
        let stated = stated?;
        (NARROWEST_VIEW..WIDEST_VIEW).contains(&view(stated.pixels)).then(|| Guess {
            focal: stated.pixels / (1u64 << halvings) as f64,
            spread: STATED_SPREAD,
            stated: Some(stated.origin),
        })
    };
    let usual = USUAL.map(|share| Guess {
        focal: share * width.max(height) as f64,
        spread: USUAL_SPREAD,
        stated: None,
    });
    let is_given = given.is_some();
    given.or_else(in_metadata).into_iter().chain(usual.into_iter().filter(move |_| !is_given))
}

/// A lens without distortion that looks through the middle of images of this size.
fn centred(focal: f64, (width, height): (usize, usize)) -> Result<Camera> {
    let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    Ok(Camera::new(Pinhole { width, height, fx: focal, fy: focal, cx, cy }, Distortion::None)?)
}

/// The images of a source that can be read, with index and time stamp.
fn images(source: &mut dyn FrameSource) -> impl Iterator<Item = (u64, GrayImage, f64)> {
    std::iter::from_fn(move || source.next_frame()).filter_map(|frame| {
        Some((frame.index, frame.picture.into_grey().ok()?, time::on_grid(frame.timestamp)))
    })
}

/// The largest map of the first part of a recording, made with this lens of its images halved so often, of which those are not
/// used that the mask covers; `looked_at` is told each frame.
fn map_with(
    (lens, halvings, mask): (&Camera, usize, Option<&DrawnMask>),
    source: &mut dyn FrameSource,
    params: &Params,
    stop: &Stop,
    looked_at: &dyn Fn(&Frame),
) -> Result<Map> {
    let undistorter = Undistorter::new(lens, Crop::default())?;
    let mut params = params.clone();
    // What contradicts the guess is to stay in the map.
    params.mapping.lens_sigma = 0.0;
    let unused = mask.map(|mask| mask.undistorted(halvings, &undistorter)).transpose()?.map(Arc::new);
    let begin = || -> Result<Agent> {
        let mut agent =
            Agent::new(*undistorter.pinhole(), Box::new(ThumbnailIndex::default()), params.clone())?;
        unused.iter().try_for_each(|unused| agent.leave_out(Arc::clone(unused)))?;
        Ok(agent)
    };
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
        if stop.requested() {
            break;
        }
        if timestamp <= newest {
            continue;
        }
        newest = timestamp;
        let Ok(image) = undistorter.undistort(&halved_image(image, halvings)) else { continue };
        let frame = Frame { index, timestamp, image, color: None };
        looked_at(&frame);
        let state = agent.process(frame)?.state;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found from rounds that find these focal lengths one after another, each as if it were known to 0.2 %.
    fn found_by(focal: [f64; MAX_ROUNDS]) -> SelfCalibration {
        let lens = |focal: f64| centred(focal, (640, 480)).unwrap();
        let found = |_: &Camera, _: &LensPrior, round: usize| {
            let camera = lens(focal[round]);
            Ok(Ok(SelfCalibration {
                camera,
                focal_deviation: 0.002,
                keyframes: 30,
                observations: 9000,
                residual: 1.0,
            }))
        };
        settled(&lens(512.0), USUAL_SPREAD, &found, &Stop::default()).unwrap().unwrap()
    }

    #[test]
    fn a_lens_that_does_not_stay_is_not_known() {
        let focal = |found: &SelfCalibration| found.camera.intrinsics().fx;
        let stays = found_by([440.0, 424.0, 421.0, 420.2, f64::NAN]);
        assert_eq!((focal(&stays), stays.focal_deviation), (420.2, 0.002));
        // Nearly so: it is known as well as it stays.
        let nearly = found_by([480.0, 450.0, 435.0, 428.0, 424.0]);
        assert!((0.005..DETERMINED).contains(&nearly.focal_deviation), "{}", nearly.focal_deviation);
        let never = found_by([530.0, 550.0, 570.0, 590.0, 615.0]);
        assert!(never.focal_deviation.is_infinite(), "{}", never.focal_deviation);
    }
}
