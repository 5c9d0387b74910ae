//! One peer of the fleet: a node with what it tells and what it collects.

use super::collecting::Collector;
use super::common_listener::CommonListener;
use super::options::FleetOptions;
use super::publishing::{MapPublisher, PublishingThread};
use super::received_results::ReceivedResults;
use super::saying::Saying;
use super::status::{AgentLine, LinkLine, STATUS, StatusFile};
use super::waiting::Waits;
use crate::Level;
use anyhow::{Context, Result, anyhow};
use fleet::keys::Keys;
use fleet::merge_results::MergeResults;
use fleet::node::{Notice, Quota, Status};
use fleet::service::{Service, ServiceOptions};
use fleet::transport::Endpoint;
use fleet::wire::Role;
use map::Uuid;
use sources::Stop;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use view::watch::Neighbourhood;

/// Where objects are kept, in the folder of results.
pub const OBJECTS: &str = "fleet";
/// Where an agent keeps the common map, in the folder of its own results.
const COMMON: &str = "common";
/// How often that is looked after.
const LOOK: Duration = Duration::from_millis(100);
/// How long it is waited in the end until the disk has what is whole.
const KEEPING: Duration = Duration::from_secs(10);
/// How often the file is written.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// A peer at work.
pub struct Fleet {
    service: Arc<Service>,
    publishing: Mutex<Option<PublishingThread>>,
    begun: u64,
    shared: Arc<Shared>,
    path: PathBuf,
    thread: Option<JoinHandle<Result<Collector>>>,
    /// Writes how things are, whatever takes long.
    writing: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    status: Mutex<StatusFile>,
    /// Ends the thread.
    stop: Stop,
    /// How many agents' maps are to be whole for the thread to end by itself.
    enough: Option<usize>,
    /// Where the thread tells people what happens.
    report: Option<Report>,
    /// What of neighbours was said.
    saying: Mutex<Saying>,
    /// Ends the thread that writes how things are.
    ends: AtomicBool,
    /// Whether something was found that is not shown.
    is_new: AtomicBool,
    /// Where it shows how things are.
    shows: Mutex<Option<Shows>>,
    /// How long agents waited for their places.
    waits: Mutex<Waits>,
    /// What neighbours found out.
    received_results: Mutex<ReceivedResults>,
}

/// Tells people what happens.
type Report = Box<dyn Fn(Level, &str) + Send + Sync>;
/// Shows how things are, on a page say.
type Shows = Box<dyn Fn(Neighbourhood) + Send + Sync>;

impl Fleet {
    /// Starts a peer, that ends by itself once the maps of `enough` agents are whole and merged; `report` tells people
    /// what happens, `listeners` hear of the common maps.
    ///
    /// # Errors
    /// When a folder cannot be used, or an address not be listened at.
    pub fn start(
        options: &FleetOptions,
        enough: Option<usize>,
        report: impl Fn(Level, &str) + Send + Sync + 'static,
        listeners: Vec<Box<dyn CommonListener>>,
    ) -> Result<Self> {
        let role = if options.is_station { Role::Station } else { Role::Agent };
        let folder = if options.is_station { options.out.clone() } else { options.out.join(COMMON) };
        let mut collector =
            Collector::new(&folder, options.force, options.in_background)?.with_listeners(listeners);
        let shared = Arc::new(Shared { enough, report: Some(Box::new(report)), ..Shared::default() });
        if let Some(store) = &options.store {
            let of_store = Arc::clone(&shared);
            collector = collector.sharing(store, move |text| of_store.trouble(text))?;
        }
        let for_notices = Arc::clone(&shared);
        let service = ServiceOptions {
            folder: options.out.join(OBJECTS),
            name: options.name.clone(),
            role,
            listen: options.listen.clone(),
            dial: options.dial.clone(),
            quota: Quota::default(),
            waits: true,
            keys: options.keys.as_deref().map(Keys::open).transpose()?,
        };
        let service = Arc::new(Service::start(service, move |notice| for_notices.handle(notice))?);
        {
            let mut status = shared.status();
            status.name.clone_from(&options.name);
            status.listening = service.listening().map(Endpoint::to_string);
        }
        let (of_thread, seen) = (Arc::clone(&shared), Arc::clone(&service));
        let (path, in_background) = (options.out.join(STATUS), options.in_background);
        let work = move || {
            if in_background {
                crate::describing::lower_priority();
            }
            of_thread.merge_until_the_end(collector, &seen)
        };
        let thread = std::thread::Builder::new().name("fleet-merge".into()).spawn(work);
        let thread = Some(thread.context("cannot start a thread")?);
        let (of_thread, seen, at) = (Arc::clone(&shared), Arc::clone(&service), path.clone());
        let work = move || of_thread.write_until_the_end(&seen, &at);
        let writing = std::thread::Builder::new().name("fleet-status".into()).spawn(work);
        let writing = Some(writing.context("cannot start a thread")?);
        Ok(Self { service, publishing: Mutex::new(None), begun: now_ms(), shared, path, thread, writing })
    }

    /// Who is to be told of a run's map, so that it is told here.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn publisher(&self) -> Result<MapPublisher> {
        let shared = Arc::clone(&self.shared);
        let warn = move |text: &str| shared.trouble(text);
        let (publisher, publishing) = PublishingThread::start(Arc::clone(&self.service), self.begun, warn)?;
        *self.publishing.lock().unwrap_or_else(PoisonError::into_inner) = Some(publishing);
        Ok(publisher)
    }

    /// Has shown how things are from now on, once a second and whenever something was found.
    pub fn report_to(&self, shows: impl Fn(Neighbourhood) + Send + Sync + 'static) {
        *self.shared.shows.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(shows));
    }

    /// Where it listens.
    pub fn listening(&self) -> Option<&Endpoint> {
        self.service.listening()
    }

    /// Waits until all of the run's map is told and every neighbour that is there holds it, or `stop` is wished; a
    /// neighbour that is not there is waited for no longer than `patience`. Whether all is held.
    pub fn hand_over(&self, patience: Duration, stop: &Stop) -> bool {
        if let Some(publishing) = self.publishing.lock().unwrap_or_else(PoisonError::into_inner).take() {
            publishing.finish();
        }
        // Time in which this program was stopped is none in which a neighbour could have come.
        let mut alone = Duration::ZERO;
        while !stop.requested() {
            if self.service.is_acknowledged() {
                return true;
            }
            if self.service.status().neighbours.iter().any(|neighbour| neighbour.address.is_some()) {
                alone = Duration::ZERO;
            }
            if alone >= patience {
                return false;
            }
            std::thread::sleep(LOOK);
            alone += LOOK;
        }
        false
    }

    /// Waits until all of the maps that neighbours tell is here, or `stop` is wished, or no neighbour is left. Whether all
    /// is.
    pub fn fetch_all(&self, stop: &Stop) -> bool {
        while !stop.requested() {
            let status = self.service.status();
            if status.agents.iter().all(|agent| agent.missing == 0) {
                return true;
            }
            if status.neighbours.iter().all(|neighbour| neighbour.address.is_none()) {
                return false;
            }
            std::thread::sleep(LOOK);
        }
        false
    }

    /// Waits until it ends by itself or `stop` is wished, and writes what is not written yet. How things are then.
    ///
    /// # Errors
    /// When the results cannot be written.
    pub fn wait(mut self, stop: &Stop) -> Result<StatusFile> {
        while !stop.requested() && self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            std::thread::sleep(LOOK);
        }
        self.end()?;
        Ok(self.shared.status().clone())
    }

    /// Ends it now.
    fn end(&mut self) -> Result<()> {
        self.shared.stop.request();
        let ended = self.finish();
        self.shared.ends.store(true, Ordering::Relaxed);
        if let Some(writing) = self.writing.take() {
            // One that broke down writes no more.
            let _ = writing.join();
        }
        if !ended? {
            return Ok(());
        }
        self.shared.status().ended = true;
        self.shared.show(&self.service.status(), &self.path)
    }

    /// Merges and keeps what is left; whether that was still to be done.
    fn finish(&mut self) -> Result<bool> {
        let Some(thread) = self.thread.take() else { return Ok(false) };
        let ended = thread.join().map_err(|_| anyhow!("internal error in merging, please report it"))?;
        // What is left is done here: the thread gave way to all others.
        let mut collector = ended?;
        let found = collector.finish(&self.service, &|text| self.shared.trouble(text))?;
        if let Some(found) = found {
            self.shared.status().found = found;
        }
        // What is whole here is to be on the disk, and its agents to know.
        let begun = Instant::now();
        while self.service.status().unkept > 0 && begun.elapsed() < KEEPING {
            std::thread::sleep(LOOK);
        }
        *self.shared.waits() = collector.waits().clone();
        Ok(true)
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        // Who wants to know what went wrong waits for it.
        let _ = self.end();
    }
}

impl Shared {
    fn status(&self) -> std::sync::MutexGuard<'_, StatusFile> {
        // Every section leaves it whole.
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn waits(&self) -> std::sync::MutexGuard<'_, Waits> {
        // Every section leaves it whole.
        self.waits.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn report(&self, level: Level, text: &str) {
        if let Some(report) = &self.report {
            report(level, text);
        }
    }

    fn trouble(&self, text: &str) {
        let mut status = self.status();
        let is_known = status.trouble.iter().any(|known| known == text);
        if !is_known {
            status.trouble.push(text.to_owned());
            let many = status.trouble.len().saturating_sub(20);
            status.trouble.drain(..many);
            drop(status);
            self.report(Level::Warn, text);
        }
    }

    fn handle(&self, notice: Notice) {
        let said = self.saying.lock().unwrap_or_else(PoisonError::into_inner).text(&notice);
        if let Some((level, text)) = said {
            self.report(level, &text);
        }
        match notice {
            Notice::Trouble(text) => self.trouble(&text),
            Notice::Results { from, peer, bytes } => match MergeResults::from_bytes(&bytes) {
                Ok(found) => self.receive_results(from, peer, found),
                Err(why) => self.trouble(&format!("a neighbour tells what is not to be understood: {why}")),
            },
            _ => {}
        }
    }

    /// A neighbour found something out.
    fn receive_results(&self, from: Uuid, peer: Option<Uuid>, found: MergeResults) {
        let accepted = found.accepted();
        let mut received_results = self.received_results.lock().unwrap_or_else(PoisonError::into_inner);
        let before = received_results.insert(from, peer, found);
        self.status().remote_results = received_results.all();
        drop(received_results);
        if before != Some(accepted) {
            self.report(Level::Info, &format!("a neighbour has merged {}", pairs_of_maps(accepted)));
        }
    }

    /// Writes how things are, every second, and whenever something was found.
    fn write_until_the_end(&self, service: &Service, path: &Path) {
        let mut written = None::<Instant>;
        while !self.ends.load(Ordering::Relaxed) {
            let is_due = written.is_none_or(|written| written.elapsed() >= STATUS_INTERVAL);
            if self.is_new.swap(false, Ordering::Relaxed) || is_due {
                // It will say more when there is room.
                if let Err(error) = self.show(&service.status(), path) {
                    self.trouble(&format!("{error:#}"));
                }
                written = Some(Instant::now());
            }
            std::thread::sleep(LOOK / 2);
        }
    }

    /// Merges what comes until the end.
    fn merge_until_the_end(&self, mut collector: Collector, service: &Service) -> Result<Collector> {
        let warn = |text: &str| self.trouble(text);
        let mut arrivals = 0;
        loop {
            let remote_results: Vec<Arc<MergeResults>> =
                self.status().remote_results.iter().map(|(_, found)| Arc::clone(&found.0)).collect();
            let found = collector.step(service, &remote_results, &warn, &self.stop)?;
            // What was found says what is next.
            let patience = if found.is_some() || collector.has_more() { Duration::ZERO } else { LOOK };
            if let Some(found) = found {
                let before = self.status().found.accepted();
                if found.accepted() != before {
                    let links = service.status().neighbours;
                    let kilobytes = links.iter().map(|link| link.received).sum::<u64>() / 1000;
                    let merged = pairs_of_maps(found.accepted());
                    self.report(
                        Level::Info,
                        &format!("merged {merged}, after {kilobytes} kB of objects came"),
                    );
                }
                let (accepted, pairs) = (found.accepted(), found.pair_verdicts.len());
                self.report(Level::Debug, &format!("{accepted} of {pairs} pairs of maps are merged so far"));
                service.publish_results(now_ms(), Arc::new(found.clone()));
                self.status().found = found;
                *self.waits() = collector.waits().clone();
                self.is_new.store(true, Ordering::Relaxed);
            }
            collector.tick();
            let is_enough = self.enough.is_some_and(|agents| collector.is_done(agents));
            if self.stop.requested() || is_enough {
                return Ok(collector);
            }
            arrivals = service.wait_for_arrivals(arrivals, patience, &AtomicBool::new(false));
        }
    }

    /// Writes how things are.
    fn show(&self, now: &Status, path: &Path) -> Result<()> {
        let unanswered = now.unanswered.iter().map(LinkLine::unanswered);
        let links = unanswered.chain(now.neighbours.iter().map(LinkLine::of)).collect();
        let waits = self.waits().clone();
        let agents = now.agents.iter().map(|agent| AgentLine::of(agent, &waits)).collect();
        let text = {
            let mut status = self.status();
            (status.links, status.agents, status.written_ms) = (links, agents, now_ms());
            if let Some(shows) = &*self.shows.lock().unwrap_or_else(PoisonError::into_inner) {
                shows(status.neighbourhood());
            }
            serde_json::to_vec_pretty(&*status)?
        };
        let partial = path.with_extension("json.tmp");
        fs::write(&partial, text)
            .and_then(|()| fs::rename(&partial, path))
            .with_context(|| format!("{}: cannot be written", path.display()))
    }
}

fn pairs_of_maps(count: usize) -> String {
    crate::counted(count, "pair of maps", "pairs of maps")
}

/// Milliseconds since 1970.
fn now_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}
