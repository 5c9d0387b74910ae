//! What the run's loop holds of its watchers.

use super::feed::{Gatherer, LiveImage, Pending};
use super::run_page::COMMANDS;
use super::scene::{Agent, Scene};
use super::status::{Facts, FoundBreak};
use super::web;
use super::{Command, Neighbourhood, RunPage, Shared, watcher};
use anyhow::{Context, Result};
use map::{AgentInfo, Map, MapDelta};
use slam_direct::{Frame, FrameReport, TrackingState};
use sources::Stop;
use sources::recording::RecordButton;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Images handed to viewers: ten a second are fluid enough to watch and cheap.
const PICTURE_INTERVAL: Duration = Duration::from_millis(100);
/// How often a paused run looks whether it is to stop.
const PAUSED_INTERVAL: Duration = Duration::from_millis(50);

/// Who watches, and what for.
#[derive(Default)]
pub struct WatchOptions {
    /// Show the run on this page, which commands it; who holds it ends it.
    pub page: Option<RunPage>,
    /// Show the run on a page that is served already and outlives it, to be looked at only: nobody commands the run.
    pub server: Option<web::Server>,
    /// Serve Foxglove on this port of the machine's own address.
    pub foxglove: Option<u16>,
    /// What the button for recording drives.
    pub recording: Option<RecordButton>,
    /// Frames of the recording, where known.
    pub frames: Option<u64>,
}

/// How a run's loop is watched and commanded; [`none`](Self::none) costs nothing.
pub struct Watch(Option<Inner>);

struct Inner {
    shared: Arc<Shared>,
    commands: Receiver<Command>,
    paused: bool,
    gatherer: Gatherer,
    last_state: TrackingState,
    picture_due: Instant,
    picture: Option<LiveImage>,
    recording: Option<RecordButton>,
    watcher: Option<JoinHandle<()>>,
    page: Option<RunPage>,
    /// What outlives the run.
    server: Option<web::Server>,
    places: Vec<String>,
}

/// What a run's end says to its viewers.
pub struct Ended<'a> {
    /// For people.
    pub note: &'a str,
    /// The report, where one was written.
    pub report: Option<&'a Path>,
}

impl Watch {
    /// Nobody watches.
    pub fn none() -> Self {
        Self(None)
    }

    /// Starts what shows a run of this agent; [`places`](Self::places) says where else to look.
    ///
    /// # Errors
    /// When an address cannot be listened at or a thread not be started.
    pub fn start(agent: &AgentInfo, options: WatchOptions) -> Result<Self> {
        if options.page.is_none() && options.server.is_none() && options.foxglove.is_none() {
            return Ok(Self::none());
        }
        let camera = *agent.camera().context("only runs of cameras can be watched")?;
        let agents = vec![Agent { name: agent.name.clone(), camera, metric: agent.is_metric() }];
        let recording = options.recording.as_ref().map(|recording| recording.is_on());
        let first =
            super::Status { state: "starting", frames: options.frames, recording, ..Default::default() };
        let (sender, own) = sync_channel(COMMANDS);
        let (shared, of_page) = match &options.page {
            Some(page) => page.begin(agents, first),
            None => {
                let obeys = options.server.is_none().then_some(sender);
                let shared = Arc::new(Shared::new(Scene::of(agents), obeys));
                shared.scene().set_status(first);
                (shared, None)
            }
        };
        let commands = of_page.unwrap_or(own);
        if let Some(server) = &options.server {
            server.show(&shared, &agent.name);
        }
        #[cfg(feature = "foxglove-server")]
        let foxglove = options.foxglove.map(|port| super::foxglove::start(&shared, port)).transpose()?;
        #[cfg(not(feature = "foxglove-server"))]
        let foxglove: Option<String> = None;
        let foxglove = foxglove.map(|url| format!("Foxglove: open a connection to {url}"));
        let places = foxglove.into_iter().collect();
        let of_thread = Arc::clone(&shared);
        let watcher = std::thread::Builder::new()
            .name("watch".into())
            .spawn(move || watcher::watch(&of_thread, camera))
            .context("cannot start the watching thread")?;
        Ok(Self(Some(Inner {
            shared,
            commands,
            paused: false,
            gatherer: Gatherer::default(),
            last_state: TrackingState::Starting,
            picture_due: Instant::now(),
            picture: None,
            recording: options.recording,
            watcher: Some(watcher),
            page: options.page,
            server: options.server,
            places,
        })))
    }

    /// Where to watch besides the page, a line for each way, for people.
    pub fn places(&self) -> &[String] {
        self.0.as_ref().map_or(&[], |inner| &inner.places)
    }

    /// What the user wants that the run itself must do, [`Command::Save`] or [`Command::Restart`]; waits while the
    /// run is paused and not to stop.
    pub fn attend(&mut self, stop: &Stop) -> Option<Command> {
        let inner = self.0.as_mut()?;
        loop {
            let patience = if inner.paused { PAUSED_INTERVAL } else { Duration::ZERO };
            match inner.commands.recv_timeout(patience) {
                Ok(Command::Pause) => inner.pause(true),
                Ok(Command::Resume) => inner.pause(false),
                Ok(Command::Record(on)) => inner.record(on),
                Ok(command) => return Some(command),
                Err(RecvTimeoutError::Timeout) if inner.paused && !stop.requested() => {}
                Err(_) => return None,
            }
        }
    }

    /// Call it before a frame is processed: it keeps a copy of the image if one is due.
    pub fn before(&mut self, frame: &Frame) {
        let Some(inner) = &mut self.0 else { return };
        let now = Instant::now();
        if now >= inner.picture_due && inner.shared.audience.load(Ordering::Relaxed) > 0 {
            inner.picture_due = now + PICTURE_INTERVAL;
            let (frame_index, timestamp) = (frame.index, frame.timestamp);
            inner.picture = Some(LiveImage {
                frame_index,
                timestamp,
                image: frame.image.clone(),
                world_from_camera: None,
            });
        }
    }

    /// Call it after a frame was processed, with the time that took, the time since its capture where that is
    /// known, what was said of the map since the last call and the map, and the frames dropped so far.
    pub fn after(
        &mut self,
        (frame, timestamp, ms): (u64, f64, f64),
        latency_ms: Option<f64>,
        report: FrameReport,
        (deltas, map): (&[MapDelta], &Map),
        dropped: u64,
    ) {
        let Some(inner) = &mut self.0 else { return };
        let lost = inner.last_state == TrackingState::Tracking && report.state == TrackingState::Lost;
        inner.last_state = report.state;
        let picture = inner
            .picture
            .take()
            .map(|picture| LiveImage { world_from_camera: report.world_from_camera, ..picture });
        let gatherer = &mut inner.gatherer;
        inner.shared.slot.leave(|pending| {
            gatherer.gather(deltas, map, pending);
            pending.loops.extend(report.closed_loop.map(|(newer, older)| [newer.0, older.0]));
            pending.picture = picture.or(pending.picture.take());
            pending.taken += 1;
            pending.tracked += u64::from(report.state == TrackingState::Tracking);
            pending.lost += u64::from(lost);
            let found = report.scale_break;
            pending.scale_breaks.extend(found.map(|of_scale| FoundBreak { frame, timestamp, of_scale }));
            pending.facts = Some(Facts { frame, timestamp, ms, latency_ms, dropped, report });
        });
    }

    /// Shows what was said of the map after the last frame.
    pub fn finished(&mut self, deltas: &[MapDelta], map: &Map) {
        let Some(inner) = &mut self.0 else { return };
        let gatherer = &mut inner.gatherer;
        inner.shared.slot.leave(|pending| gatherer.gather(deltas, map, pending));
    }

    /// Shows nothing of the run before any more: another one begins.
    pub fn restart(&mut self) {
        self.begin_anew();
        if let Some(inner) = &self.0 {
            inner.shared.slot.leave(|pending| {
                (pending.restarted, pending.lost) = (true, 0);
                pending.scale_breaks.clear();
            });
        }
    }

    /// Shows nothing of the map before any more: the run goes on in another one.
    pub fn begin_anew(&mut self) {
        let Some(inner) = &mut self.0 else { return };
        inner.gatherer = Gatherer::default();
        inner.last_state = TrackingState::Starting;
        inner.shared.slot.leave(|pending| {
            let kept = std::mem::take(pending);
            *pending = Pending {
                anew: true,
                taken: kept.taken,
                tracked: kept.tracked,
                lost: kept.lost,
                scale_breaks: kept.scale_breaks,
                restarted: kept.restarted,
                note: kept.note,
                paused: kept.paused,
                recording: kept.recording,
                folder: kept.folder,
                neighbourhood: kept.neighbourhood,
                ..Pending::default()
            };
        });
    }

    /// Says where results go.
    pub fn folder(&self, folder: &std::path::Path) {
        if let Some(inner) = &self.0 {
            inner.shared.slot.leave(|pending| pending.folder = Some(folder.display().to_string()));
        }
    }

    /// Something to tell viewers, from any thread.
    pub fn notifier(&self) -> impl Fn(String) + Send + 'static + use<> {
        let shared = self.0.as_ref().map(|inner| Arc::clone(&inner.shared));
        move |note| {
            if let Some(shared) = &shared {
                shared.slot.leave(|pending| pending.note = Some(note));
            }
        }
    }

    /// Shows who is near and what became of meeting them, from any thread.
    pub fn neighbourhood(&self) -> impl Fn(Neighbourhood) + Send + Sync + 'static + use<> {
        let shared = self.0.as_ref().map(|inner| Arc::clone(&inner.shared));
        move |near| {
            if let Some(shared) = &shared {
                shared.slot.leave(|pending| pending.neighbourhood = Some(near));
            }
        }
    }

    /// Lets viewers have the last of the run. What serves them ends with it, but for the page, which is its holder's to end.
    pub fn end(mut self, ended: Ended) {
        let Some(inner) = &mut self.0 else { return };
        if let (Some(page), Some(report)) = (&inner.page, ended.report) {
            page.offer_report(report);
        }
        inner.shared.slot.leave(|pending| {
            pending.note = Some(ended.note.to_owned());
            pending.report = inner.page.is_some() && ended.report.is_some();
        });
        inner.close();
    }
}

impl Inner {
    /// Lets the watcher take in what is left; nothing is new after it.
    fn close(&mut self) {
        if let Some(watcher) = self.watcher.take() {
            self.shared.slot.leave(|pending| pending.ended = true);
            // A panic of the thread was printed by itself; there is nobody left to tell.
            let _ = watcher.join();
            if self.page.is_none() {
                self.shared.over.store(true, Ordering::Release);
            }
            if let Some(server) = &self.server {
                server.hide();
            }
        }
    }

    fn pause(&mut self, paused: bool) {
        self.paused = paused;
        self.shared.slot.leave(|pending| pending.paused = Some(paused));
    }

    fn record(&mut self, on: bool) {
        let Some(recording) = &mut self.recording else { return };
        let note = match recording.set(on) {
            Ok(note) => note,
            Err(error) => format!("cannot record: {error:#}"),
        };
        let is_on = recording.is_on();
        self.shared.slot.leave(|pending| {
            pending.note = Some(note);
            pending.recording = Some(is_on);
        });
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // A run that ended by an error says nothing more.
        self.close();
    }
}
