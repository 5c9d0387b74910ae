//! One party of the fleet: a node with what it tells and what it collects.

use super::collecting::Collector;
use super::listening::CommonListener;
use super::status::{AgentLine, LinkLine, STATUS, StatusFile};
use super::telling::{Teller, Telling};
use super::waiting::Waits;
use crate::results::is_of_the_disk;
use anyhow::{Context, Result, anyhow};
use fleet::findings::Found;
use fleet::keys::Keys;
use fleet::node::{News, Quota, Status};
use fleet::service::{Service, ServiceOptions};
use fleet::transport::Endpoint;
use fleet::wire::Role;
use sources::Stop;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
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
/// How often the file is written.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// How a party is to be.
#[derive(Clone, Debug)]
pub struct FleetOptions {
    /// Folder for the results.
    pub out: PathBuf,
    /// Replace results of something else in that folder.
    pub force: bool,
    /// What people call it.
    pub name: String,
    /// Whether it has no map of its own, and is there to collect those of others.
    pub is_station: bool,
    /// Whether a run works beside it, to which it gives way.
    pub is_beside: bool,
    /// Where it listens.
    pub listen: Option<Endpoint>,
    /// Whom it dials.
    pub dial: Vec<Endpoint>,
    /// The folder of its keys; without them it reaches nobody beyond this machine.
    pub keys: Option<PathBuf>,
}

/// A party at work.
pub struct Fleet {
    service: Arc<Service>,
    telling: Mutex<Option<Telling>>,
    begun: u64,
    shared: Arc<Shared>,
    path: PathBuf,
    thread: Option<JoinHandle<Result<Collector>>>,
}

#[derive(Default)]
struct Shared {
    status: Mutex<StatusFile>,
    /// Ends the thread.
    stop: Stop,
    /// How many agents' maps are to be whole for the thread to end by itself.
    enough: Option<usize>,
    /// Where the thread tells people what happens.
    tell: Option<Tell>,
    /// Where it shows how things are.
    shows: Mutex<Option<Shows>>,
}

/// Tells people what happens.
type Tell = Box<dyn Fn(&str) + Send + Sync>;
/// Shows how things are, on a page say.
type Shows = Box<dyn Fn(Neighbourhood) + Send + Sync>;

impl Fleet {
    /// Starts a party, that ends by itself once the maps of `enough` agents are whole and merged; `tell` tells people
    /// what happens, `listeners` hear of the common maps.
    ///
    /// # Errors
    /// When a folder cannot be used, or an address not be listened at.
    pub fn start(
        options: &FleetOptions,
        enough: Option<usize>,
        tell: impl Fn(&str) + Send + Sync + 'static,
        listeners: Vec<Box<dyn CommonListener>>,
    ) -> Result<Self> {
        let role = if options.is_station { Role::Station } else { Role::Agent };
        let folder = if options.is_station { options.out.clone() } else { options.out.join(COMMON) };
        let collector = Collector::new(&folder, options.force, options.is_beside)?.heard_by(listeners);
        let shared = Arc::new(Shared { enough, tell: Some(Box::new(tell)), ..Shared::default() });
        let of_news = Arc::clone(&shared);
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
        let service = Arc::new(Service::start(service, move |news| of_news.hear(news))?);
        {
            let mut status = shared.status();
            status.name.clone_from(&options.name);
            status.listening = service.listening().map(Endpoint::to_string);
        }
        let (of_thread, seen) = (Arc::clone(&shared), Arc::clone(&service));
        let path = options.out.join(STATUS);
        let (at, is_beside) = (path.clone(), options.is_beside);
        let work = move || {
            if is_beside {
                crate::run::give_way();
            }
            of_thread.attend(collector, &seen, &at)
        };
        let thread = std::thread::Builder::new().name("fleet-merge".into()).spawn(work);
        let thread = Some(thread.context("cannot start a thread")?);
        Ok(Self { service, telling: Mutex::new(None), begun: now_ms(), shared, path, thread })
    }

    /// Who is to be told of a run's map, so that it is told here.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn teller(&self) -> Result<Teller> {
        let shared = Arc::clone(&self.shared);
        let warn = move |text: &str| shared.trouble(text);
        let (teller, telling) = Telling::start(Arc::clone(&self.service), self.begun, warn)?;
        *self.telling.lock().unwrap_or_else(PoisonError::into_inner) = Some(telling);
        Ok(teller)
    }

    /// Has shown how things are from now on, once a second and whenever something was found.
    pub fn shown_by(&self, shows: impl Fn(Neighbourhood) + Send + Sync + 'static) {
        *self.shared.shows.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(shows));
    }

    /// Where it listens.
    pub fn listening(&self) -> Option<&Endpoint> {
        self.service.listening()
    }

    /// Waits until all of the run's map is told and every neighbour that is there holds it, or `stop` is wished; a
    /// neighbour that is not there is waited for no longer than `patience`. Whether all is held.
    pub fn hand_over(&self, patience: Duration, stop: &Stop) -> bool {
        if let Some(telling) = self.telling.lock().unwrap_or_else(PoisonError::into_inner).take() {
            telling.finish();
        }
        // Time in which this program was stopped is none in which a neighbour could have come.
        let mut alone = Duration::ZERO;
        while !stop.requested() {
            if self.service.is_held() {
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
    pub fn take_over(&self, stop: &Stop) -> bool {
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
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let ended = thread.join().map_err(|_| anyhow!("merging broke down, which is a fault of loopbox"))?;
        // What is left is done here: the thread gave way to all others.
        let mut collector = ended?;
        let found = collector.finish(&self.service, &|text| self.shared.trouble(text))?;
        if let Some(found) = found {
            self.shared.status().found = found;
        }
        self.shared.show(&self.service.status(), collector.waits(), &self.path)
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

    fn say(&self, text: &str) {
        if let Some(tell) = &self.tell {
            tell(text);
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
            self.say(text);
        }
    }

    fn hear(&self, news: News) {
        match news {
            News::Met { name, address } => self.say(&format!("{name} is there, at {address}")),
            News::Trouble(text) => self.trouble(&text),
            News::Held { by, .. } => self.say(&format!("{by} holds all of the map told so far")),
            News::Findings { from, bytes } => {
                let found = match Found::from_bytes(&bytes) {
                    Ok(found) => found,
                    Err(why) => {
                        return self
                            .trouble(&format!("a neighbour tells what is not to be understood: {why}"));
                    }
                };
                let mut status = self.status();
                let from = from.to_string();
                let told = &mut status.told;
                let accepted = found.accepted();
                let before = told.iter().position(|(name, _)| *name == from);
                let before = before.map(|at| told.swap_remove(at).1.accepted());
                told.push((from, found));
                drop(status);
                if before != Some(accepted) {
                    self.say(&format!("a neighbour has merged {accepted} pairs of maps"));
                }
            }
            News::Map(_) => {}
        }
    }

    /// Merges what comes, and says how things are, until the end.
    fn attend(&self, mut collector: Collector, service: &Service, path: &Path) -> Result<Collector> {
        let mut written = None::<Instant>;
        let warn = |text: &str| self.trouble(text);
        let mut arrivals = 0;
        loop {
            let told: Vec<Found> = self.status().told.iter().map(|(_, found)| found.clone()).collect();
            let found = collector.step(service, &told, &warn, &self.stop)?;
            // What was found says what is next.
            let patience = if found.is_some() || collector.has_more() { Duration::ZERO } else { LOOK };
            if let Some(found) = found {
                let before = self.status().found.accepted();
                if found.accepted() != before {
                    let links = service.status().neighbours;
                    let kilobytes = links.iter().map(|link| link.received).sum::<u64>() / 1000;
                    let count = found.accepted();
                    self.say(&format!(
                        "{count} pairs of maps are merged, after {kilobytes} kB of objects came"
                    ));
                }
                service.findings(now_ms(), found.to_bytes());
                self.status().found = found;
                written = None;
            }
            collector.remind();
            if written.is_none_or(|written| written.elapsed() > STATUS_INTERVAL) {
                match self.show(&service.status(), collector.waits(), path) {
                    // It will say more when there is room.
                    Err(error) if is_of_the_disk(&error) => self.trouble(&format!("{error:#}")),
                    shown => shown?,
                }
                written = Some(Instant::now());
            }
            let is_enough = self.enough.is_some_and(|agents| collector.is_done(agents));
            if self.stop.requested() || is_enough {
                return Ok(collector);
            }
            arrivals = service.wait_for_arrivals(arrivals, patience, &AtomicBool::new(false));
        }
    }

    /// Writes how things are.
    fn show(&self, now: &Status, waits: &Waits, path: &Path) -> Result<()> {
        let links = now.neighbours.iter().map(LinkLine::of);
        let agents = now.agents.iter().map(|agent| AgentLine::of(agent, waits));
        let text = {
            let mut status = self.status();
            (status.links, status.agents) = (links.collect(), agents.collect());
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

/// Milliseconds since 1970.
fn now_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}
