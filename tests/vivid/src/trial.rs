//! A long trial of `loopbox agent` on the driver: kills, unplugging, stops and a full disk, one after another, and whether
//! the agent is back, within its limits, with all that had settled.

mod agent;

use crate::checks::{plug_in, sequence_of, unplug};
use crate::driver::Mode;
use crate::player::{Pace, Player};
use agent::{Agent, PLACE, beat, kept_bytes, keyframes_in};
use anyhow::{Context, Result, ensure};
use image::GrayImage;
use std::fs::{self, File};
use std::io::Write;
use std::path::PathBuf;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The word: always back within so many seconds.
const BACK: f64 = 5.0;
/// Pictures of the sequence, there and back again.
const PICTURES: usize = 90;
/// Pictures that are played at a time: more than come between two events.
const PLAYED: usize = 1350;
/// Seconds in which the agent has begun, and sees that there is room again.
const PATIENCE: f64 = 30.0;
/// As the service manager waits (`RestartSec`).
const RESTART: Duration = Duration::from_secs(1);
/// The disk, MiB, of which the agent may keep [`BUDGET`].
const DISK: u64 = 128;
/// MiB.
const BUDGET: u64 = 16;
/// MiB.
const MEMORY: u64 = 512;
/// What is recorded in the two seconds between two looks at the budget, and what is written at a session's end, MiB.
const BETWEEN_LOOKS: u64 = 6;

/// What is done to the agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Event {
    Kill,
    Unplug,
    Stop,
    Fill,
}

/// In turn.
const EVENTS: [Event; 6] = [Event::Kill, Event::Unplug, Event::Kill, Event::Fill, Event::Stop, Event::Unplug];

/// What was found of one kind of event.
#[derive(Default)]
struct EventCounts {
    count: u32,
    /// Seconds until frames were processed again, the longest.
    back: f64,
    /// Seconds until they had poses again, the longest, and how often that took longer than [`BACK`].
    tracking: f64,
    slow: u32,
}

/// What was found of the whole.
#[derive(Default)]
struct Trial {
    found: [EventCounts; 4],
    /// Largest memory and disk, bytes.
    memory: u64,
    disk: u64,
    /// Seconds that stopping took, the longest.
    stopping: f64,
    /// Keyframes that a killed session told and its file does not have, at the most.
    behind: u64,
    /// Starts that went on in the map of the session before, and those that could have.
    gone_on: (u32, u32),
    /// What broke a rule.
    broken: Vec<String>,
}

/// Runs it for so many minutes, with so many pictures a second.
///
/// # Errors
/// When a rule was broken, or the machine does not do what is asked of it.
pub fn run(minutes: f64, rate: f64) -> Result<()> {
    ensure!(minutes.is_finite() && minutes > 0.0, "{minutes} minutes are no time");
    ensure!(rate.is_finite() && rate > 0.0, "{rate} pictures a second are no rate");
    let (pictures, mode) = sequence_of(PICTURES)?;
    let mode = Mode { rate, ..mode };
    let there = pictures.iter().chain(pictures.iter().rev());
    let pictures: Vec<GrayImage> = there.cycle().take(PLAYED).cloned().collect();
    prepare()?;
    let (began, idle) = (Instant::now(), idle()?);
    let mut trial = Trial::default();
    let play = || Player::start(&pictures, &mode, Pace::PerSecond(rate));
    let mut player = Some(play()?);
    let mut agent = Agent::start()?;
    agent.wait("tracking", PATIENCE, |beat| beat["state"] == "tracking")?;
    for round in 0.. {
        if began.elapsed().as_secs_f64() > 60.0 * minutes {
            break;
        }
        // Not always at the same moment of the way, nor of a keyframe.
        trial.live(&mut agent, Duration::from_millis(8000 + 1370 * (round % 7)))?;
        let event = EVENTS[round as usize % EVENTS.len()];
        let (back, tracking) = match event {
            Event::Unplug => {
                unplug()?;
                // Its device is gone too.
                let _ = player.take().map(Player::stop);
                agent.wait("waiting", PATIENCE, |beat| beat["state"] == "waiting")?;
                sleep(Duration::from_secs(3));
                plug_in()?;
                let plugged = Instant::now();
                player = Some(play()?);
                agent.back(plugged)?
            }
            Event::Fill => trial.fill(&mut agent)?,
            Event::Kill | Event::Stop => {
                trial.end(event, &mut agent, || {
                    // The driver changes its format for nobody while it is captured from.
                    player.take().map(Player::stop).transpose()?;
                    player = Some(play()?);
                    Ok(())
                })?
            }
        };
        trial.note(event, began.elapsed(), back, tracking);
    }
    let (code, took) = agent.stop()?;
    ensure!(code == Some(0), "the last stop: {code:?}");
    trial.stopping = trial.stopping.max(took);
    player.map(Player::stop).transpose()?;
    let share = (self::idle()? - idle) / began.elapsed().as_secs_f64();
    trial.report(began.elapsed(), share / std::thread::available_parallelism()?.get() as f64)
}

/// Seconds that the processors have had nothing to do since the system started, all of them together.
fn idle() -> Result<f64> {
    let text = fs::read_to_string("/proc/uptime").context("/proc/uptime")?;
    text.split_whitespace().nth(1).and_then(|seconds| seconds.parse().ok()).context("/proc/uptime")
}

/// A disk of its own, and the agent's file.
fn prepare() -> Result<()> {
    fs::create_dir_all(PLACE)?;
    let size = format!("size={DISK}m");
    let mounted = Command::new("/bin/mount").args(["-t", "tmpfs", "-o", &size, "tmpfs", PLACE]).status()?;
    ensure!(mounted.success(), "no disk could be made");
    agent::write_file(BUDGET, MEMORY)
}

impl Trial {
    /// Looks at the agent while it works.
    fn live(&mut self, agent: &mut Agent, time: Duration) -> Result<()> {
        let began = Instant::now();
        while began.elapsed() < time {
            ensure!(agent.is_running()?, "the agent ended by itself:\n{}", agent::log());
            if let Some(beat) = beat() {
                self.memory = self.memory.max(beat["memory_bytes"].as_u64().unwrap_or_default());
            }
            self.disk = self.disk.max(kept_bytes());
            sleep(Duration::from_millis(250));
        }
        Ok(())
    }

    /// Ends the agent and starts it anew, with `meanwhile` between; seconds until frames come again, and until they have
    /// poses.
    fn end(
        &mut self,
        event: Event,
        agent: &mut Agent,
        meanwhile: impl FnOnce() -> Result<()>,
    ) -> Result<(f64, f64)> {
        let before = beat().context("no heartbeat")?;
        let folder = PathBuf::from(before["folder"].as_str().unwrap_or_default());
        if event == Event::Kill {
            agent.kill()?;
        } else {
            let (code, took) = agent.stop()?;
            self.stopping = self.stopping.max(took);
            if code != Some(0) || took > BACK {
                self.broken.push(format!("stopping took {took:.1} s and ended with {code:?}"));
            }
        }
        let died = Instant::now();
        // The file may be told of less keyframes than the heartbeat: those whose depth was not there yet.
        let described = before["keyframes"].as_u64().unwrap_or_default();
        let there = keyframes_in(&folder);
        self.behind = self.behind.max(described.saturating_sub(there.unwrap_or_default()));
        meanwhile()?;
        sleep(RESTART.saturating_sub(died.elapsed()));
        let started = Instant::now();
        *agent = Agent::start()?;
        // From the moment the process was gone, as a robot would count.
        let waited = (started - died).as_secs_f64().min(RESTART.as_secs_f64());
        let (back, tracking) = agent.back(started)?;
        let continues = beat().and_then(|beat| beat["continues"].as_str().map(PathBuf::from));
        self.gone_on.1 += u32::from(there.is_some());
        match continues {
            Some(map) if map.starts_with(&folder) => self.gone_on.0 += 1,
            other => self.broken.push(format!("{} was not gone on with, but {other:?}", folder.display())),
        }
        Ok((back + waited, tracking + waited))
    }

    /// The disk is full for a while.
    fn fill(&mut self, agent: &mut Agent) -> Result<(f64, f64)> {
        let path = format!("{PLACE}/others");
        let mut others = File::create(&path)?;
        while others.write_all(&[1; 1 << 16]).is_ok() {}
        let filled = Instant::now();
        let frames = beat().and_then(|beat| beat["frames"].as_u64()).unwrap_or_default();
        let mut was_reported = false;
        while filled.elapsed() < Duration::from_secs(10) {
            // What the agent deletes, others take.
            while others.write_all(&[1; 1 << 16]).is_ok() {}
            was_reported |= beat().is_some_and(|beat| beat["healthy"] == false);
            ensure!(agent.is_running()?, "the agent ended on a full disk:\n{}", agent::log());
            sleep(Duration::from_millis(100));
        }
        let later = beat().and_then(|beat| beat["frames"].as_u64()).unwrap_or_default();
        if later < frames + 3 {
            self.broken.push(format!("on a full disk {} frames were processed in 10 s", later - frames));
        }
        if !was_reported {
            self.broken.push("the heartbeat says nothing of a full disk".into());
        }
        drop(others);
        fs::remove_file(path)?;
        let freed = Instant::now();
        agent.wait("well", PATIENCE, |beat| beat["healthy"] == true)?;
        let seconds = freed.elapsed().as_secs_f64();
        Ok((seconds, seconds))
    }

    fn note(&mut self, event: Event, at: Duration, back: f64, tracking: f64) {
        let found = &mut self.found[event as usize];
        found.count += 1;
        found.back = found.back.max(back);
        found.tracking = found.tracking.max(tracking);
        found.slow += u32::from(tracking > BACK);
        let minute = at.as_secs_f64() / 60.0;
        println!("{minute:5.1} min, {event:?}: back after {back:.1} s, tracking after {tracking:.1} s");
        if back > BACK {
            self.broken.push(format!("{event:?}: back after {back:.1} s"));
        }
    }

    fn report(mut self, took: Duration, idle: f64) -> Result<()> {
        let mib = |bytes: u64| bytes >> 20;
        let beat = beat().context("no heartbeat")?;
        println!("{:.0} minutes, idle for {:.0} %:", took.as_secs_f64() / 60.0, 100.0 * idle);
        for event in [Event::Kill, Event::Unplug, Event::Stop, Event::Fill] {
            let EventCounts { count, back, tracking, slow } = self.found[event as usize];
            println!(
                "{event:?}: {count} times, back within {back:.1} s, tracking within {tracking:.1} s ({slow} later than {BACK} s)"
            );
        }
        let (on, starts) = self.gone_on;
        println!("stopping took {:.1} s at the most", self.stopping);
        println!(
            "{on} of {starts} starts went on in the map before; files of ended sessions lacked {} keyframes at the most",
            self.behind
        );
        println!("disk {} MiB of {BUDGET}, memory {} MiB of {MEMORY}", mib(self.disk), mib(self.memory));
        println!(
            "the last session: {} of {} frames tracked, {} keyframes",
            beat["tracked"], beat["frames"], beat["keyframes"]
        );
        if mib(self.disk) > BUDGET + BETWEEN_LOOKS {
            self.broken.push(format!("{} MiB were kept of {BUDGET}", mib(self.disk)));
        }
        if mib(self.memory) > MEMORY + 32 {
            self.broken.push(format!("{} MiB of memory of {MEMORY}", mib(self.memory)));
        }
        ensure!(self.broken.is_empty(), "{}", self.broken.join("\n"));
        Ok(())
    }
}
