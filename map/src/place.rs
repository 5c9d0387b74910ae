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
///
/// `View` is what of a keyframe the index looks at: its image by default, or what was computed from it once
/// and is used elsewhere too, such as its local features.
pub trait PlaceIndex<View: ?Sized = GrayImage>: Send {
    /// Forgets all keyframes.
    fn clear(&mut self);

    /// Adds a keyframe as seen in `view` (an image: level 0, undistorted), or replaces its view.
    fn add(&mut self, keyframe: KeyframeId, view: &View);

    /// The `count` keyframes most like `view` among those for which `admissible` holds, best first. With it a
    /// map's own recent keyframes, which look alike for the best of reasons, are left out.
    fn query_among(
        &self,
        view: &View,
        count: usize,
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Vec<PlaceCandidate>;

    /// The `count` keyframes most like `view`, best first.
    fn query(&self, view: &View, count: usize) -> Vec<PlaceCandidate> {
        self.query_among(view, count, &|_| true)
    }
}
