//! Decides whether a camera sees the place at which it was found, or another one that shares things with it.
//!
//! Sometimes no motion leads to a pose: after a loss, at the start of a resumed map, or where two fragments seem to
//! show one place. Such a pose says only that the view resembles a part of the map. It is a claim, like a merge of
//! two maps, and [`JudgePlace`] decides on it from all that the frames show.

use backend::verdict::Answer;
use geometry::Pinhole;
use geometry::sensor::{Sensor, Twist};
use map::Keyframe;

/// An image at its pose.
#[derive(Clone, Debug)]
pub struct PlacedView {
    /// Image, pose and unit in the world of the claim, and depth where it is known; numbered in order of time.
    pub keyframe: Keyframe,
    /// How the camera moved, in the keyframe's unit a second.
    pub motion: Twist,
}

/// Keyframes of a map, and frames that are supposed to show the same place, in one world.
#[derive(Clone, Debug)]
pub struct ClaimedPlace {
    /// The camera of all images.
    pub camera: Pinhole,
    /// The effect of its lens and shutter on the images.
    pub sensor: Sensor,
    /// Keyframes of the map.
    pub keyframes: Vec<PlacedView>,
    /// Frames that are supposed to show the same.
    pub frames: Vec<PlacedView>,
}

/// Decides whether frames show the place of a map.
pub trait JudgePlace: Send + Sync {
    /// The answer; they show one place if it [`joins`](Answer::joins). It must depend on the claim alone, so that
    /// runs repeat.
    fn judge(&self, claim: &ClaimedPlace) -> Answer;
}
