//! Agents that pair: what it takes until two maps that meet over a network are merged, and how that merge lies beside one
//! of the whole files; what a link costs the tracker (`link_load`), what holds when things break (`breaking`), and how long a hundred wait (`hundred`).

pub mod breaking;
pub mod hundred;
pub mod link_load;

use crate::measure::{finish, make_empty};
use anyhow::{Context, Result, bail};
use eval::{Pose, Trajectory, read_trajectory};
use geometry::{Se3, Sim3};
use loopbox_tests::proxy::{Link, Proxy};
use measuring::median;
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Recordings that share a place.
const PAIRS: [[&str; 2]; 4] = [
    ["parking_a", "parking_b"],
    ["parking_a", "parking_c"],
    ["parking_b", "parking_c"],
    ["tum_fr1_xyz", "tum_fr1_desk"],
];
/// Links by name and bytes a second of either direction.
const LINKS: [(&str, Option<f64>); 2] = [("not bounded", None), ("256 kbit/s", Some(32e3))];
/// Where nobody listens.
const NOBODY: &str = "tcp/127.0.0.1:9";
const LOOK: Duration = Duration::from_millis(10);
/// How often it is looked whether maps were merged: all the rest of them is sent then, as fast as the link carries it.
const LOOK_CLOSELY: Duration = Duration::from_millis(1);
/// How long two maps have to meet.
const PATIENCE: Duration = Duration::from_secs(300);

/// What is measured.
pub struct Plan<'a> {
    /// The program.
    pub loopbox: &'a Path,
    /// The folder of recordings.
    pub data: &'a Path,
    /// Where outputs go.
    pub work: &'a Path,
    /// How often each meeting is measured.
    pub runs: usize,
    /// How often a program is killed, in all.
    pub kills: usize,
    /// Only pairs of these recordings; all where there are none.
    pub only: &'a [String],
}

/// A meeting.
struct PairTiming {
    bytes: f64,
    seconds: f64,
    /// Keyframes that were looked at.
    looked_at: f64,
    /// The one agent's world in the other's.
    placed: Placed,
}

/// Where agents are, by their names.
type Placed = Vec<(String, Sim3)>;

/// Errors of the second agent in the frame of the first: ATE RMSE in metres, scale in per cent.
struct Errors([Option<f64>; 2]);

/// Measures every pair over every link, and says what came of it as a table.
///
/// # Errors
/// When a recording cannot be run, or two maps that share a place do not meet.
pub fn measure(plan: &Plan) -> Result<String> {
    let mut text = String::from(HEAD);
    for pair in PAIRS {
        let wanted = |name: &&str| plan.only.is_empty() || plan.only.iter().any(|only| only == name);
        if !pair.iter().all(|name| plan.data.join(name).is_dir() && wanted(name)) {
            continue;
        }
        let maps = [map_of(plan, pair[0])?, map_of(plan, pair[1])?];
        let whole = errors_of_files(plan, &maps, pair)?;
        let keyframes = [keyframes(&maps[0])?, keyframes(&maps[1])?];
        for (name, rate) in LINKS {
            let mut meetings = Vec::new();
            for _ in 0..plan.runs {
                meetings.push(meet(plan, &maps, rate)?);
            }
            let of =
                |of: fn(&PairTiming) -> f64| median(meetings.iter().map(of).collect()).unwrap_or(f64::NAN);
            let errors = errors_of_places(plan, &maps, pair, &meetings[0].placed)?;
            let (megabytes, seconds, looked_at) =
                (of(|timing| timing.bytes) / 1e6, of(|timing| timing.seconds), of(|timing| timing.looked_at));
            let _ = writeln!(
                text,
                "| `{}` + `{}` | {} + {} | {name} | {megabytes:.2} MB | {seconds:.1} s | {looked_at:.0} | {} | {} |",
                pair[0],
                pair[1],
                keyframes[0],
                keyframes[1],
                errors.output(),
                whole.output(),
            );
            eprintln!("{} + {}, {name}: {megabytes:.2} MB, {seconds:.1} s", pair[0], pair[1]);
        }
    }
    Ok(text)
}

const HEAD: &str = "*Bytes* are all that the link carried in both directions from its opening until one of the two agents \
    had merged both maps, *looked at* the keyframes of both that it had images of. *Error* is the ATE RMSE of the second \
    agent after the first one alone was aligned with the truth, with the error of its scale: where that merge puts its own \
    trajectory, and by `loopbox merge` of the whole files.\n\n\
    | maps | keyframes | link | bytes to the merge | time to the merge | looked at | error | of files |\n\
    |---|---|---|---|---|---|---|---|\n";

impl Errors {
    fn output(&self) -> String {
        let [error, scale] = self.0;
        match (error, scale) {
            (Some(error), Some(scale)) => format!("{:.2} cm, {scale:.2} %", 100.0 * error),
            (Some(error), None) => format!("{:.2} cm", 100.0 * error),
            _ => "–".into(),
        }
    }
}

/// The folder of a run that reached nobody and keeps its map to be told; made if it is not there.
fn map_of(plan: &Plan, name: &str) -> Result<PathBuf> {
    let out = plan.work.join("fleet").join(name);
    if !out.join("fleet").join("heads").is_dir() || !out.join("map.mcap").is_file() {
        make_empty(&out)?;
        let sequence = plan.data.join(name);
        let mut command = Command::new(plan.loopbox);
        command.arg("run").arg(&sequence).arg("--calib").arg(sequence.join("camera.yaml"));
        command.args(["--quiet", &format!("--fleet={name}"), "--connect", NOBODY, "--out"]).arg(&out);
        finish(&mut command)?;
    }
    Ok(out)
}

/// A process that is ended when nobody wants it any more.
struct Process(Child);

impl Process {
    /// Sends it a signal by its name.
    fn signal(&self, name: &str) -> Result<()> {
        finish(Command::new("kill").arg(format!("-{name}")).arg(self.0.id().to_string())).map(drop)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn publish(plan: &Plan, map: &Path, link: [&str; 2]) -> Result<Process> {
    let mut command = Command::new(plan.loopbox);
    command.arg("fleet").arg(map).args(link).stdout(Stdio::null()).stderr(Stdio::null());
    Ok(Process(command.spawn().context("loopbox cannot be started")?))
}

/// Has two agents meet over a link once.
fn meet(plan: &Plan, maps: &[PathBuf; 2], rate: Option<f64>) -> Result<PairTiming> {
    // Fresh copies: whoever met before knows the other's map already.
    let folder = plan.work.join("fleet").join("meeting");
    make_empty(&folder)?;
    let mut copies = Vec::new();
    for (map, name) in maps.iter().zip(["one", "other"]) {
        let copy = folder.join(name);
        std::fs::create_dir_all(&copy)?;
        finish(Command::new("cp").arg("-r").arg(map.join("fleet")).arg(&copy))?;
        std::fs::copy(map.join("fleet.json"), copy.join("fleet.json"))?;
        copies.push(copy);
    }
    // What an earlier process said is not what this one says.
    let listening = |status: &Value| status["listening"].as_str().map(str::to_owned);
    let begun = Instant::now();
    let one = publish(plan, &copies[0], ["--listen", "tcp/127.0.0.1:0"])?;
    let address = loop {
        if let Some(address) = status(&copies[0]).as_ref().and_then(listening) {
            break address;
        }
        wait(begun, LOOK, "nobody listens")?;
    };
    let proxy = Proxy::start(&address, Link { lost: 0, rate }, 1)?;
    let other = publish(plan, &copies[1], ["--connect", proxy.address()])?;
    let (found, bytes) = loop {
        let carried = proxy.carried() as f64;
        let accepted = |status: &Value| {
            let meetings = status["found"]["meetings"].as_array().into_iter().flatten();
            meetings.clone().any(|timing| timing["verdict"] == "accepted").then(|| status["found"].clone())
        };
        let found = copies.iter().find_map(|copy| status(copy).as_ref().and_then(accepted));
        if let Some(found) = found {
            break (found, carried);
        }
        wait(begun, LOOK_CLOSELY, "two maps of one place do not meet")?;
    };
    let seconds = proxy.opened().context("nobody dialled")?.elapsed().as_secs_f64();
    drop((one, other));
    let agents: Vec<&Value> = found["agents"].as_array().into_iter().flatten().collect();
    let looked_at = agents.iter().filter_map(|agent| agent["keyframes"].as_f64()).sum();
    let placed = agents.iter().filter_map(|agent| placed(agent)).collect();
    Ok(PairTiming { bytes, seconds, looked_at, placed })
}

/// What `fleet.json` in a folder says.
fn status(folder: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(folder.join("fleet.json")).ok()?).ok()
}

fn wait(begun: Instant, pause: Duration, otherwise: &str) -> Result<()> {
    if begun.elapsed() > PATIENCE {
        bail!("{otherwise} within {} s", PATIENCE.as_secs());
    }
    std::thread::sleep(pause);
    Ok(())
}

/// Where an agent is.
fn placed(agent: &Value) -> Option<(String, Sim3)> {
    let numbers = agent["root_from_agent"].as_array()?.iter().filter_map(Value::as_f64).collect::<Vec<_>>();
    let [tx, ty, tz, qx, qy, qz, qw, scale] = <[f64; 8]>::try_from(numbers).ok()?;
    let rigid = Se3::from_tum([tx, ty, tz, qx, qy, qz, qw]);
    Some((agent["name"].as_str()?.to_owned(), Sim3::new(rigid.rotation, rigid.translation, scale)))
}

/// The keyframes of a run.
fn keyframes(map: &Path) -> Result<u64> {
    let text = std::fs::read(map.join("run.json")).context("run.json cannot be read")?;
    let record: Value = serde_json::from_slice(&text)?;
    record.pointer("/map/keyframes").and_then(Value::as_u64).context("run.json says no number of keyframes")
}

/// Errors of a merge of the files.
fn errors_of_files(plan: &Plan, maps: &[PathBuf; 2], pair: [&str; 2]) -> Result<Errors> {
    let out = plan.work.join("fleet").join("merged");
    make_empty(&out)?;
    finish(Command::new(plan.loopbox).arg("merge").args(maps).arg("--out").arg(&out).arg("--quiet"))?;
    errors(plan, pair.map(|name| out.join(format!("trajectory-{name}.txt"))), pair)
}

/// Errors of the agents' own trajectories, each put where it is by a meeting.
fn errors_of_places(plan: &Plan, maps: &[PathBuf; 2], pair: [&str; 2], placed: &Placed) -> Result<Errors> {
    let mut files = Vec::new();
    for (map, name) in maps.iter().zip(pair) {
        let place = placed.iter().find(|(agent, _)| agent == name).context("an agent has no place")?;
        let trajectory = read_trajectory(&map.join("trajectory.txt"))?;
        let file = plan.work.join("fleet").join(format!("placed-{name}.txt"));
        write(&file, &trajectory, &place.1)?;
        files.push(file);
    }
    let [one, other] = <[PathBuf; 2]>::try_from(files).map_err(|_| anyhow::anyhow!("not two agents"))?;
    errors(plan, [one, other], pair)
}

/// Writes a trajectory in another frame.
fn write(file: &Path, trajectory: &Trajectory, frame: &Sim3) -> Result<()> {
    let times = trajectory.timestamps.as_ref().context("a trajectory has no times")?;
    let line = |(time, pose): (&f64, &Pose)| {
        let numbers = pose.transformed(frame).rigid().to_tum().map(|number| number.to_string());
        format!("{time} {}\n", numbers.join(" "))
    };
    let text: String = times.iter().zip(&trajectory.world_from_camera).map(line).collect();
    std::fs::write(file, text).with_context(|| format!("{}: cannot be written", file.display()))
}

fn errors(plan: &Plan, files: [PathBuf; 2], pair: [&str; 2]) -> Result<Errors> {
    let mut command = Command::new(plan.loopbox);
    command.args(["eval", "--json"]).args(files).arg("--gt");
    command.args(pair.map(|name| plan.data.join(name).join("groundtruth.txt")));
    let record: Value = serde_json::from_slice(&finish(&mut command)?)?;
    let number = |pointer: &str| record["agents"].get(1)?.pointer(pointer)?.as_f64();
    Ok(Errors([number("/ate/rmse"), number("/merge/scale_percent")]))
}
