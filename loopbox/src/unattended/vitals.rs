//! What is known of a running agent at any moment: what its threads tell, and what the heartbeat is made of.

use super::heartbeat::{Heartbeat, State};
use crate::Level;
use crate::run::{FrameRow, Progress, RunRecord};
use slam_direct::TrackingState;
use sources::Stop;
use sources::notice::Notice;
use sources::recording::RecordButton;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Tells people what happens.
pub type Report = Arc<dyn Fn(Level, &str) + Send + Sync>;

/// Why a session is ended before its source ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// The user wishes the agent to stop.
    Stop,
    /// Memory has reached its limit.
    Memory,
    /// The map in use does not fit into the disk's budget.
    Disk,
}

/// What is known.
pub struct Now {
    /// Numbers and words of the heartbeat, but for those that are asked for when it is written.
    pub beat: Heartbeat,
    /// When anything was last heard of the session.
    pub last_activity: Instant,
    /// When the last frame was processed.
    pub last_frame: Option<Instant>,
    /// Frames processed in this session.
    pub session_frames: u64,
    /// Resident memory when the session had processed its first frame: what its map took from the beginning.
    pub first_memory: Option<u64>,
    /// Ends the session.
    pub session: Stop,
    /// Why it is to end.
    pub why: Option<Why>,
    /// Begins and ends recording, while a session runs.
    pub button: Option<RecordButton>,
    /// Why the camera is waited for.
    pub waits_for: Option<String>,
    /// Whether the map waits in memory for room on the disk.
    pub waits_for_room: bool,
    /// What the disk's budget says, for people.
    pub disk_trouble: Option<String>,
    was_tracking: bool,
    loss: Option<Loss>,
}

/// A time without a pose, in a session that had one.
struct Loss {
    since: Instant,
    is_reported: bool,
}

/// A loss is reported after so long: shorter ones are every day's.
const LONG_LOSS: Duration = Duration::from_secs(3);

/// Shared by all threads of the agent.
pub struct Vitals {
    now: Mutex<Now>,
    started: Instant,
    report: Report,
}

impl Vitals {
    /// An agent of this name that has just started.
    pub fn new(name: String, report: Report) -> Arc<Self> {
        let now = Now {
            beat: Heartbeat { name, process: std::process::id(), ..Heartbeat::default() },
            last_activity: Instant::now(),
            last_frame: None,
            session_frames: 0,
            first_memory: None,
            session: Stop::default(),
            why: None,
            button: None,
            waits_for: None,
            waits_for_room: false,
            disk_trouble: None,
            was_tracking: false,
            loss: None,
        };
        Arc::new(Self { now: Mutex::new(now), started: Instant::now(), report })
    }

    /// What is known now.
    pub fn now(&self) -> MutexGuard<'_, Now> {
        // Every section leaves it whole.
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells people.
    pub fn report(&self, level: Level, text: &str) {
        (self.report)(level, text);
    }

    /// Something went wrong: tells people, and keeps it for the heartbeat.
    pub fn trouble(&self, text: &str) {
        self.report(Level::Warn, text);
        self.now().beat.last_error = Some(text.to_owned());
    }

    /// The agent does this now.
    pub fn enter(&self, state: State) {
        self.now().enter(state);
    }

    /// The camera is not there.
    pub fn wait_for(&self, why: &str) {
        let is_new = {
            let mut now = self.now();
            now.enter(State::Waiting);
            now.waits_for.replace(why.to_owned()).as_deref() != Some(why)
        };
        if is_new {
            self.trouble(why);
        }
    }

    /// A session begins.
    pub fn begin(&self, number: u32, folder: &Path, continues: Option<&Path>) -> Stop {
        let mut now = self.now();
        now.enter(State::Starting);
        now.beat.session = number;
        now.beat.sessions += 1;
        now.beat.folder = folder.display().to_string();
        now.beat.continues = continues.map(|map| map.display().to_string());
        (now.beat.dropped, now.beat.missed, now.beat.keyframes) = (0, 0, 0);
        (now.session_frames, now.first_memory, now.why) = (0, None, None);
        (now.waits_for, now.waits_for_room, now.was_tracking) = (None, false, false);
        (now.session, now.loss) = (Stop::default(), None);
        let session = now.session.clone();
        drop(now);
        let map =
            continues.map_or("with a new map".into(), |map| format!("and goes on in {}", map.display()));
        self.report(Level::Info, &format!("session {number} begins in {} {map}", folder.display()));
        session
    }

    /// Ends the session, for the first reason that is given.
    pub fn end_session(&self, why: Why) {
        let mut now = self.now();
        now.why.get_or_insert(why);
        now.session.request();
    }

    /// The heartbeat as it stands.
    pub fn heartbeat(&self) -> Heartbeat {
        let now = self.now();
        let up_s = self.started.elapsed().as_secs_f64();
        let last_frame_s = now.last_frame.map(|last| last.elapsed().as_secs_f64());
        let trouble = now.trouble();
        Heartbeat { up_s, last_frame_s, healthy: trouble.is_empty(), trouble, ..now.beat.clone() }.now()
    }
}

impl Now {
    fn enter(&mut self, state: State) {
        (self.beat.state, self.last_activity) = (state, Instant::now());
    }

    /// What is to be reported of losses with a frame of this state.
    fn follow_losses(&mut self, state: TrackingState) -> Option<String> {
        match (state, &mut self.loss) {
            (TrackingState::Lost, None) => {
                self.loss = Some(Loss { since: Instant::now(), is_reported: false });
                None
            }
            (TrackingState::Lost, Some(loss)) if !loss.is_reported && loss.since.elapsed() >= LONG_LOSS => {
                loss.is_reported = true;
                Some(format!("tracking has been lost for {:.0} s", loss.since.elapsed().as_secs_f64()))
            }
            (TrackingState::Tracking, Some(_)) => {
                let loss = self.loss.take().filter(|loss| loss.is_reported)?;
                Some(format!(
                    "tracking again, after {:.0} s without a pose",
                    loss.since.elapsed().as_secs_f64()
                ))
            }
            _ => None,
        }
    }

    /// What is wrong, for people.
    fn trouble(&self) -> Vec<String> {
        let silent = self.last_activity.elapsed();
        let of_state = match self.beat.state {
            State::Waiting => self.waits_for.clone().or(Some("the camera is not there".into())),
            State::Failing => self.beat.last_error.clone().or(Some("the last session failed".into())),
            State::Ended => Some("it has ended".into()),
            state if !state.is_alive_after(silent) => {
                Some(format!("nothing was heard of it for {:.0} s", silent.as_secs_f64()))
            }
            _ => None,
        };
        let of_disk = self
            .waits_for_room
            .then(|| "the disk is full: the map grows in memory until there is room".into());
        of_state.into_iter().chain(of_disk).chain(self.disk_trouble.clone()).collect()
    }
}

/// The progress of a session, for the vitals.
pub struct SessionProgress<'a> {
    /// Where it is kept.
    pub vitals: &'a Vitals,
    /// Is called with the first frame of the session.
    pub begun: &'a dyn Fn(),
}

impl Progress for SessionProgress<'_> {
    fn frame(&self, row: &FrameRow, keyframes: usize, _points: usize) {
        let (is_first, of_losses) = {
            let mut now = self.vitals.now();
            now.enter(match row.state {
                TrackingState::Starting => State::Initialising,
                TrackingState::Tracking => State::Tracking,
                TrackingState::Lost => State::Lost,
            });
            let is_tracked = row.state == TrackingState::Tracking;
            now.last_frame = Some(now.last_activity);
            now.session_frames += 1;
            now.beat.frames += 1;
            now.beat.tracked += u64::from(is_tracked);
            now.beat.losses += u64::from(now.was_tracking && row.state == TrackingState::Lost);
            now.was_tracking = is_tracked;
            now.beat.keyframes = keyframes as u64;
            (now.session_frames == 1, now.follow_losses(row.state))
        };
        of_losses.iter().for_each(|text| self.vitals.report(Level::Warn, text));
        if is_first {
            self.vitals.now().first_memory = view::process::memory_bytes();
            (self.begun)();
        }
    }

    fn lost(&self, dropped: u64, missed: u64) {
        let mut now = self.vitals.now();
        (now.beat.dropped, now.beat.missed) = (dropped, missed);
    }

    fn notice(&self, notice: &Notice) {
        match notice {
            Notice::Gone(text) => self.vitals.wait_for(text),
            Notice::Back(text) => {
                {
                    let mut now = self.vitals.now();
                    now.waits_for = None;
                    now.enter(State::Starting);
                }
                self.vitals.report(Level::Info, text);
            }
            Notice::Warning(text) => self.warn(text),
            Notice::Note(text) => self.vitals.report(Level::Info, text),
        }
    }

    fn warn_of(&self, kind: &str, text: &str) {
        if kind == "disk" {
            self.vitals.now().waits_for_room = true;
        }
        self.warn(text);
    }

    fn note_of(&self, kind: &str, text: &str) {
        if kind == "disk" {
            self.vitals.now().waits_for_room = false;
        }
        self.note(text);
    }

    fn warn(&self, text: &str) {
        self.vitals.trouble(text);
    }

    fn note(&self, text: &str) {
        self.vitals.report(Level::Info, text);
    }

    fn stage(&self, text: &str) {
        self.vitals.report(Level::Debug, text);
        self.vitals.enter(State::Saving);
    }

    fn mapped(&self, record: &RunRecord, folder: &Path) {
        let (frames, keyframes) = (&record.frames, record.map.keyframes);
        let (folder, tracked) = (folder.display(), frames.tracked);
        let taken = frames.offered - frames.dropped_late;
        let text = format!("{folder}: {tracked} of {taken} frames tracked, {keyframes} keyframes");
        self.vitals.report(Level::Info, &text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trouble_is_reported_and_forgotten() {
        let vitals = Vitals::new("one".into(), Arc::new(|_, _| {}));
        let nothing = || {};
        let progress = SessionProgress { vitals: &vitals, begun: &nothing };
        assert!(vitals.heartbeat().healthy);
        progress.notice(&Notice::Gone("the camera was unplugged".into()));
        let beat = vitals.heartbeat();
        assert_eq!((beat.state, beat.healthy), (State::Waiting, false));
        assert_eq!(beat.trouble, ["the camera was unplugged"]);
        progress.notice(&Notice::Back("the camera is back".into()));
        assert!(vitals.heartbeat().healthy);
        progress.warn_of("disk", "the disk is full");
        assert!(vitals.heartbeat().trouble[0].contains("the disk is full"));
        progress.note_of("disk", "there is room");
        let beat = vitals.heartbeat();
        assert!(beat.healthy && beat.last_error.as_deref() == Some("the disk is full"));
    }

    #[test]
    fn the_log_says_when_a_session_begins_and_when_tracking_is_lost_for_long() {
        let lines = Arc::new(Mutex::new(Vec::new()));
        let log = Arc::clone(&lines);
        let vitals =
            Vitals::new("one".into(), Arc::new(move |_, text| log.lock().unwrap().push(text.to_owned())));
        vitals.begin(2, Path::new("out/000002"), Some(Path::new("out/000001/map.mcap")));
        let mut now = vitals.now();
        assert_eq!(now.follow_losses(TrackingState::Lost), None, "it may be found at once");
        now.loss.as_mut().unwrap().since -= LONG_LOSS;
        assert_eq!(now.follow_losses(TrackingState::Lost).as_deref(), Some("tracking has been lost for 3 s"));
        assert_eq!(now.follow_losses(TrackingState::Lost), None, "once is enough");
        let found = now.follow_losses(TrackingState::Tracking);
        assert_eq!(found.as_deref(), Some("tracking again, after 3 s without a pose"));
        assert_eq!(
            (now.follow_losses(TrackingState::Lost), now.follow_losses(TrackingState::Tracking)),
            (None, None)
        );
        let begun = "session 2 begins in out/000002 and goes on in out/000001/map.mcap";
        assert_eq!(*lines.lock().unwrap(), [begun]);
    }

    #[test]
    fn the_first_reason_to_end_a_session_counts() {
        let vitals = Vitals::new("one".into(), Arc::new(|_, _| {}));
        let stop = vitals.begin(1, Path::new("000001"), None);
        vitals.end_session(Why::Memory);
        vitals.end_session(Why::Stop);
        assert!(stop.requested());
        assert_eq!(vitals.now().why, Some(Why::Memory));
        assert!(!vitals.begin(2, Path::new("000002"), None).requested());
    }
}
