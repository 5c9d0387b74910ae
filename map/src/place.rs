//! The interface of place recognition. Its users need not know the method.

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
/// `View` is the part of a keyframe that the index uses: its image by default, or what was computed from it once and
/// is used elsewhere too, such as the words of its features.
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

    /// The `count` keyframes most similar to `view` in each of `groups` groups, best first: one query for the places
    /// of several maps in one index. `group` returns the group of a keyframe, from 0 on; keyframes without a group
    /// are left out. The default implementation asks for as many as all groups may have together, so a group may get
    /// fewer than `count`.
    fn query_each(
        &self,
        view: &View,
        count: usize,
        groups: usize,
        group: &dyn Fn(KeyframeId) -> Option<usize>,
    ) -> Vec<PlaceCandidate> {
        let mut taken = vec![0; groups];
        let mut found =
            self.query_among(view, count.saturating_mul(groups), &|keyframe| group(keyframe).is_some());
        found.retain(|candidate| {
            let taken = group(candidate.keyframe).and_then(|group| taken.get_mut(group));
            taken.is_some_and(|taken| {
                *taken += 1;
                *taken <= count
            })
        });
        found
    }

    /// The `count` keyframes most like `view`, best first.
    fn query(&self, view: &View, count: usize) -> Vec<PlaceCandidate> {
        self.query_among(view, count, &|_| true)
    }
}
