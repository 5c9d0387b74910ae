//! Whether what a camera sees is the place that it was found at, or another one that shares things with it.
//!
//! Where no motion leads to a pose (after a loss, at the begin of going on or localising in a map that was kept, where two
//! fragments seem to meet) the pose says no more than that the view resembles a part of the map. It is a claim, like a merge of
//! two maps, and somebody else decides on it, by all that the frames see ([`JudgePlace`]).

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

/// Keyframes of a map, and frames that are supposed to show the place that these show; in one world.
#[derive(Clone, Debug)]
pub struct ClaimedPlace {
    /// The camera of all images.
    pub camera: Pinhole,
    /// What its lens and shutter do to the images.
    pub sensor: Sensor,
    /// Of the map.
    pub keyframes: Vec<PlacedView>,
    /// What is supposed to show the same.
    pub frames: Vec<PlacedView>,
}

/// Decides whether frames show the place of a map.
pub trait JudgePlace: Send + Sync {
    /// The answer, one place where it [`joins`](Answer::joins), is to depend on the claim alone: runs are to repeat.
    fn judge(&self, claim: &ClaimedPlace) -> Answer;
}
