//! Watching a calibration, in a program built without it: the same calls, which do nothing.

use super::collect::CollectProgress;
use anyhow::Result;
use calib::Board;
use sources::Stop;
use std::convert::Infallible;

/// Nobody watches.
pub struct Coaching;

impl Coaching {
    /// There is no page to serve.
    ///
    /// # Errors
    /// Never.
    pub fn start(_address: Option<Infallible>, _board: &Board, _live: bool) -> Result<Self> {
        Ok(Self)
    }

    /// Does nothing.
    pub fn show(&self, _seen: &CollectProgress) {}

    /// Nobody has.
    pub fn has_enough(&self) -> bool {
        false
    }

    /// Does nothing.
    pub fn solving(&self) {}

    /// There is none.
    pub fn url(&self) -> Option<String> {
        None
    }

    /// Does nothing.
    pub fn end(self, _result: Result<&str, &str>, _stop: &Stop, _waiting: impl FnOnce(&str)) {}
}
