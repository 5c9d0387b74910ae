//! Whether the lens that was given is the one of the images, asked of the map on the way.

use super::Progress;
use super::lens::FirstPart;
use geometry::Camera;
use map::Map;
use slam_direct::self_calibration::{SelfCalibration, other_focal_length};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// The map is asked when it has so many keyframes, and again at four times as many, ...
const KEYFRAMES: usize = 30;
/// ... up to so many: what these do not tell, more do not either.
const ENOUGH: usize = 480;
/// Focal lengths that are off by less do no harm that anybody sees: the scale of depth against width is off by as much.
const HARMLESS: f64 = 0.06;
/// By so many deviations the map must contradict the calibration.
const SIGNIFICANT: f64 = 4.0;

/// A lens that was given.
#[derive(Clone)]
pub struct GivenLens {
    /// By which images were undistorted,
    pub lens: Camera,
    /// which were halved so often before.
    pub halvings: usize,
    /// What is mapped anew where it is wrong; nothing of a camera.
    pub first_part: Option<FirstPart>,
}

/// Asks the map in a thread beside the run.
pub struct LensCheck {
    given: GivenLens,
    next: usize,
    thread: Option<(JoinHandle<()>, Receiver<String>)>,
}

impl LensCheck {
    /// Of images that were undistorted by this lens.
    pub fn new(given: GivenLens) -> Self {
        Self { given, next: KEYFRAMES, thread: None }
    }

    /// Whether the map, of so many keyframes, is to be asked now.
    pub fn is_due(&self, keyframes: usize) -> bool {
        keyframes >= self.next && self.next <= ENOUGH && self.thread.is_none()
    }

    /// Whether the last map, of so many keyframes, is to be asked: a short recording has said all it will say, and of one with losses
    /// twice as much as was asked before may say why.
    pub fn is_due_at_the_end(&self, keyframes: usize, has_losses: bool) -> bool {
        self.next == KEYFRAMES || has_losses && self.next <= 2 * keyframes
    }

    /// Begins to ask the map.
    pub fn ask(&mut self, map: Map) {
        self.next *= 4;
        let (given, (sender, texts)) = (self.given.clone(), channel());
        let work = move || what_is_wrong(&map, &given, &sender);
        let thread = std::thread::Builder::new().name("lens".into()).spawn(work);
        self.thread = thread.ok().map(|thread| (thread, texts));
    }

    /// Reports what came of it, as it is known; `wait` waits for that.
    pub fn report(&mut self, progress: &dyn Progress, wait: bool) {
        let Some((thread, texts)) = &self.thread else { return };
        let has_ended = thread.is_finished();
        let mut warn = |text: String| {
            progress.warn(&text);
            // Said once, it is said.
            self.next = usize::MAX;
        };
        texts.try_iter().for_each(&mut warn);
        if wait && !has_ended {
            progress.stage("looking whether the calibration is the camera's");
            texts.iter().for_each(&mut warn);
        }
        if wait || has_ended {
            // It reported all that it has.
            self.thread = None;
        }
    }
}

/// What the map says against its lens; and since a map made with a wrong one has lost the observations that contradict it most, what
/// the first part of the recording says, mapped anew until the lens stays.
fn what_is_wrong(map: &Map, given: &GivenLens, sender: &Sender<String>) {
    let Ok(Some(by_map)) = other_focal_length(map, &given.lens, HARMLESS) else { return };
    // Nobody listens any more where the run has ended.
    let warn = |found: &SelfCalibration, at_least: &str| {
        let _ = sender.send(format!(
            "{}\nhint: is the calibration this camera's, at this size and zoom? `loopbox calib` makes one; a recording without any is \
             calibrated from itself",
            describe_error(found, given, at_least)
        ));
    };
    let is_sure = is_wrong(&by_map, &given.lens);
    if is_sure {
        warn(&by_map, "or more ");
    }
    let anew = given.first_part.as_ref().and_then(|part| part.lens_from(&by_map.camera));
    match anew.filter(|anew| is_wrong(anew, &given.lens)) {
        Some(anew) if is_sure => {
            let _ =
                sender.send(format!("mapped anew with other lenses, {}", describe_error(&anew, given, "")));
        }
        Some(anew) => warn(&anew, ""),
        None => {}
    }
}

/// Whether what was found contradicts the lens that was given.
fn is_wrong(found: &SelfCalibration, lens: &Camera) -> bool {
    ratio(found, lens).ln().abs() >= f64::max(HARMLESS, SIGNIFICANT * found.focal_deviation)
}

/// The focal length that was given over the one that was found.
fn ratio(found: &SelfCalibration, lens: &Camera) -> f64 {
    lens.intrinsics().fx / found.camera.intrinsics().fx
}

/// By how much the focal length is off, for people.
fn describe_error(found: &SelfCalibration, given: &GivenLens, at_least: &str) -> String {
    let ratio = ratio(found, &given.lens);
    let (percent, how) = match ratio {
        1.0.. => (100.0 * (ratio - 1.0), "long"),
        _ => (100.0 * (1.0 - ratio), "short"),
    };
    let whole = (1u64 << given.halvings) as f64;
    format!(
        "the focal length looks {percent:.0} % too {how} {at_least}(± {:.0} %): fx = {:.0} was given, the images say {:.0}",
        (200.0 * found.focal_deviation).max(1.0),
        whole * given.lens.intrinsics().fx,
        whole * found.camera.intrinsics().fx
    )
}
