//! What a link costs the tracker: frame times of runs alone, beside a link on which nobody answers, and beside one that
//! a station takes all of the map over.

use super::{LOOK, NOBODY, Plan, Process, status};
use crate::measure::{finish, make_empty};
use anyhow::{Context, Result, bail};
use measuring::median;
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const SEQUENCES: [&str; 2] = ["parking_a", "tum_fr1_xyz"];
/// How long a station may take to begin.
const PATIENCE: Duration = Duration::from_secs(30);

/// What the tracker's link is like.
#[derive(Clone, Copy)]
enum LinkLoad {
    Nothing,
    DeadLink,
    BusyLink,
}

const ALL: [(LinkLoad, &str); 3] = [
    (LinkLoad::Nothing, "alone"),
    (LinkLoad::DeadLink, "nobody answers"),
    (LinkLoad::BusyLink, "a station takes all"),
];

/// Frame times of a run, milliseconds: mean and 99th percentile.
struct Times {
    mean: f64,
    p99: f64,
}

/// Runs each sequence in turns with each link, and says how long frames took as a table.
///
/// # Errors
/// When a run fails.
pub fn measure(plan: &Plan) -> Result<String> {
    let mut text = String::from(HEAD);
    let is_wanted = |name: &&str| plan.only.is_empty() || plan.only.iter().any(|only| only == name);
    let is_there = |name: &&str| plan.data.join(name).is_dir();
    for name in SEQUENCES.into_iter().filter(is_wanted).filter(is_there) {
        let mut times: [Vec<Times>; 3] = Default::default();
        for _ in 0..plan.runs {
            for ((link, _), times) in ALL.iter().zip(&mut times) {
                times.push(run(plan, name, *link)?);
            }
        }
        let of = |times: &[Times], of: fn(&Times) -> f64| {
            median(times.iter().map(of).collect()).context("nothing was measured")
        };
        let alone = of(&times[0], |times| times.p99)?;
        for ((_, link), times) in ALL.iter().zip(&times) {
            let (mean, p99) = (of(times, |times| times.mean)?, of(times, |times| times.p99)?);
            let more = 100.0 * (p99 / alone - 1.0);
            let _ = writeln!(text, "| `{name}` | {link} | {mean:.1} ms | {p99:.1} ms | {more:+.0} % |");
            eprintln!("{name}, {link}: mean {mean:.1} ms, p99 {p99:.1} ms");
        }
    }
    Ok(text)
}

const HEAD: &str = "\n*Beside a link*: frame times of a run that waits for every frame, alone, with `--fleet` and a neighbour that \
    never answers, and with a station on the same machine, and so on the same cores, that takes and puts together all of the map. In turns; \
    medians of the runs. To reach: p99 + 5 %.\n\n\
    | run | link | mean | p99 | to p99 alone |\n\
    |---|---|---|---|---|\n";

fn run(plan: &Plan, name: &str, link: LinkLoad) -> Result<Times> {
    let folder = plan.work.join("fleet").join("beside");
    make_empty(&folder)?;
    let (out, sequence, at) = (folder.join("run"), plan.data.join(name), folder.join("station"));
    let mut command = Command::new(plan.loopbox);
    command.arg("run").arg(&sequence).arg("--calib").arg(sequence.join("camera.yaml"));
    command.args(["--quiet", "--out"]).arg(&out);
    let _station = match link {
        LinkLoad::Nothing => None,
        LinkLoad::DeadLink => {
            command.args([&format!("--fleet={name}"), "--connect", NOBODY]);
            None
        }
        LinkLoad::BusyLink => {
            let (station, address) = station(plan, &at)?;
            command.args([&format!("--fleet={name}"), "--connect", &address]);
            Some(station)
        }
    };
    finish(&mut command)?;
    if matches!(link, LinkLoad::BusyLink) && received(&at) == 0 {
        bail!("the station took nothing of the map, so nothing was measured");
    }
    let record: Value = serde_json::from_slice(&std::fs::read(out.join("run.json"))?)?;
    let number =
        |pointer: &str| record.pointer(pointer).and_then(Value::as_f64).context("run.json lacks frame times");
    Ok(Times { mean: number("/cost/mean_ms")?, p99: number("/cost/p99_ms")? })
}

/// A station, and where it listens.
pub(super) fn station(plan: &Plan, out: &Path) -> Result<(Process, String)> {
    let mut command = Command::new(plan.loopbox);
    command.args(["station", "--quiet", "--listen", "tcp/127.0.0.1:0", "--out"]).arg(out);
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    let station = Process(child.context("loopbox cannot be started")?);
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        if let Some(address) = status(out).as_ref().and_then(|status| status["listening"].as_str()) {
            return Ok((station, address.to_owned()));
        }
        std::thread::sleep(LOOK);
    }
    bail!("no station listens within {} s", PATIENCE.as_secs())
}

/// Bytes of the map that came to a station.
fn received(out: &Path) -> u64 {
    let status = status(out).unwrap_or_default();
    let links = status["links"].as_array().into_iter().flatten();
    links.filter_map(|link| link["received"].as_u64()).sum()
}
