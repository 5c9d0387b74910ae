//! Many agents at one station, all of them in this process and each with keys of its own: what they cost the station, and how long a
//! version of a map takes until the station holds it, alone and beside peers that flood it.
//!
//! `cargo run --release -p loopbox-fleet --example many_agents -- PROGRAM MAPS AGENTS SECONDS FLOODERS ROOM`: the `loopbox` whose station is
//! measured, a folder of maps (the agents take them in turns), and a folder that is made. Every agent tells a version a second: at first
//! half of its keyframes, then one more each time, and then others' poses.

mod flood;
mod station;

use anyhow::{Context, Result, bail};
use fleet::keys::{Authority, Keys, Validity};
use fleet::node::{Notice, Quota};
use fleet::publishing::Publisher;
use fleet::service::{Service, ServiceOptions};
use fleet::transport::Endpoint;
use fleet::wire::Role;
use map::{AgentId, Identity, Map, Uuid, load_map};
use station::Station;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Time between versions of a map.
const EVERY: Duration = Duration::from_secs(1);
/// How long all agents may take to be held once, and what comes last to be held.
const PATIENCE: Duration = Duration::from_secs(60);

/// What an agent received of the station.
#[derive(Default)]
struct Received {
    /// When each version was published that the station does not hold yet.
    pending: BTreeMap<(u64, u64), Instant>,
    /// Seconds that versions took until the station held them.
    held: Vec<f64>,
    /// When the agent heard first where it is.
    placed: Option<Instant>,
    /// Links that ended, and what was refused.
    broken: usize,
}

/// An agent at work.
struct Agent {
    map: Map,
    publisher: Publisher,
    keyframes: usize,
    service: Service,
    received: Arc<Mutex<Received>>,
}

impl Agent {
    /// One that dials `station` with its keys.
    fn start(number: usize, map: &Path, station: &Endpoint, keys: &Path, room: &Path) -> Result<Self> {
        let mut map = load_map(map)?.map;
        let identity = Identity { uuid: Uuid::from_u128(number as u128 + 1), epoch: 0 };
        let info = map.agents.get_mut(&AgentId::default()).context("a map of no agent")?;
        (info.identity, info.name) = (Some(identity), format!("agent-{number}"));
        let received = Arc::<Mutex<Received>>::default();
        let of_thread = Arc::clone(&received);
        let name = format!("\"agent\":\"{identity}\"");
        let options = ServiceOptions {
            folder: room.join(format!("agent-{number}")),
            name: format!("agent-{number}"),
            role: Role::Agent,
            listen: None,
            dial: vec![station.clone()],
            quota: Quota::default(),
            waits: true,
            keys: Some(Keys::open(keys)?),
        };
        let service =
            Service::start(options, move |notice| receive(&mut locked(&of_thread), &name, &notice))?;
        let begun = SystemTime::now().duration_since(UNIX_EPOCH)?.as_millis() as u64;
        let keyframes = map.keyframes.len().div_ceil(2);
        Ok(Self { map, publisher: Publisher::new(identity, begun), keyframes, service, received })
    }

    /// Tells the next version.
    fn publish(&mut self) -> Result<()> {
        if self.keyframes < self.map.keyframes.len() {
            self.keyframes += 1;
        } else {
            let moved = self.map.keyframes.values_mut();
            moved.for_each(|keyframe| keyframe.world_from_keyframe.translation.x += 1e-4);
        }
        let mut part = self.map.clone();
        let end = part.keyframes.keys().nth(self.keyframes).map_or(u32::MAX, |id| id.0);
        part.keyframes.retain(|id, _| id.0 < end);
        part.drop_dangling();
        if let Some(publication) = self.publisher.publish(&part, false)? {
            locked(&self.received).pending.insert(publication.version.order(), Instant::now());
            self.service.publish(publication);
        }
        Ok(())
    }
}

/// What an agent, which findings call `name`, makes of what it hears.
fn receive(received: &mut Received, name: &str, notice: &Notice) {
    match notice {
        // A version that is held says so of those before it.
        Notice::Stored { version, .. } => {
            let later = received.pending.split_off(&(version.0, version.1 + 1));
            let held = std::mem::replace(&mut received.pending, later);
            received.held.extend(held.values().map(|sent_at| sent_at.elapsed().as_secs_f64()));
        }
        Notice::Results { bytes, .. } if received.placed.is_none() => {
            let is_named = bytes.windows(name.len()).any(|part| part == name.as_bytes());
            received.placed = is_named.then(Instant::now);
        }
        Notice::Disconnected { .. } | Notice::Trouble(_) => received.broken += 1,
        _ => {}
    }
}

fn locked(received: &Mutex<Received>) -> std::sync::MutexGuard<'_, Received> {
    // Every section leaves it whole.
    received.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The maps in a folder, by their names.
fn maps(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let mut maps: Vec<PathBuf> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
    maps.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    maps.sort();
    if maps.is_empty() {
        bail!("{}: holds no map", folder.display());
    }
    Ok(maps)
}

/// Keys of a peer of this name.
fn keys(authority: &Authority, name: &str, room: &Path) -> Result<PathBuf> {
    let folder = room.join("keys").join(name);
    authority.issue(name, Validity::days(1)?, &folder)?;
    Ok(folder)
}

/// The value below which this share of all lies.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted.get((share * sorted.len() as f64) as usize).or(sorted.last()).copied().unwrap_or(f64::NAN)
}

/// Has all agents tell versions for so many seconds, in turns within each second.
fn tell(agents: &mut [Agent], seconds: u64) -> Result<()> {
    let (begun, step) = (Instant::now(), EVERY / agents.len() as u32);
    for turn in 0..seconds as u32 {
        for (number, agent) in agents.iter_mut().enumerate() {
            let due = EVERY * turn + step * number as u32;
            std::thread::sleep(due.saturating_sub(begun.elapsed()));
            agent.publish()?;
        }
    }
    Ok(())
}

/// Waits until all agents say so; how many do.
fn wait_for(agents: &[Agent], is_so: impl Fn(&Received) -> bool) -> usize {
    let begun = Instant::now();
    loop {
        let count = agents.iter().filter(|agent| is_so(&locked(&agent.received))).count();
        if count == agents.len() || begun.elapsed() > PATIENCE {
            return count;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Prints what the agents waited since this was called last.
fn report(agents: &[Agent], what: &str, spent: Duration) {
    let mut held: Vec<f64> =
        agents.iter().flat_map(|agent| std::mem::take(&mut locked(&agent.received).held)).collect();
    held.sort_by(f64::total_cmp);
    let broken: usize = agents.iter().map(|agent| locked(&agent.received).broken).sum();
    let [p50, p99] = [0.5, 0.99].map(|share| quantile(&held, share));
    println!(
        "{what}: {} versions in {:.1} s, held after {p50:.3} s (p50), {p99:.3} s (p99); {broken} links broke or were refused so far",
        held.len(),
        spent.as_secs_f64()
    );
}

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [program, folder, count, seconds, flooders, room] = &args[..] else {
        bail!("usage: many_agents PROGRAM MAPS AGENTS SECONDS FLOODERS ROOM")
    };
    let (count, seconds): (usize, u64) = (count.parse()?, seconds.parse()?);
    let (flooders, room): (usize, &Path) = (flooders.parse()?, room.as_ref());
    let authority = Authority::init(&room.join("authority"))?;
    let station =
        Station::start(program.as_ref(), &keys(&authority, "station", room)?, &room.join("station"))?;
    let maps = maps(folder.as_ref())?;
    let start = |number: usize| {
        let own = keys(&authority, &format!("agent-{number}"), room)?;
        Agent::start(number, &maps[number % maps.len()], station.address(), &own, room)
    };
    let mut agents = (0..count).map(start).collect::<Result<Vec<Agent>>>()?;
    let begun = Instant::now();
    tell(&mut agents, 1)?;
    let held = wait_for(&agents, |received| received.pending.is_empty());
    println!("{held} of {count} agents held once after {:.1} s", begun.elapsed().as_secs_f64());
    report(&agents, "first", begun.elapsed());
    let measured = |agents: &mut [Agent], what: &str| -> Result<()> {
        let (begun, before) = (Instant::now(), station.cpu()?);
        tell(agents, seconds)?;
        station.print(&before, begun.elapsed())?;
        wait_for(agents, |received| received.pending.is_empty());
        report(agents, what, begun.elapsed());
        Ok(())
    };
    measured(&mut agents, "alone")?;
    if flooders > 0 {
        let flood = flood::Flood::start(flooders, station.address(), |name| keys(&authority, name, room))?;
        measured(&mut agents, "beside a flood")?;
        println!("flood: {}", flood.end());
    }
    let placed = wait_for(&agents, |received| received.placed.is_some());
    println!(
        "{placed} of {count} agents told their place, {:.1} s after they began",
        begun.elapsed().as_secs_f64()
    );
    Ok(())
}
