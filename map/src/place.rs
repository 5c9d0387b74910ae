//! The interface of place recognition: who fills an index and who asks it need not know its method.

use crate::KeyframeId;
use geometry::GrayImage;

/// A keyframe that may show the same place as the query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceCandidate {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// Similarity, higher is more alike; the scale is the index's own.
    pub score: f32,
}

/// An index of keyframes by appearance.
pub trait PlaceIndex: Send {
    /// Forgets all keyframes.
    fn clear(&mut self);

    /// Adds a keyframe's image (level 0, undistorted).
    fn add(&mut self, keyframe: KeyframeId, image: &GrayImage);

    /// The `count` keyframes most like `image`, best first.
    fn query(&self, image: &GrayImage, count: usize) -> Vec<PlaceCandidate>;
}
