//! One session after another, until the user stops the agent, its recording ends, or memory asks for a new process.

use super::config::AgentConfig;
use super::heartbeat::State;
use super::housekeeping::Housekeeping;
use super::page::Page;
use super::pairing::Pairing;
use super::pulse::Pulse;
use super::resuming::{MapToResume, find_map};
use super::sessions::{Session, Sessions};
use super::vitals::{Report, SessionProgress, Vitals, Why};
use crate::open::recording_name;
use crate::results::is_of_the_disk;
use crate::run::{PreparedRun, Recording, RunOptions};
use crate::{Level, explained};
use anyhow::{Context, Error, Result};
use slam_direct::Params;
use sources::ahead::Pace;
use sources::camera::{CameraArgs, open_camera};
use sources::{FrameSource, SourceOptions, Stop};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often a camera that is not there is looked for.
const SEARCH: Duration = Duration::from_millis(500);
/// How long is waited after a session that failed; twice as long after each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// No longer than this: an agent is to be back within seconds.
const LONGEST_PAUSE: Duration = Duration::from_secs(4);
/// Frames of a session that went well.
const WENT_WELL: u64 = 100;
/// How soon a wish to stop is noticed.
const LOOK: Duration = Duration::from_millis(20);
/// The share of the memory's limit that a map may take from the beginning and be gone on with all the same, when a
/// session has come to the limit. Above, it would be there again before long.
const LARGE_MAP: f64 = 0.6;

/// Why an agent ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Over {
    /// The user stopped it.
    Stopped,
    /// Its recording has ended.
    SourceEnded,
    /// A session came to the limit of memory; it is saved, and a new process goes on with all memory given back.
    Memory,
}

/// What the sessions of an agent have in common.
struct Agent<'a> {
    config: &'a AgentConfig,
    camera: Option<CameraArgs>,
    params: Params,
    sessions: Arc<Sessions>,
    vitals: Arc<Vitals>,
    house: Arc<Housekeeping>,
    page: Page,
    pairing: Pairing,
    stop: &'a Stop,
    /// Sessions whose maps cannot be gone on with, though they can be read.
    passed: BTreeSet<u32>,
}

/// Runs an agent that nobody looks after: session after session, each in a folder of its own in `out`, going on in the map
/// of the one before. `report` tells people what happens.
///
/// # Errors
/// When what the file names is not there or cannot be used; not for what may pass, such as a camera that is unplugged. That
/// of a recording also when nothing of it could be tracked.
pub fn supervise(config: &AgentConfig, stop: &Stop, report: Report) -> Result<Over> {
    let (camera, params) = (config.camera()?, config.parameters()?);
    let sessions = Arc::new(Sessions::open(&config.out)?);
    let name = config.name.clone().unwrap_or_else(|| match (&config.camera, &config.recording) {
        (Some(camera), _) => recording_name(&camera.device),
        (None, Some(recording)) => recording_name(&recording.path),
        (None, None) => "agent".into(),
    });
    let vitals = Vitals::new(name.clone(), report);
    let house = Housekeeping::new(config, &sessions, &vitals);
    house.use_only(sessions.newest_with_map());
    house.make_room();
    let page = Page::start(config.page.as_ref(), &vitals)?;
    let pairing = Pairing::start(config, &name, &vitals)?;
    let memory_limit = config.limits.memory_mib << 20;
    let pulse = Pulse::start(&vitals, config.heartbeat(), memory_limit, stop);
    let pulse = pulse.context("cannot start a thread")?;
    let keeper = house.start().context("cannot start a thread")?;
    let passed = BTreeSet::new();
    let mut agent = Agent { config, camera, params, sessions, vitals, house, page, pairing, stop, passed };
    let over = agent.run();
    agent.vitals.enter(State::Ended);
    drop(keeper);
    drop(pulse);
    if matches!(over, Ok(Over::Stopped | Over::Memory)) {
        agent.pairing.abandon();
    }
    over
}

impl Agent<'_> {
    fn run(&mut self) -> Result<Over> {
        let mut failures = 0;
        loop {
            let Some(source) = self.source()? else { return Ok(Over::Stopped) };
            let passed = self.passed.len();
            let ended = self.session(source);
            let begins_anew = self.passed.len() > passed;
            self.pairing.end_session();
            let (why, frames) = {
                let now = self.vitals.now();
                (now.why, now.session_frames)
            };
            if self.stop.requested() {
                if let Err(error) = ended {
                    self.vitals.report(Level::Error, &explained(&error));
                }
                return Ok(Over::Stopped);
            }
            match (ended, why) {
                (_, Some(Why::Memory)) => {
                    self.leave_what_is_too_large();
                    return Ok(if self.stop.requested() { Over::Stopped } else { Over::Memory });
                }
                (ended, None) if self.config.recording.is_some() && !begins_anew => {
                    return ended.map(|()| Over::SourceEnded);
                }
                (ended, Some(Why::Disk)) => {
                    let session = self.vitals.now().beat.session;
                    self.sessions.keep_history(&self.sessions.history().without_maps_until(session));
                    let outcome = ended.map_or_else(|error| explained(&error), |()| "it is saved".into());
                    self.vitals.trouble(&format!(
                        "the map of session {session} takes all of limits.disk_mib, a new one is begun: {outcome}"
                    ));
                }
                (Ok(()), _) => failures = 0,
                (Err(error), _) => {
                    failures = if frames >= WENT_WELL { 1 } else { failures + 1 };
                    self.vitals.trouble(&explained(&error));
                    self.vitals.enter(State::Failing);
                    self.wait(pause_after(failures));
                }
            }
        }
    }

    /// The camera, once it is there, or the recording; nothing once the user wishes to stop.
    fn source(&self) -> Result<Option<Box<dyn FrameSource>>> {
        if let Some(recording) = &self.config.recording {
            return sources::open(&recording.path, &SourceOptions::default()).map(Some);
        }
        let Some(camera) = &self.camera else { return Ok(None) };
        while !self.stop.requested() {
            match open_camera(camera) {
                Ok(source) => return Ok(Some(source)),
                Err(error) => self.vitals.wait_for(&explained(&error)),
            }
            self.wait(SEARCH);
        }
        Ok(None)
    }

    /// One session, from a source that is open to a map on the disk.
    fn session(&mut self, source: Box<dyn FrameSource>) -> Result<()> {
        let session = self.sessions.next();
        let found = self.map_to_resume();
        let continues = found.as_ref().map(|found| found.resume.map.as_path());
        let stop = self.vitals.begin(session.number, &session.folder, continues);
        let before = found.as_ref().map(|found| found.session.folder.clone());
        self.house.use_only([session.folder.clone()].into_iter().chain(before));
        self.house.make_room();
        let gone_on = found.as_ref().map(|found| found.session.number);
        let ended = self.map(source, &session, found, &stop);
        self.vitals.now().button = None;
        if let (Err(error), Some(number)) = (&ended, gone_on)
            && self.vitals.now().session_frames == 0
            && !is_of_the_disk(error)
        {
            // It is kept; the next session begins a map of its own.
            self.passed.insert(number);
        }
        self.house.use_only(self.sessions.newest_with_map());
        if !self.stop.requested() {
            self.house.make_room();
        }
        ended
    }

    fn map_to_resume(&self) -> Option<MapToResume> {
        self.config
            .map
            .resumes
            .then(|| {
                let most = (self.config.limits.disk_mib << 20) / 2;
                find_map(&self.sessions, &self.passed, most, &self.vitals)
            })
            .flatten()
    }

    fn map(
        &self,
        source: Box<dyn FrameSource>,
        session: &Session,
        found: Option<MapToResume>,
        stop: &Stop,
    ) -> Result<()> {
        let realtime = self.config.recording.as_ref().is_some_and(|recording| recording.realtime);
        let mut options = RunOptions {
            name: Some(self.vitals.now().beat.name.clone()),
            camera: self.config.camera_options(),
            params: self.params.clone(),
            pace: if realtime { Pace::RealTime { speed: 1.0 } } else { Pace::EveryFrame },
            rate: self.config.camera.as_ref().and_then(|camera| camera.fps),
            resume: found.map(|found| found.resume),
            features: self.config.map.features,
            unattended: true,
            swap: Some(self.house.swap_for(session)),
            ..RunOptions::to(&session.folder)
        };
        let begun = || self.sessions.keep_history(&self.sessions.history().read());
        let progress = SessionProgress { vitals: &self.vitals, begun: &begun };
        if let Some(recording) = &self.config.recording {
            let again = Recording { path: recording.path.clone(), options: SourceOptions::default() };
            options.without_calibration(source.info(), again, None, stop, &progress)?;
        }
        let run = PreparedRun::new(source, options)?;
        run.problems().iter().for_each(|problem| self.vitals.report(Level::Warn, problem));
        let run = self.pairing.publish_run(run)?;
        let watched = |about: &_, frames, button| {
            self.vitals.now().button = Some(button);
            let watch = self.page.show(about, frames)?;
            self.pairing.show_on(&watch);
            self.vitals.now().beat.last_error.clone().map(watch.notifier());
            Ok(watch)
        };
        let mapped = run.go(watched, stop, &progress)?;
        mapped.apart.iter().for_each(|apart| self.vitals.report(Level::Warn, apart));
        match mapped.failure {
            Some(failure) => Err(Error::msg(failure)),
            None => Ok(()),
        }
    }

    /// A map that takes most of the memory from the beginning is not gone on with.
    fn leave_what_is_too_large(&self) {
        let now = self.vitals.now();
        let limit = self.config.limits.memory_mib as f64 * f64::from(1 << 20);
        let is_large = now.first_memory.is_some_and(|first| first as f64 > LARGE_MAP * limit);
        let (session, frames, limit) = (now.beat.session, now.session_frames, self.config.limits.memory_mib);
        drop(now);
        if is_large {
            self.sessions.keep_history(&self.sessions.history().without_maps_until(session));
        }
        let next = if is_large { "a new map is begun" } else { "the next session goes on in its map" };
        self.vitals.report(
            Level::Info,
            &format!("memory has come to limits.memory_mib = {limit}: session {session} is saved, {next}"),
        );
        if frames < WENT_WELL {
            self.vitals.trouble(&format!("limits.memory_mib = {limit} is too little for a map to grow"));
            self.vitals.enter(State::Failing);
            self.wait(LONGEST_PAUSE);
        }
    }

    /// Waits, but not once the user wishes to stop.
    fn wait(&self, time: Duration) {
        let began = Instant::now();
        while began.elapsed() < time && !self.stop.requested() {
            std::thread::sleep(LOOK);
        }
    }
}

/// How long is waited after so many failures in a row.
fn pause_after(failures: u32) -> Duration {
    FIRST_PAUSE.saturating_mul(1 << failures.saturating_sub(1).min(16)).min(LONGEST_PAUSE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_to_seconds_and_no_further() {
        let pauses: Vec<u128> = (1..7).map(|failures| pause_after(failures).as_millis()).collect();
        assert_eq!(pauses, [500, 1000, 2000, 4000, 4000, 4000]);
        assert_eq!(pause_after(u32::MAX), LONGEST_PAUSE);
    }
}
