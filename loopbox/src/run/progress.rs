//! What a run tells while it goes on.

use super::record::FrameRow;
use slam_direct::Frame;
use sources::ahead::Skip;
use sources::notice::Notice;

/// Is told how a run goes. Every part has a default that says nothing.
pub trait Progress {
    /// A frame was processed; the map has so many keyframes, and so many points were matched.
    fn frame(&self, _row: &FrameRow, _keyframes: usize, _points: usize) {}

    /// A frame is looked at before the run, as to find the lens.
    fn looked_at(&self, _frame: &Frame) {}

    /// A frame was skipped.
    fn skipped(&self, _skip: &Skip) {}

    /// So many frames were dropped late, so many the driver missed.
    fn lost(&self, _dropped: u64, _missed: u64) {}

    /// What a live source says.
    fn notice(&self, _notice: &Notice) {}

    /// Something the user should know, of a kind that may come often.
    fn warn_of(&self, _kind: &str, text: &str) {
        self.warn(text);
    }

    /// The good end of something that was warned of.
    fn note_of(&self, _kind: &str, text: &str) {
        self.note(text);
    }

    /// Something the user should know.
    fn warn(&self, _text: &str) {}

    /// Something good that the user wants to know.
    fn note(&self, _text: &str) {}

    /// The work after the last frame.
    fn stage(&self, _text: &str) {}

    /// One map of the run has ended.
    fn mapped(&self, _record: &super::RunRecord, _folder: &std::path::Path) {}
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {}
