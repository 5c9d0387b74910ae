//! Agents that come to a station one after the other.

use super::super::{Plan, Process, link_load, publish, status};
use super::{published::PublishedMap, shares};
use crate::measure::{finish, make_empty};
use anyhow::{Context, Result, ensure};
use loopbox_tests::proxy::{Link, Proxy};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Time from one to the next.
const GAP: Duration = Duration::from_secs(1);
/// Bytes a second of the link of the one that stands still, so that it tells its map for some seconds.
const RATE: f64 = 200e3;
/// How often it is looked who has a place.
const LOOK: Duration = Duration::from_millis(20);
/// How long all may take.
const PATIENCE: Duration = Duration::from_secs(450);
/// Hertz of the times in /proc/PID/stat.
const TICKS: f64 = 100.0;

/// What was seen.
pub(super) struct Come {
    /// Seconds that agents waited for their places: from their starts, from being heard of and from their parts being there.
    waits: [Vec<f64>; 3],
    /// Seconds until all stood in one frame.
    together: f64,
    /// Of the station: bytes at the most, and CPU seconds.
    cost: [f64; 2],
    /// Processes that wanted to run, before and after.
    load: [f64; 2],
}

impl Come {
    /// A line of the table.
    pub fn line(&self, name: &str) -> String {
        let [started, discovered, parts] = self.waits.each_ref().map(|waits| shares(waits));
        let ([memory, cpu], [before, after]) = (self.cost, self.load);
        format!(
            "| {name} | {started} | {discovered} | {parts} | {:.1} s | {:.0} MB | {cpu:.0} s | {before:.1}, {after:.1} |\n",
            self.together,
            memory / 1e6
        )
    }
}

/// An agent whose link is slow, and which stands still once it told so many bytes.
struct Stalling {
    number: usize,
    proxy: Proxy,
    bytes: u64,
}

/// Agents at work, and when each was started and had its place, in seconds by its identity: those aside that stand still.
struct Crowd<'a> {
    plan: &'a Plan<'a>,
    maps: &'a [PublishedMap],
    homes: Vec<PathBuf>,
    address: String,
    stalled: Option<usize>,
    stalling: Option<Stalling>,
    /// Links of those that stand still, which stay open.
    links: Vec<Proxy>,
    agents: Vec<Process>,
    started: BTreeMap<&'a str, f64>,
    placed: BTreeMap<&'a str, f64>,
}

/// Has all agents come to a new station; the one that is to be `stalled` stands still with half of its map told.
pub(super) fn come(plan: &Plan, maps: &[PublishedMap], stalled: Option<usize>) -> Result<Come> {
    let before = load()?;
    let room = plan.work.join("fleet").join("hundred");
    make_empty(&room)?;
    let homes = maps.iter().map(|map| copied(&map.home, &room)).collect::<Result<Vec<_>>>()?;
    let at = room.join("station");
    let (station, address) = link_load::station(plan, &at)?;
    let (stalling, links, agents, started, placed) = Default::default();
    let mut crowd = Crowd { plan, maps, homes, address, stalled, stalling, links, agents, started, placed };
    let begun = Instant::now();
    loop {
        let now = begun.elapsed();
        crowd.start_next(now)?;
        crowd.stall()?;
        let output = status(&at).unwrap_or_default();
        if crowd.look(&output, now.as_secs_f64()) {
            let waits = crowd.waits(&output);
            let together = now.as_secs_f64();
            return Ok(Come { waits, together, cost: cost(station.0.id())?, load: [before, load()?] });
        }
        let (placed, started) = (crowd.placed.len(), crowd.started.len());
        ensure!(now < PATIENCE, "{placed} of {started} agents have a place after {} s", now.as_secs());
        std::thread::sleep(LOOK);
    }
}

impl Crowd<'_> {
    /// Starts the next agent, if it is time.
    fn start_next(&mut self, now: Duration) -> Result<()> {
        let number = self.agents.len();
        if number >= self.homes.len() || now < GAP * number as u32 {
            return Ok(());
        }
        let home = &self.homes[number];
        let mut address = self.address.clone();
        if self.stalled == Some(number) {
            let proxy = Proxy::start(&address, Link { lost: 0, rate: Some(RATE) }, 1)?;
            address = proxy.address().to_owned();
            self.stalling = Some(Stalling { number, proxy, bytes: size(&home.join("fleet"))? / 2 });
        } else {
            self.started.insert(&self.maps[number].agent, now.as_secs_f64());
        }
        self.agents.push(publish(self.plan, home, ["--connect", &address])?);
        Ok(())
    }

    /// Has an agent stand still, once it told enough.
    fn stall(&mut self) -> Result<()> {
        let Some(stalling) = self.stalling.take_if(|one| one.proxy.carried() >= one.bytes) else {
            return Ok(());
        };
        eprintln!("one stands still with {} kB of its map told", stalling.bytes / 1000);
        self.links.push(stalling.proxy);
        self.agents[stalling.number].signal("STOP")
    }

    /// Looks who has a place; whether all have, in one frame.
    fn look(&mut self, output: &Value, now: f64) -> bool {
        let found = output.pointer("/found/agents").and_then(Value::as_array).map_or(&[][..], |all| all);
        let mut roots = Vec::new();
        for agent in found {
            let members = found.iter().filter(|other| other["root"] == agent["root"]).count();
            let counted = agent["agent"].as_str().and_then(|name| self.started.get_key_value(name));
            if let Some((name, _)) = counted.filter(|_| members > 1) {
                self.placed.entry(name).or_insert(now);
                roots.push(&agent["root"]);
            }
        }
        let is_one = roots.len() == self.started.len() && roots.windows(2).all(|pair| pair[0] == pair[1]);
        self.agents.len() == self.homes.len() && is_one
    }

    /// How long all waited, by what the station says last.
    fn waits(&self, output: &Value) -> [Vec<f64>; 3] {
        let of = |number: &str| {
            let lines = output["agents"].as_array().into_iter().flatten();
            let counted = lines
                .filter(|line| line["agent"].as_str().is_some_and(|name| self.started.contains_key(name)));
            counted.filter_map(|line| line[number].as_f64()).collect()
        };
        let from_start = self.placed.iter().map(|(agent, at)| at - self.started[agent]).collect();
        [from_start, of("heard_to_place_s"), of("parts_to_place_s")]
    }
}

/// A fresh copy of what an agent is to tell: whoever told it before knows that.
fn copied(home: &Path, room: &Path) -> Result<PathBuf> {
    let copy = room.join(home.file_name().unwrap_or_default());
    finish(Command::new("cp").arg("-r").arg(home).arg(&copy))?;
    Ok(copy)
}

/// Bytes of the files in a folder.
fn size(folder: &Path) -> Result<u64> {
    let text = String::from_utf8(finish(Command::new("du").arg("-sb").arg(folder))?)?;
    text.split_whitespace().next().and_then(|bytes| bytes.parse().ok()).context("du says no number")
}

/// How many processes want to run, as a mean of the last minute.
fn load() -> Result<f64> {
    let text = fs::read_to_string("/proc/loadavg").context("/proc/loadavg cannot be read")?;
    text.split_whitespace().next().and_then(|load| load.parse().ok()).context("/proc/loadavg says no number")
}

/// Bytes that a process had at the most, and its CPU seconds.
fn cost(process: u32) -> Result<[f64; 2]> {
    let read = |name: &str| fs::read_to_string(format!("/proc/{process}/{name}"));
    let (status, stat) = (read("status")?, read("stat")?);
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let peak = peak
        .and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok())
        .context("no peak memory")?;
    // The program's name may hold blanks.
    let (_, after) = stat.rsplit_once(')').context("no CPU time")?;
    let times: Vec<f64> =
        after.split_whitespace().skip(11).take(2).filter_map(|field| field.parse().ok()).collect();
    Ok([1024.0 * peak, times.iter().sum::<f64>() / TICKS])
}
