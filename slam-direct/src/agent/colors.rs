//! Colours of frames, from the time they come until it is known whether they become keyframes.

use super::{Agent, LazyColor, State};
use map::Keyframe;

impl Agent {
    /// Keeps the colours of a frame that is to be processed, in place of those of the frame before. Those of the frame that
    /// a start began with stay: it becomes the map's first keyframe.
    pub(super) fn keep_color(&mut self, frame_index: u64, color: Option<&LazyColor>) {
        let starting = match &self.state {
            State::Starting(start) => Some(start.first_frame()),
            _ => None,
        };
        let first = starting.or(self.provisional.as_ref().map(|start| start.first_frame()));
        self.colors.retain(|index, _| Some(*index) == first);
        self.colors.extend(color.map(|color| (frame_index, color.clone())));
    }

    /// Gives new keyframes the colours of their frames. Tracking and mapping have no use for them, so that none of its
    /// results depends on whether there are some.
    pub(super) fn paint(&self, added: &mut [Keyframe]) {
        for keyframe in added.iter_mut().filter(|keyframe| keyframe.color.is_none()) {
            keyframe.color = self.colors.get(&keyframe.frame_index).and_then(LazyColor::get);
        }
    }
}
