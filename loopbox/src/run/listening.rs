//! Whoever wants to know how the map of a run grows, while it does.

use map::{AgentInfo, Identity, Map, MapDelta};
use std::sync::{Arc, Mutex, PoisonError};

/// Is told what becomes of the map of a run. The run's own thread tells it: whoever listens must not wait for anything,
/// and hands on what is to be worked on.
pub trait MapListener: Send {
    /// The run of this agent begins; who it is may not be known yet.
    fn begins(&mut self, about: &AgentInfo);

    /// The map that `agent` is making changed, in the order of its deltas; another epoch is another map. Deltas say
    /// nothing of tracked frames.
    fn changed(&mut self, agent: Identity, deltas: Vec<MapDelta>);

    /// The run has ended with these maps, which are all that there is to know of them.
    fn ended(&mut self, maps: &[Map]);
}

/// Somebody who listens, or nobody.
#[derive(Clone, Default)]
pub struct Listener(Option<Arc<Mutex<dyn MapListener>>>);

impl Listener {
    /// Somebody.
    pub fn new(listener: impl MapListener + 'static) -> Self {
        Self(Some(Arc::new(Mutex::new(listener))))
    }

    /// Whether anybody listens.
    pub fn is_there(&self) -> bool {
        self.0.is_some()
    }

    /// Tells whoever listens.
    pub fn tell(&self, what: impl FnOnce(&mut dyn MapListener)) {
        if let Some(listener) = &self.0 {
            what(&mut *listener.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}
