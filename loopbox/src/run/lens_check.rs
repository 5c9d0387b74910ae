//! Whether the lens that was given is the one of the images, asked of the map on the way.

use super::Progress;
use geometry::Camera;
use map::Map;
use slam_direct::self_calibration::{SelfCalibration, other_focal_length};
use std::thread::JoinHandle;

/// The map is asked when it has so many keyframes, and again at four times as many, ...
const KEYFRAMES: usize = 30;
/// ... up to so many: what these do not tell, more do not either.
const ENOUGH: usize = 480;
/// Focal lengths that are off by less do no harm that anybody sees: the scale of depth against width is off by as much.
const HARMLESS: f64 = 0.06;
/// By so many deviations the map must contradict the calibration.
const SIGNIFICANT: f64 = 4.0;

/// Asks the map in a thread beside the run.
pub struct LensCheck {
    lens: Camera,
    /// How often images were halved before.
    halvings: usize,
    next: usize,
    thread: Option<JoinHandle<Option<String>>>,
}

impl LensCheck {
    /// Of images that were halved so often and then undistorted by this lens.
    pub fn new(lens: Camera, halvings: usize) -> Self {
        Self { lens, halvings, next: KEYFRAMES, thread: None }
    }

    /// Whether the map, of so many keyframes, is to be asked now.
    pub fn is_due(&self, keyframes: usize) -> bool {
        keyframes >= self.next && self.next <= ENOUGH && self.thread.is_none()
    }

    /// Whether no map was asked yet.
    pub fn is_open(&self) -> bool {
        self.next == KEYFRAMES
    }

    /// Begins to ask the map.
    pub fn ask(&mut self, map: Map) {
        self.next *= 4;
        let (lens, halvings) = (self.lens, self.halvings);
        let work = move || what_is_wrong(&map, &lens, halvings);
        self.thread = std::thread::Builder::new().name("lens".into()).spawn(work).ok();
    }

    /// Tells what came of it, once it is known; `wait` waits for that.
    pub fn tell(&mut self, progress: &dyn Progress, wait: bool) {
        if self.thread.as_ref().is_some_and(|thread| wait || thread.is_finished())
            && let Some(Ok(Some(text))) = self.thread.take().map(JoinHandle::join)
        {
            progress.warn(&text);
            // Said once, it is said.
            self.next = usize::MAX;
        }
    }
}

/// What the map says against its lens.
fn what_is_wrong(map: &Map, lens: &Camera, halvings: usize) -> Option<String> {
    let SelfCalibration { camera, focal_deviation, .. } = other_focal_length(map, lens, HARMLESS).ok()??;
    let ratio = lens.intrinsics().fx / camera.intrinsics().fx;
    if ratio.ln().abs() < SIGNIFICANT * focal_deviation {
        return None;
    }
    let (percent, how) = match ratio {
        1.0.. => (100.0 * (ratio - 1.0), "long"),
        _ => (100.0 * (1.0 - ratio), "short"),
    };
    let whole = (1u64 << halvings) as f64;
    Some(format!(
        "the focal length looks {percent:.0} % too {how} or more (± {:.0} %): fx = {:.0} was given, the images say {:.0}\nhint: is \
         the calibration this camera's, at this size and zoom? `loopbox calib` makes one; a recording without any is \
         calibrated from itself",
        (200.0 * focal_deviation).max(1.0),
        whole * lens.intrinsics().fx,
        whole * camera.intrinsics().fx
    ))
}
