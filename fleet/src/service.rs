//! A node with its transport, its folder and its clock, in a thread of its own; another one reads what others ask for.

mod serving;

use crate::keys::Keys;
use crate::manifest::Kind;
use crate::merge_results::MergeResults;
use crate::node::{Action, Config, Event, MapSnapshot, Node, Notice, Quota, Status};
use crate::publishing::Publication;
use crate::store::{FolderStore, Store};
use crate::transport::tcp::Tcp;
use crate::transport::{Endpoint, Transport};
use crate::wire::{Role, VERSIONS};
use anyhow::{Context, Result, anyhow};
use map::{Identity, Uuid};
use serving::Serving;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

/// How often the node learns that time passes.
const TICK: Duration = Duration::from_millis(20);
/// Events that are taken in at once at the most.
const AT_ONCE: usize = 1000;
/// How often it is shown how things are: when something came, and in any case.
const SHOW: [Duration; 2] = [Duration::from_millis(5), Duration::from_millis(100)];
/// The file with the node's own name.
const NODE: &str = "node";

/// How a node is to be.
#[derive(Clone, Debug)]
pub struct ServiceOptions {
    /// Where its objects are kept; made if it is not there.
    pub folder: PathBuf,
    /// What people call it.
    pub name: String,
    /// What it is there for.
    pub role: Role,
    /// Where it listens.
    pub listen: Option<Endpoint>,
    /// Whom it dials.
    pub dial: Vec<Endpoint>,
    /// What another's map may take.
    pub quota: Quota,
    /// Whether little of others' maps comes before it is asked for, see [`Config::waits`].
    pub waits: bool,
    /// Its peer's keys; without them it reaches nobody beyond this machine.
    pub keys: Option<Keys>,
}

/// A node at work; ends when it is dropped.
pub struct Service {
    commands: Option<Sender<Event>>,
    shared: Arc<Shared>,
    store: Arc<FolderStore>,
    listening: Option<Endpoint>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    view: Mutex<View>,
    /// Told when there is something to be looked at at once.
    changed: Condvar,
    /// Publications that were handed in.
    submitted: AtomicU64,
}

/// What others may know of the node.
#[derive(Clone, Default)]
struct View {
    status: Status,
    snapshots: Vec<MapSnapshot>,
    own: Vec<MapSnapshot>,
    is_acknowledged: bool,
    /// Publications that the node took in.
    processed: u64,
    /// Whether something of own maps could not be kept.
    is_unkept: bool,
    /// How often something came that somebody waits for, as [`Node::arrivals`] counts it.
    arrivals: u64,
    ends: bool,
}

impl Service {
    /// Starts a node; `notify` is called with what happens, in its thread.
    ///
    /// # Errors
    /// When the folder cannot be used or an address not be listened at.
    pub fn start(options: ServiceOptions, notify: impl FnMut(Notice) + Send + 'static) -> Result<Self> {
        let folder = &options.folder;
        let store = FolderStore::open(folder)
            .with_context(|| format!("{}: objects cannot be kept there", folder.display()))?;
        let store = Arc::new(store);
        let node = own_name(&folder.join(NODE))?;
        let (commands, events) = channel();
        let keys = options.keys.as_ref();
        if let Some(keys) = keys {
            keys.check(SystemTime::now()).map_err(|what| {
                let name = &keys.peer().name;
                anyhow!("the certificate of {name} cannot be used: {what}\nhint: `loopbox keys agent {name}` makes a new one")
            })?;
        }
        let tcp = Tcp::start(options.listen.as_ref(), &options.dial, keys, commands.clone())?;
        let listening = tcp.listening().cloned();
        let signer = keys.map(Keys::signer);
        let ServiceOptions { name, role, quota, waits, .. } = options;
        let versions = VERSIONS;
        let config = Config { node, role, name, quota, waits, versions, signer };
        let node = Node::new(config, Arc::clone(&store) as Arc<dyn Store>);
        let shared = Arc::new(Shared::default());
        shared.refresh(&node, Duration::ZERO);
        shared.view().own = node.own_maps();
        let of_thread = Arc::clone(&shared);
        let tcp = Arc::new(tcp);
        let serving =
            Serving::start(Arc::clone(&store) as Arc<dyn Store>, Arc::clone(&tcp) as Arc<dyn Transport>)
                .context("cannot start a thread")?;
        let work = move || {
            Worker { node, transport: &*tcp, serving: &serving, shared: &of_thread, notify }.work(&events);
        };
        let thread = std::thread::Builder::new().name("fleet".into()).spawn(work);
        let thread = Some(thread.context("cannot start a thread")?);
        Ok(Self { commands: Some(commands), shared, store, listening, thread })
    }

    /// Where it listens, with the port that it got.
    pub fn listening(&self) -> Option<&Endpoint> {
        self.listening.as_ref()
    }

    /// Tells a new version of a map; never waits.
    pub fn publish(&self, publication: Publication) {
        self.shared.submitted.fetch_add(1, Ordering::SeqCst);
        self.send(Event::Publish(Box::new(publication)));
    }

    /// Tells what was found out; `revision` is larger than before.
    pub fn publish_results(&self, revision: u64, found: Arc<MergeResults>) {
        self.send(Event::Results { revision, found });
    }

    /// How things are.
    pub fn status(&self) -> Status {
        self.shared.view().status.clone()
    }

    /// Maps of others that are here, whole or in part.
    pub fn snapshots(&self) -> Vec<MapSnapshot> {
        self.shared.view().snapshots.clone()
    }

    /// Own maps.
    pub fn own(&self) -> Vec<MapSnapshot> {
        self.shared.view().own.clone()
    }

    /// These objects of keyframes of an agent are to come before others, the most wanted first, and if `rest` all
    /// others after them. Before this is said, a node that waits gets lists and places of keyframes only.
    pub fn prefer(&self, agent: Identity, objects: Vec<(Kind, u32)>, rest: bool) {
        self.send(Event::Prefer { agent, objects, rest });
    }

    /// What was told of an agent is not to be believed: whoever told it is refused.
    pub fn ban(&self, agent: Identity, reason: String) {
        self.send(Event::Ban { agent, reason });
    }

    /// Whether all neighbours that are there hold all own maps as they were published last; false without one.
    pub fn is_acknowledged(&self) -> bool {
        let view = self.shared.view();
        view.is_acknowledged && view.processed == self.shared.submitted.load(Ordering::SeqCst)
    }

    /// Whether something of own maps could not be kept since this was asked last, so that all of them is to be published anew
    /// (see [`Publisher::begin_again`](crate::publishing::Publisher::begin_again)).
    pub fn was_unkept(&self) -> bool {
        std::mem::take(&mut self.shared.view().is_unkept)
    }

    /// Waits until something comes that somebody waits for, see [`Node::arrivals`], or, once it is [woken](Self::wake), until it
    /// `ends`, and for `patience` at the most; `seen` is what the last call returned.
    pub fn wait_for_arrivals(&self, seen: u64, patience: Duration, ends: &AtomicBool) -> u64 {
        let view = self.shared.view();
        let waits = |view: &mut View| view.arrivals == seen && !ends.load(Ordering::SeqCst);
        let waited = self.shared.changed.wait_timeout_while(view, patience, waits);
        waited.unwrap_or_else(PoisonError::into_inner).0.arrivals
    }

    /// Has whoever waits look whether that is to end.
    pub fn wake(&self) {
        // Who holds it has looked already, or will look.
        let _view = self.shared.view();
        self.shared.changed.notify_all();
    }

    /// How often something came that somebody waits for, as [`wait_for_arrivals`](Self::wait_for_arrivals) counts it.
    pub fn arrivals(&self) -> u64 {
        self.shared.view().arrivals
    }

    /// Where the objects are.
    pub fn store(&self) -> Arc<FolderStore> {
        Arc::clone(&self.store)
    }

    fn send(&self, event: Event) {
        if let Some(commands) = &self.commands {
            // A thread that broke down tells nobody anything.
            let _ = commands.send(event);
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.shared.view().ends = true;
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn view(&self) -> std::sync::MutexGuard<'_, View> {
        // Every section leaves it whole.
        self.view.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Shows how the node is.
    fn refresh(&self, node: &Node, now: Duration) {
        let (status, snapshots, is_acknowledged) =
            (node.status(now), node.snapshots().collect(), node.is_acknowledged());
        let mut view = self.view();
        (view.status, view.snapshots, view.is_acknowledged) = (status, snapshots, is_acknowledged);
    }
}

/// What the node's thread works with.
struct Worker<'a, N> {
    node: Node,
    transport: &'a dyn Transport,
    serving: &'a Serving,
    shared: &'a Shared,
    notify: N,
}

impl<N: FnMut(Notice)> Worker<'_, N> {
    /// Gives the node the events that come, and does what it wants done, until the service ends.
    fn work(&mut self, events: &Receiver<Event>) {
        let started = Instant::now();
        let (mut looked, mut arrivals) = (Duration::ZERO, self.node.arrivals());
        while !self.shared.view().ends {
            let first = match events.recv_timeout(TICK) {
                Ok(event) => event,
                Err(RecvTimeoutError::Timeout) => Event::Tick,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            // All events that wait are taken in, so that no neighbour counts as silent whose messages are here.
            for event in std::iter::once(first).chain(events.try_iter().take(AT_ONCE)) {
                self.take_in(started.elapsed(), event);
            }
            let now = started.elapsed();
            let mut is_own = false;
            for action in self.node.step(now) {
                is_own |= self.act(action);
            }
            if is_own {
                self.shared.view().own = self.node.own_maps();
            }
            // Who waits for these objects to decide what to do next is told at once.
            let is_arrival = arrivals != self.node.arrivals();
            let passed = now.saturating_sub(looked);
            if is_own || is_arrival && passed >= SHOW[0] || passed >= SHOW[1] {
                self.shared.refresh(&self.node, now);
                looked = now;
                if std::mem::replace(&mut arrivals, self.node.arrivals()) != arrivals {
                    self.shared.view().arrivals += 1;
                    self.shared.changed.notify_all();
                }
            }
        }
    }

    fn take_in(&mut self, now: Duration, event: Event) {
        let came = match &event {
            Event::Received { link, bytes } => Some((*link, bytes.len())),
            Event::Down { link } => {
                self.serving.forget(*link);
                None
            }
            _ => None,
        };
        if matches!(event, Event::Publish(_)) {
            let mut view = self.shared.view();
            // No neighbour holds yet what is published now.
            (view.processed, view.is_acknowledged) = (view.processed + 1, false);
        }
        self.node.apply(now, event);
        if let Some((link, bytes)) = came {
            self.transport.looked_at(link, bytes);
        }
    }

    /// Does what the node wants done; whether an own map was published.
    fn act(&mut self, action: Action) -> bool {
        match action {
            Action::Send { link, priority, bytes } => self.transport.send(link, priority, bytes),
            Action::Serve { link, hash, offset, length } => self.serving.ask(link, (hash, offset, length)),
            Action::Close { link, .. } => self.transport.close(link),
            Action::Notify(Notice::Unkept) => self.shared.view().is_unkept = true,
            Action::Notify(notice) => {
                let is_own = matches!(notice, Notice::Published { .. });
                (self.notify)(notice);
                return is_own;
            }
        }
        false
    }
}

/// The node's own name, which it keeps: made when it is first asked for.
fn own_name(path: &Path) -> Result<Uuid> {
    if let Some(known) = fs::read_to_string(path).ok().and_then(|text| Uuid::try_parse(text.trim()).ok()) {
        return Ok(known);
    }
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| anyhow!("the system gives no random numbers: {error}"))?;
    let made = map::Identity::random(bytes).uuid;
    fs::write(path, format!("{made}\n")).with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(made)
}
