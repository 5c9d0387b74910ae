//! Watching a calibration, in a program built without it: the same calls, which do nothing.

use super::collect::Seen;
use crate::runtime::Stop;

/// Nobody watches.
pub struct Coaching;

impl Coaching {
    /// Does nothing.
    pub fn show(&self, _seen: &Seen) {}

    /// Nobody has.
    pub fn has_enough(&self) -> bool {
        false
    }

    /// Does nothing.
    pub fn solving(&self) {}

    /// Does nothing.
    pub fn end(self, _result: Result<&str, &str>, _stop: &Stop) {}
}
