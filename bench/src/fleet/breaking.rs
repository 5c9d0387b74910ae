//! What holds when things break: programs killed at any moment, one that stands still, a station that is not there, a full
//! disk.

mod killing;
mod waiting;

use super::{LOOK, Plan, Process, map_of, status, wait};
use crate::measure::{finish, make_empty};
use anyhow::{Context, Result, ensure};
use loopbox_tests::proxy::{Link, Proxy};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Instant;

/// Whose maps are told.
const NAMES: [&str; 3] = ["parking_a", "parking_b", "parking_c"];
/// Bytes a second of a link, so that maps take some seconds.
const RATE: f64 = 8e6;
const HEAD: &str = "\n*When things break*: two or three agents whose runs are over tell a station their maps, of which the exact images and \
    depths go along, over links of 8 MB/s in each direction. *The same* means that the station's common map is that of `loopbox merge` of the agents' own \
    maps as it keeps them, and these are the agents', bit by bit.\n\n\
    | what | how often | what held |\n\
    |---|---|---|\n";

/// Has things break, and says what held as a table.
///
/// # Errors
/// When something does not come to its end.
pub fn measure(plan: &Plan) -> Result<String> {
    if !plan.only.is_empty() || NAMES.iter().any(|name| !plan.data.join(name).is_dir()) {
        return Ok(String::new());
    }
    let maps = NAMES.iter().map(|name| map_of(plan, name)).collect::<Result<Vec<_>>>()?;
    let mut text = String::from(HEAD);
    // One after the other: what held is said even where a later one does not come to its end.
    let parts: [&dyn Fn() -> Result<[String; 3]>; 4] = [
        &|| killing::killed(plan, &maps[..2]),
        &|| waiting::stalled(plan, &maps),
        &|| waiting::off(plan, &maps[0]),
        &|| waiting::full(plan, &maps[..2]),
    ];
    for part in parts {
        let [what, often, result] = part()?;
        let _ = writeln!(text, "| {what} | {often} | {result} |");
        eprintln!("{what}, {often}: {result}");
    }
    Ok(text)
}

/// A station and agents that tell it maps, each in a folder of its own.
struct Yard<'a> {
    plan: &'a Plan<'a>,
    station: PathBuf,
    agents: Vec<PathBuf>,
    /// Where the station listens, once it did.
    address: Option<String>,
}

impl<'a> Yard<'a> {
    /// Fresh copies of what agents told.
    fn new(plan: &'a Plan<'a>, maps: &[PathBuf]) -> Result<Self> {
        let room = plan.work.join("fleet").join("breaking");
        make_empty(&room)?;
        let mut agents = Vec::new();
        for (map, name) in maps.iter().zip(NAMES) {
            let copy = room.join(name);
            fs::create_dir_all(&copy)?;
            finish(Command::new("cp").arg("-r").arg(map.join("fleet")).arg(&copy))?;
            for file in ["fleet.json", "map.mcap"] {
                fs::copy(map.join(file), copy.join(file))?;
            }
            agents.push(copy);
        }
        Ok(Self { plan, station: room.join("station"), agents, address: None })
    }

    /// Starts the station, where it listened before; it ends once so many maps are whole and merged.
    fn start_station(&mut self, agents: usize) -> Result<Process> {
        let known = self.address.is_some();
        let address = self.address.clone().unwrap_or_else(|| "tcp/127.0.0.1:0".into());
        let mut command = Command::new(self.plan.loopbox);
        command.args(["station", "--quiet", "--agents", &agents.to_string(), "--listen", &address]);
        command.arg("--out").arg(&self.station).stdout(Stdio::null()).stderr(Stdio::null());
        let station = Process(command.spawn().context("loopbox cannot be started")?);
        let begun = Instant::now();
        while !known && self.address.is_none() {
            let output = status(&self.station);
            self.address = output.as_ref().and_then(|s| s["listening"].as_str()).map(str::to_owned);
            wait(begun, LOOK, "no station listens")?;
        }
        Ok(station)
    }

    /// Has an agent tell its map.
    fn start_agent(&self, agent: usize, address: &str) -> Result<Process> {
        super::publish(self.plan, &self.agents[agent], ["--connect", address])
    }

    /// Links of a bounded rate to the station, one for each agent.
    fn links(&self) -> Result<Vec<Proxy>> {
        let address = self.address.as_ref().context("the station does not listen yet")?;
        let link = Link { lost: 0, rate: Some(RATE) };
        (1..).zip(&self.agents).map(|(seed, _)| Ok(Proxy::start(address, link, seed)?)).collect()
    }

    /// Whether the common map is that of the files, and these are the agents'.
    fn is_same(&self) -> Result<bool> {
        let record: Value = serde_json::from_slice(&fs::read(self.station.join("merge.json"))?)?;
        let inputs = record["inputs"].as_array().into_iter().flatten();
        let inputs: Vec<PathBuf> =
            inputs.filter_map(|input| input["path"].as_str()).map(PathBuf::from).collect();
        let again = self.station.with_file_name("again");
        make_empty(&again)?;
        finish(
            Command::new(self.plan.loopbox)
                .arg("merge")
                .args(&inputs)
                .arg("--quiet")
                .arg("--out")
                .arg(&again),
        )?;
        let mut same = fs::read(again.join("map.mcap"))? == fs::read(self.station.join("map.mcap"))?;
        let own: Vec<Vec<u8>> =
            self.agents.iter().map(|agent| fs::read(agent.join("map.mcap"))).collect::<Result<_, _>>()?;
        for input in &inputs {
            same &= own.contains(&fs::read(input)?);
        }
        Ok(same && inputs.len() == self.agents.len())
    }
}

impl Process {
    /// Ends it as `kill -9` does.
    fn kill(&mut self) -> Result<()> {
        self.0.kill()?;
        self.0.wait()?;
        Ok(())
    }
}

/// Waits until a program ended well.
fn end(process: &mut Process, otherwise: &str) -> Result<()> {
    let begun = Instant::now();
    loop {
        if let Some(status) = process.0.try_wait()? {
            ensure!(status.success(), "{otherwise}: {status}");
            return Ok(());
        }
        wait(begun, LOOK, otherwise)?;
    }
}
