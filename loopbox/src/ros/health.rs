//! How the tracking goes, as the diagnostics of ROS 2 have it.

use crate::run::{ProcessedFrame, state_name};
use ros2::messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Level, Time};
use slam_direct::TrackingState;

/// How the tracking goes since the run began.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Health {
    /// The newest frame's time, seconds.
    timestamp: f64,
    state: TrackingState,
    /// Why the newest frame has no pose.
    reason: Option<&'static str>,
    /// How often tracking was lost.
    losses: u64,
    /// How often the scale was not carried on.
    breaks: u64,
    /// When that was found last, and what; it stays, for what is mapped since has a unit of its own.
    last_break: Option<(f64, String)>,
}

impl Default for Health {
    fn default() -> Self {
        Self {
            timestamp: 0.0,
            state: TrackingState::Starting,
            reason: None,
            losses: 0,
            breaks: 0,
            last_break: None,
        }
    }
}

impl Health {
    /// Takes in the next frame.
    pub fn add(&mut self, seen: &ProcessedFrame<'_>) {
        self.losses += u64::from(self.state == TrackingState::Tracking && seen.state == TrackingState::Lost);
        (self.timestamp, self.state, self.reason) = (seen.timestamp, seen.state, seen.reason);
        if let Some(found) = seen.scale_break {
            self.breaks += 1;
            self.last_break = Some((seen.timestamp, found.text()));
        }
    }

    /// Whether something else is to be said than that a frame more was processed.
    pub fn differs(&self, before: &Self) -> bool {
        let said = |own: &Self| (own.state, own.losses, own.breaks);
        said(self) != said(before)
    }

    /// The message of it, of the agent that ROS knows by this name.
    pub fn diagnostics(&self, agent: &str) -> DiagnosticArray {
        let header = Header { stamp: Time::of_seconds(self.timestamp), frame_id: String::new() };
        DiagnosticArray { header, status: vec![self.tracking(agent), self.scale(agent)] }
    }

    fn tracking(&self, agent: &str) -> DiagnosticStatus {
        let level = match self.state {
            TrackingState::Tracking => Level::Ok,
            TrackingState::Starting => Level::Warn,
            TrackingState::Lost => Level::Error,
        };
        let why = self.reason.filter(|_| level != Level::Ok);
        let why = why.map_or(String::new(), |reason| format!(": {reason}"));
        let message = format!("{}{why}", state_name(self.state));
        status((agent, "tracking"), level, message, ("times lost", self.losses))
    }

    fn scale(&self, agent: &str) -> DiagnosticStatus {
        let (level, message) = match &self.last_break {
            None => (Level::Ok, "carried on".to_owned()),
            Some((time, why)) => {
                let since = "what is mapped since then has a unit of its own";
                (Level::Warn, format!("not carried on some keyframes before {time:.2} s: {why}; {since}"))
            }
        };
        status((agent, "scale"), level, message, ("times not carried on", self.breaks))
    }
}

/// What is said of a part of an agent.
fn status(
    (agent, part): (&str, &str),
    level: Level,
    message: String,
    (key, count): (&str, u64),
) -> DiagnosticStatus {
    let values = vec![KeyValue { key: key.into(), value: count.to_string() }];
    DiagnosticStatus {
        level,
        name: format!("loopbox: {agent} {part}"),
        message,
        hardware_id: agent.into(),
        values,
    }
}
