//! The map of a run, told while it grows: in a thread of its own, which gives way to all others. What is left when the
//! run has ended is told by whoever waits for it, and gives way to nobody.

use crate::run::{MapListener, give_way};
use anyhow::{Context, Result};
use fleet::publishing::Publisher;
use fleet::service::Service;
use map::{AgentId, AgentInfo, Identity, Keyframe, Map, MapDelta};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often what is new is told, at the most.
const INTERVAL: Duration = Duration::from_secs(1);

/// What the run's thread hands on.
enum Heard {
    Begins(AgentInfo),
    Changed(Identity, Vec<MapDelta>),
    Ended(Vec<Map>),
}

/// Hands the changes of a run's map to the thread that tells them; the run never waits for it.
pub struct Teller {
    heard: Sender<Heard>,
}

/// The thread that tells; [`finish`](Self::finish) tells what is left.
pub(super) struct Telling {
    thread: JoinHandle<Work>,
    warn: Warn,
}

/// Is told what cannot be told of the map.
type Warn = Arc<dyn Fn(&str) + Send + Sync>;

impl Telling {
    /// Starts it; `begun` is the time, milliseconds since 1970, and `warn` is told what cannot be told of the map.
    pub fn start(
        service: Arc<Service>,
        begun: u64,
        warn: impl Fn(&str) + Send + Sync + 'static,
    ) -> Result<(Teller, Self)> {
        let (heard, changes) = channel();
        let warn: Warn = Arc::new(warn);
        let of_thread = Arc::clone(&warn);
        let work = move || {
            give_way();
            let (about, maps) = (None, BTreeMap::new());
            Work { service, begun, about, maps, left: Vec::new() }.attend(&changes, &*of_thread)
        };
        let thread = std::thread::Builder::new().name("fleet-tell".into()).spawn(work);
        Ok((Teller { heard }, Self { thread: thread.context("cannot start a thread")?, warn }))
    }

    /// Tells all that is left of what was handed on. Nobody hands on any more.
    pub fn finish(self) {
        // One that broke down tells no more.
        if let Ok(mut work) = self.thread.join() {
            std::mem::take(&mut work.left).into_iter().for_each(|heard| work.take(heard));
            work.tell(&*self.warn);
        }
    }
}

// Nobody to tell is no reason for the run to end.
impl MapListener for Teller {
    fn begins(&mut self, about: &AgentInfo) {
        let _ = self.heard.send(Heard::Begins(about.clone()));
    }

    fn changed(&mut self, agent: Identity, deltas: Vec<MapDelta>) {
        let _ = self.heard.send(Heard::Changed(agent, deltas));
    }

    fn ended(&mut self, maps: &[Map]) {
        let _ = self.heard.send(Heard::Ended(maps.to_vec()));
    }
}

struct Work {
    service: Arc<Service>,
    begun: u64,
    about: Option<AgentInfo>,
    maps: BTreeMap<Identity, Growing>,
    /// What came at the end of the run.
    left: Vec<Heard>,
}

/// A map as far as it is known.
struct Growing {
    publisher: Publisher,
    map: Map,
    is_new: bool,
    ended: bool,
}

impl Work {
    /// Tells what is new until the run ends, and leaves what came then.
    fn attend(mut self, changes: &Receiver<Heard>, warn: &dyn Fn(&str)) -> Self {
        let mut told = Instant::now();
        loop {
            match changes.recv_timeout(INTERVAL.saturating_sub(told.elapsed())) {
                Ok(ended @ Heard::Ended(_)) => self.left.push(ended),
                Ok(heard) => self.take(heard),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self,
            }
            if told.elapsed() >= INTERVAL && self.left.is_empty() {
                self.tell(warn);
                told = Instant::now();
            }
        }
    }

    fn take(&mut self, heard: Heard) {
        match heard {
            Heard::Begins(about) => self.about = Some(about),
            Heard::Changed(identity, deltas) => {
                let Some(about) = self.about.clone() else { return };
                let about = AgentInfo { identity: Some(identity), ..about };
                let growing = self.growing(identity, about);
                deltas.into_iter().for_each(|delta| growing.map.take_in(delta));
                growing.is_new = true;
            }
            Heard::Ended(maps) => {
                // Of parts that were joined each is told by itself: whoever collects them joins them again.
                for map in maps.iter().flat_map(Map::split) {
                    let Some(about) = map.agents.get(&AgentId::default()).cloned() else { continue };
                    let Some(identity) = about.identity else { continue };
                    let growing = self.growing(identity, about);
                    (growing.map, growing.is_new, growing.ended) = (map, true, true);
                }
            }
        }
    }

    /// What is known of a map so far: of one that was never heard of that it is that of the agent `about`.
    fn growing(&mut self, identity: Identity, about: AgentInfo) -> &mut Growing {
        let begun = self.begun;
        self.maps.entry(identity).or_insert_with(|| Growing {
            publisher: Publisher::new(identity, begun),
            map: Map::of(about),
            is_new: false,
            ended: false,
        })
    }

    /// Tells what is new.
    fn tell(&mut self, warn: &dyn Fn(&str)) {
        if self.service.was_unkept() {
            for growing in self.maps.values_mut() {
                growing.publisher.begin_again();
                growing.is_new = true;
            }
        }
        for growing in self.maps.values_mut().filter(|growing| growing.is_new) {
            growing.is_new = false;
            let has_none = |keyframe: &Keyframe| keyframe.semi_dense.is_empty() && keyframe.scan.is_none();
            let is_empty = growing.map.keyframes.values().all(has_none);
            if is_empty && !growing.ended {
                continue;
            }
            match growing.publisher.publish(&growing.map, growing.ended) {
                Ok(Some(publication)) => self.service.publish(publication),
                Ok(None) => {}
                Err(error) => warn(&format!("the map is not told to the fleet: {error}")),
            }
        }
    }
}
