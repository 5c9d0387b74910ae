//! Programs killed at seeded moments.

use super::super::{Plan, status};
use super::{Yard, end};
use anyhow::{Result, ensure};
use geometry::Random;
use measuring::median;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Sessions that they are spread over at the most.
const SESSIONS: u64 = 40;
/// Kills in a session at the most: it comes to an end afterwards.
const KILLS_A_SESSION: usize = 10;
/// Seconds from one kill to the next, whose logarithm is drawn evenly: from before a program listens to after all is there.
const GAPS: [f64; 2] = [0.05, 5.0];

/// The manifests of maps that are whole in a folder of objects, by the names of their files.
fn heads(folder: &Path) -> Result<Vec<(String, String)>> {
    let mut heads = Vec::new();
    for file in fs::read_dir(folder.join("fleet/heads")).into_iter().flatten() {
        let path = file?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let text = fs::read_to_string(&path)?;
        heads.push((name, text.split_whitespace().next().unwrap_or_default().to_owned()));
    }
    Ok(heads)
}

/// Whether an agent was told that the station holds all of its map.
fn is_stored(agent: &Path) -> bool {
    let output = status(agent);
    output.is_some_and(|output| output["links"][0]["lacks"] == 0 && output["links"][0]["address"].is_string())
}

/// Kills at seeded moments of the station or an agent.
pub(super) fn killed(plan: &Plan, maps: &[PathBuf]) -> Result<[String; 3]> {
    let bytes_alone = session(plan, maps, 0, 0)?.bytes;
    let (mut kills, mut sessions, mut same, mut checked, mut lost, mut bytes) = (0, 0, 0, 0, 0, Vec::new());
    for seed in 1..=SESSIONS {
        if kills >= plan.kills {
            break;
        }
        let session = session(plan, maps, seed, KILLS_A_SESSION.min(plan.kills - kills))?;
        kills += session.kills;
        sessions += 1;
        same += usize::from(session.is_same);
        checked += session.checked;
        lost += session.lost;
        bytes.push(session.bytes / bytes_alone - 1.0);
        eprintln!("seed {seed}: {} kills", session.kills);
    }
    ensure!(kills > 0, "nothing was killed, so nothing was measured");
    let more = 100.0 * median(bytes).unwrap_or(f64::NAN);
    Ok([
        "`kill -9` of the station or an agent at seeded moments, started again".into(),
        format!("{kills}, in {sessions} sessions"),
        format!(
            "the same in {same} of {sessions}; maps said to be held at a kill: {checked}, lost: {lost}; {more:+.0} % bytes"
        ),
    ])
}

/// What became of two maps told while programs are killed.
struct Session {
    kills: usize,
    /// Maps that an agent was told to be held when the station was killed, and those of them that it did not have.
    checked: usize,
    lost: usize,
    bytes: f64,
    is_same: bool,
}

fn session(plan: &Plan, maps: &[PathBuf], seed: u64, kills: usize) -> Result<Session> {
    let mut yard = Yard::new(plan, maps)?;
    let mut station = yard.start_station(maps.len())?;
    let links = yard.links()?;
    let start = |yard: &Yard, agent: usize| yard.start_agent(agent, links[agent].address());
    let mut agents = (0..maps.len()).map(|agent| start(&yard, agent)).collect::<Result<Vec<_>>>()?;
    let mut random = Random::new(seed);
    let mut made = Session { kills: 0, checked: 0, lost: 0, bytes: 0.0, is_same: false };
    while made.kills < kills {
        std::thread::sleep(Duration::from_secs_f64(GAPS[0] * (GAPS[1] / GAPS[0]).powf(random.unit())));
        let victim = random.index(maps.len() + 1);
        if station.0.try_wait()?.is_some() {
            break;
        }
        if let Some(agent) = agents.get_mut(victim) {
            // Who handed all over has ended.
            if agent.0.try_wait()?.is_some() {
                continue;
            }
            agent.kill()?;
            *agent = start(&yard, victim)?;
        } else {
            let stored: Vec<&PathBuf> = yard.agents.iter().filter(|agent| is_stored(agent)).collect();
            let acknowledged = stored.iter().map(|agent| heads(agent)).collect::<Result<Vec<_>>>()?;
            station.kill()?;
            let there = heads(&yard.station)?;
            made.checked += acknowledged.len();
            made.lost +=
                acknowledged.iter().filter(|own| !own.iter().all(|head| there.contains(head))).count();
            station = yard.start_station(maps.len())?;
        }
        made.kills += 1;
    }
    end(&mut station, "the station does not come to its end")?;
    made.bytes = links.iter().map(|link| link.carried() as f64).sum();
    made.is_same = yard.is_same()?;
    Ok(made)
}
