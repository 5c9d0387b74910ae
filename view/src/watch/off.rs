//! Watching, in a program built without it: the same calls, which do nothing.

#[path = "neighbourhood.rs"]
mod neighbourhood;

use map::{Map, MapDelta};
use slam_direct::{Frame, FrameReport};
use sources::Stop;
use std::path::Path;

pub use neighbourhood::{FleetCounts, Neighbour, Neighbourhood, PairLine, RemoteMap};

/// What the user wants of the run; here nobody does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Write the results as they stand, and go on.
    Save,
    /// Write the results and begin a new map.
    Restart,
}

/// What a run's end says to its viewers.
pub struct Ended<'a> {
    /// For people.
    pub note: &'a str,
    /// The report, where one was written.
    pub report: Option<&'a Path>,
}

/// Nobody watches.
pub struct Watch;

impl Watch {
    /// Nobody watches.
    pub fn none() -> Self {
        Self
    }

    /// No commands come.
    pub fn attend(&mut self, _stop: &Stop) -> Option<Command> {
        None
    }

    /// Does nothing.
    pub fn before(&mut self, _frame: &Frame) {}

    /// Does nothing.
    pub fn after(
        &mut self,
        _frame: (u64, f64, f64),
        _latency_ms: Option<f64>,
        _report: FrameReport,
        _update: (&[MapDelta], &Map),
        _dropped: u64,
    ) {
    }

    /// Does nothing.
    pub fn finished(&mut self, _deltas: &[MapDelta], _map: &Map) {}

    /// Does nothing.
    pub fn restart(&mut self) {}

    /// Does nothing.
    pub fn begin_anew(&mut self) {}

    /// Does nothing.
    pub fn folder(&self, _folder: &Path) {}

    /// Tells nobody.
    pub fn notifier(&self) -> impl Fn(String) + Send + 'static + use<> {
        |_| {}
    }

    /// Shows nobody.
    pub fn neighbourhood(&self) -> impl Fn(Neighbourhood) + Send + Sync + 'static + use<> {
        |_| {}
    }

    /// Does nothing.
    pub fn end(self, _ended: Ended) {}
}
