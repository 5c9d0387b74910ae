//! Whoever wants to know how the map of a run grows, while it does.

use geometry::Se3;
use map::{AgentInfo, Identity, Map, MapDelta};
use nalgebra::Matrix6;
use slam_direct::{ScaleBreak, TrackingState};
use std::sync::{Arc, Mutex, PoisonError};

/// Follows the map of a run. The run's own thread calls it: whoever listens must not wait for anything,
/// and hands on what is to be worked on.
pub trait MapListener: Send {
    /// The run of this agent begins; who it is may not be known yet.
    fn begins(&mut self, about: &AgentInfo);

    /// The map that `agent` is making changed, in the order of its deltas; another epoch is another map. Deltas say
    /// nothing of tracked frames.
    fn changed(&mut self, agent: Identity, deltas: Vec<MapDelta>);

    /// A frame was processed. Runs that only localise say this, and nothing of how the map changes.
    fn processed(&mut self, frame: &ProcessedFrame<'_>) {
        let _ = frame;
    }

    /// The run has ended with these maps, which are all that there is to know of them.
    fn ended(&mut self, maps: &[Map]);
}

/// A frame that was processed, and what there is to know then.
#[derive(Clone, Copy, Debug)]
pub struct ProcessedFrame<'a> {
    /// Who makes the map that the frame belongs to; another epoch is another map, with a world of its own.
    pub agent: Identity,
    /// The frame's time stamp, seconds.
    pub timestamp: f64,
    /// Its pose as known now, if it has one; then it is the last of the map's frames.
    pub world_from_camera: Option<Se3>,
    /// Covariance of that (see [`slam_direct::FrameReport::covariance`]).
    pub covariance: Option<Matrix6<f64>>,
    /// Whether it was tracked.
    pub state: TrackingState,
    /// Why it was not, for people.
    pub reason: Option<&'static str>,
    /// Where the scale was not carried on, some keyframes ago.
    pub scale_break: Option<ScaleBreak>,
    /// What changed in the map since the frame before.
    pub deltas: &'a [MapDelta],
    /// The map as it is after these.
    pub map: &'a Map,
}

/// Those who listen, if anybody does.
#[derive(Clone, Default)]
pub struct Listeners(Vec<Arc<Mutex<dyn MapListener>>>);

impl Listeners {
    /// Somebody more.
    pub fn add(&mut self, listener: impl MapListener + 'static) {
        self.0.push(Arc::new(Mutex::new(listener)));
    }

    /// Whether anybody listens.
    pub fn are_there(&self) -> bool {
        !self.0.is_empty()
    }

    /// Calls everybody who listens.
    pub fn notify(&self, what: impl Fn(&mut dyn MapListener)) {
        for listener in &self.0 {
            what(&mut *listener.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}
