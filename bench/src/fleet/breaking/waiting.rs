//! An agent that stands still, a station that is not there, a full disk.

use super::super::{LOOK, Plan, status, wait};
use super::{NAMES, Yard, end};
use crate::measure::{finish, make_empty};
use anyhow::{Context, Result, ensure};
use measuring::median;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Bytes that a link carried when an agent stands still from then on: lists, and some of its keyframes.
const PART: u64 = 500_000;
/// How long a disk stays full.
const STAYS_FULL: Duration = Duration::from_secs(10);
/// Bytes of the disk that gets full: a part of what maps take.
const FULL: u64 = 12 << 20;

/// How the third of three agents is.
#[derive(Clone, Copy, PartialEq)]
enum Third {
    Absent,
    StandsStill,
}

/// One of three agents stands still when a part of its map came; how long the other two take until they are merged.
pub(super) fn stalled(plan: &Plan, maps: &[PathBuf]) -> Result<[String; 3]> {
    let (mut without, mut with_fleet, mut same) = (Vec::new(), Vec::new(), 0);
    for _ in 0..plan.runs {
        without.push(two_of_three(plan, maps, Third::Absent)?.0);
        let (seconds, is_same) = two_of_three(plan, maps, Third::StandsStill)?;
        with_fleet.push(seconds);
        same += usize::from(is_same);
    }
    let [without, with_fleet] = [without, with_fleet].map(|seconds| median(seconds).unwrap_or(f64::NAN));
    let runs = plan.runs;
    Ok([
        "one of three agents stands still (`SIGSTOP`) with a part of its map told".into(),
        format!("{runs}, in turns with two agents alone"),
        format!(
            "all of the other two is there and merged after {with_fleet:.1} s, without it {without:.1} s; once it goes on all three are merged: the same in {same} of {runs}"
        ),
    ])
}

/// Seconds until all of the first two maps is at the station and merged, and whether what came in the end is the same.
fn two_of_three(plan: &Plan, maps: &[PathBuf], third: Third) -> Result<(f64, bool)> {
    let maps = if third == Third::Absent { &maps[..2] } else { maps };
    let mut yard = Yard::new(plan, maps)?;
    let mut station = yard.start_station(maps.len())?;
    let links = yard.links()?;
    let mut last = None;
    if third == Third::StandsStill {
        let agent = yard.start_agent(2, links[2].address())?;
        let begun = Instant::now();
        while links[2].carried() < PART {
            wait(begun, LOOK, "the third agent tells nothing")?;
        }
        agent.signal("STOP")?;
        last = Some(agent);
    }
    let begun = Instant::now();
    let _agents =
        (0..2).map(|agent| yard.start_agent(agent, links[agent].address())).collect::<Result<Vec<_>>>()?;
    if last.is_none() {
        end(&mut station, "the station does not come to its end")?;
        return Ok((begun.elapsed().as_secs_f64(), yard.is_same()?));
    }
    let two = |status: &Value| {
        let agents = status["agents"].as_array().into_iter().flatten();
        let whole = agents.filter(|agent| agent["missing"] == 0 && agent["finished"] == true).count();
        let meetings = status["found"]["meetings"].as_array().into_iter().flatten();
        let of_two = |pair: &&Value| {
            let names = pair["names"].as_array().into_iter().flatten();
            names.filter(|name| **name != NAMES[2]).count() == 2
                && pair["verdict"] == "accepted"
                && pair["pending"] == false
        };
        let placed = status["found"]["agents"].as_array().into_iter().flatten();
        let looked = placed.filter(|agent| agent["whole"] == true && agent["name"] != NAMES[2]).count();
        whole == 2 && looked == 2 && meetings.filter(of_two).count() == 1
    };
    while !status(&yard.station).as_ref().is_some_and(two) {
        wait(begun, LOOK, "one that stands still keeps the others")?;
    }
    let seconds = begun.elapsed().as_secs_f64();
    if let Some(agent) = &last {
        agent.signal("CONT")?;
    }
    end(&mut station, "the station does not come to its end once the third goes on")?;
    Ok((seconds, yard.is_same()?))
}

/// The station is not there for the whole of a run.
pub(super) fn off(plan: &Plan, map: &Path) -> Result<[String; 3]> {
    let folder = plan.work.join("fleet").join("alone");
    make_empty(&folder)?;
    let sequence = plan.data.join(NAMES[0]);
    let mut command = Command::new(plan.loopbox);
    command.arg("run").arg(&sequence).arg("--calib").arg(sequence.join("camera.yaml"));
    finish(command.args(["--quiet", "--out"]).arg(&folder))?;
    let files = ["map.mcap", "trajectory.txt", "cloud.ply"];
    let is_same =
        |file: &&str| -> Result<bool> { Ok(fs::read(folder.join(file))? == fs::read(map.join(file))?) };
    let same = files.iter().map(is_same).collect::<Result<Vec<_>>>()?;
    let same = same.into_iter().filter(|same| *same).count();
    let mut yard = Yard::new(plan, &[map.to_owned()])?;
    let mut station = yard.start_station(1)?;
    let address = yard.address.clone().context("the station does not listen")?;
    let _agent = yard.start_agent(0, &address)?;
    end(&mut station, "the station does not come to its end")?;
    let agents = fs::read_dir(yard.station.join("agents"))?;
    let there: Vec<PathBuf> = agents.flatten().map(|entry| entry.path().join("map.mcap")).collect();
    let [there] = <[PathBuf; 1]>::try_from(there)
        .map_err(|all| anyhow::anyhow!("{} maps at the station", all.len()))?;
    let is_there = fs::read(there)? == fs::read(map.join("map.mcap"))?;
    Ok([
        format!("the station not there for the whole of a run (`{}`), and later", NAMES[0]),
        "1".into(),
        format!(
            "map, trajectory and cloud as of a run alone, bit by bit: {same} of 3; told afterwards the map at the station is the same: {}",
            if is_there { "yes" } else { "**no**" }
        ),
    ])
}

/// A disk of its own for a station, that goes with it.
struct Disk(PathBuf);

impl Disk {
    /// One of so many bytes; `None` where the system refuses.
    fn mount(at: &Path, bytes: u64) -> Option<Self> {
        fs::create_dir_all(at).ok()?;
        let size = format!("size={bytes}");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(at).output();
        mounted.is_ok_and(|output| output.status.success()).then(|| Self(at.to_owned()))
    }

    /// Makes room on it.
    fn grow(&self, bytes: u64) -> Result<()> {
        finish(Command::new("mount").args(["-o", &format!("remount,size={bytes}")]).arg(&self.0)).map(drop)
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Nothing is in it that is wanted any more; who cannot be asked has no disk.
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}

/// The station's disk gets full, and has room again later.
pub(super) fn full(plan: &Plan, maps: &[PathBuf]) -> Result<[String; 3]> {
    let what = format!("the station's disk full at {} MB, later with room again", FULL >> 20);
    let mut yard = Yard::new(plan, maps)?;
    let Some(disk) = Disk::mount(&yard.station, FULL) else {
        eprintln!("NOT MEASURED: no small disk can be mounted here, which takes root");
        return Ok([what, "0".into(), "**not measured: a tmpfs could not be mounted**".into()]);
    };
    let mut station = yard.start_station(maps.len())?;
    let links = yard.links()?;
    let _agents = (0..maps.len())
        .map(|agent| yard.start_agent(agent, links[agent].address()))
        .collect::<Result<Vec<_>>>()?;
    let begun = Instant::now();
    while room(&yard.station)? > FULL / 100 {
        ensure!(station.0.try_wait()?.is_none(), "the station ended before its disk was full");
        wait(begun, LOOK, "the station's disk does not get full")?;
    }
    std::thread::sleep(STAYS_FULL);
    let lives = station.0.try_wait()?.is_none();
    disk.grow(FULL * 100)?;
    if !lives {
        station = yard.start_station(maps.len())?;
    }
    end(&mut station, "the station does not come to its end with room again")?;
    let same = if yard.is_same()? { "the same" } else { "**not the same**" };
    let lives = if lives { "goes on" } else { "**ended**, and started again it goes on" };
    drop(disk);
    Ok([what, "1".into(), format!("for {} s it waits and {lives}; {same} in the end", STAYS_FULL.as_secs())])
}

/// Bytes free on the disk of a folder.
fn room(folder: &Path) -> Result<u64> {
    let text = finish(Command::new("df").args(["--output=avail", "-B1"]).arg(folder))?;
    let text = String::from_utf8(text)?;
    text.lines().last().and_then(|line| line.trim().parse().ok()).context("df says no number")
}
