//! The map of a run, told while it grows: in a thread of its own, which gives way to all others. What is left when the
//! run has ended is told by whoever waits for it, and gives way to nobody.

use crate::describing::lower_priority;
use crate::listeners::MapListener;
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
enum Change {
    Begins(AgentInfo),
    Changed(Identity, Vec<MapDelta>),
    Ended(Vec<Map>),
}

/// Hands the changes of a run's map to the thread that tells them; the run never waits for it.
pub struct MapPublisher {
    sender: Sender<Change>,
}

/// The thread that tells; [`finish`](Self::finish) tells what is left.
pub(super) struct PublishingThread {
    thread: JoinHandle<Work>,
    warn: Warn,
}

/// Is told what cannot be told of the map.
type Warn = Arc<dyn Fn(&str) + Send + Sync>;

impl PublishingThread {
    /// Starts it; `begun` is the time, milliseconds since 1970, and `warn` is told what cannot be told of the map.
    pub fn start(
        service: Arc<Service>,
        begun: u64,
        warn: impl Fn(&str) + Send + Sync + 'static,
    ) -> Result<(MapPublisher, Self)> {
        let (sender, changes) = channel();
        let warn: Warn = Arc::new(warn);
        let of_thread = Arc::clone(&warn);
        let work = move || {
            lower_priority();
            let (about, maps) = (None, BTreeMap::new());
            Work { service, begun, about, maps, left: Vec::new() }.follow(&changes, &*of_thread)
        };
        let thread = std::thread::Builder::new().name("fleet-tell".into()).spawn(work);
        Ok((MapPublisher { sender }, Self { thread: thread.context("cannot start a thread")?, warn }))
    }

    /// Tells all that is left of what was handed on. Nobody hands on any more.
    pub fn finish(self) {
        // One that broke down tells no more.
        if let Ok(mut work) = self.thread.join() {
            std::mem::take(&mut work.left).into_iter().for_each(|change| work.apply(change));
            work.publish(&*self.warn);
        }
    }
}

// Nobody to tell is no reason for the run to end.
impl MapListener for MapPublisher {
    fn begins(&mut self, about: &AgentInfo) {
        let _ = self.sender.send(Change::Begins(about.clone()));
    }

    fn changed(&mut self, agent: Identity, deltas: Vec<MapDelta>) {
        let _ = self.sender.send(Change::Changed(agent, deltas));
    }

    fn ended(&mut self, maps: &[Map]) {
        let _ = self.sender.send(Change::Ended(maps.to_vec()));
    }
}

struct Work {
    service: Arc<Service>,
    begun: u64,
    about: Option<AgentInfo>,
    maps: BTreeMap<Identity, FollowedMap>,
    /// What came at the end of the run.
    left: Vec<Change>,
}

/// A map as far as it is known.
struct FollowedMap {
    publisher: Publisher,
    map: Map,
    is_new: bool,
    ended: bool,
}

impl Work {
    /// Tells what is new until the run ends, and leaves what came then.
    fn follow(mut self, changes: &Receiver<Change>, warn: &dyn Fn(&str)) -> Self {
        let mut published = Instant::now();
        loop {
            match changes.recv_timeout(INTERVAL.saturating_sub(published.elapsed())) {
                Ok(ended @ Change::Ended(_)) => self.left.push(ended),
                Ok(change) => self.apply(change),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self,
            }
            if published.elapsed() >= INTERVAL && self.left.is_empty() {
                self.publish(warn);
                published = Instant::now();
            }
        }
    }

    fn apply(&mut self, change: Change) {
        match change {
            Change::Begins(about) => self.about = Some(about),
            Change::Changed(identity, deltas) => {
                let Some(about) = self.about.clone() else { return };
                let about = AgentInfo { identity: Some(identity), ..about };
                let followed = self.followed(identity, about);
                deltas.into_iter().for_each(|delta| followed.map.take_in(delta));
                followed.is_new = true;
            }
            Change::Ended(maps) => {
                // Of parts that were joined each is told by itself: whoever collects them joins them again.
                for map in maps.iter().flat_map(Map::split) {
                    let Some(about) = map.agents.get(&AgentId::default()).cloned() else { continue };
                    let Some(identity) = about.identity else { continue };
                    let followed = self.followed(identity, about);
                    (followed.map, followed.is_new, followed.ended) = (map, true, true);
                }
            }
        }
    }

    /// What is known of a map so far: of one that was never heard of that it is that of the agent `about`.
    fn followed(&mut self, identity: Identity, about: AgentInfo) -> &mut FollowedMap {
        let begun = self.begun;
        self.maps.entry(identity).or_insert_with(|| FollowedMap {
            publisher: Publisher::new(identity, begun),
            map: Map::of(about),
            is_new: false,
            ended: false,
        })
    }

    /// Tells what is new.
    fn publish(&mut self, warn: &dyn Fn(&str)) {
        if self.service.was_unkept() {
            for followed in self.maps.values_mut() {
                followed.publisher.begin_again();
                followed.is_new = true;
            }
        }
        for followed in self.maps.values_mut().filter(|followed| followed.is_new) {
            followed.is_new = false;
            let has_none = |keyframe: &Keyframe| keyframe.semi_dense.is_empty() && keyframe.scan.is_none();
            let is_empty = followed.map.keyframes.values().all(has_none);
            if is_empty && !followed.ended {
                continue;
            }
            match followed.publisher.publish(&followed.map, followed.ended) {
                Ok(Some(publication)) => self.service.publish(publication),
                Ok(None) => {}
                Err(error) => warn(&format!("the map is not told to the fleet: {error}")),
            }
        }
    }
}
