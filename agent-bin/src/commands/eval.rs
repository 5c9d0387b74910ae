//! `loopbox eval`: how far a trajectory, and a map's depth, are from the truth.

use super::eval_agents;
use super::eval_depth::{self, MapDepth};
use super::eval_table::{self, Form, Runs};
use crate::console::{self, warning};
use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use eval::{
    AgentTracks, AlignMode, Delta, Evaluation, Options, Statistics, evaluate, evaluate_agents, read_times,
    read_trajectory,
};
use loopbox::counted;
use loopbox::evaluating::{Fragment, other_fragments, read_truth, trajectory_at};
use serde::Serialize;
use std::fmt::Write;
use std::path::PathBuf;

/// Measure a trajectory against ground truth: ATE, RPE, KITTI segment errors, coverage; of several agents in one
/// frame, how well they were merged
#[derive(Args, Debug)]
pub struct EvalArgs {
    /// Estimated trajectory, or the folder of a run that holds it: TUM (t tx ty tz qx qy qz qw) or KITTI (3×4 matrix a row). Of several agents in one
    /// frame one each: what the first one alone needs is adjusted of all
    #[arg(value_name = "ESTIMATE", required = true)]
    estimates: Vec<PathBuf>,
    /// True trajectory, in either form or EuRoC's data.csv (beside cam0, whose position on the body is used); of several agents one each in their order (`--gt A B`), or one that spans
    /// them all. They must be in one world
    #[arg(long, value_name = "FILE", required = true, num_args = 1..)]
    gt: Vec<PathBuf>,
    /// What is adjusted before errors are measured [default: sim3; of LiDARs, whose maps are metric, se3]
    #[arg(long, value_enum)]
    align: Option<Align>,
    /// Interval of the relative pose error: `10` frames or `1.5s`
    #[arg(long, value_name = "N|SECONDSs", default_value = "1", value_parser = parse_delta)]
    delta: Delta,
    /// Let the intervals of the relative pose error overlap: one starts at every pose
    #[arg(long)]
    all_pairs: bool,
    /// Largest time difference of an estimated and a true pose that are compared, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = eval::DEFAULT_MAX_DIFF)]
    max_diff: f64,
    /// Times of the recording's frames (first column of times.txt): coverage counts these, and KITTI files
    /// take their time stamps from here; of several agents one each
    #[arg(long, value_name = "FILE")]
    frames: Vec<PathBuf>,
    /// Also measure the depths of this map (map.mcap) against --depth
    #[arg(long, value_name = "FILE", requires_all = ["depth", "frames"])]
    map: Option<PathBuf>,
    /// Folder of true depth images NNNNNN.png, named by frame: 16 bit, millimetres along the optical axis
    #[arg(long, value_name = "DIR", requires = "map")]
    depth: Option<PathBuf>,
    /// Compare each estimate by itself, as runs of one recording from several first frames: a row each, and the median and the range
    /// of those with one truth
    #[arg(long, conflicts_with = "map")]
    table: bool,
    /// With --table: also write the rows into this file
    #[arg(long, value_name = "FILE", requires = "table")]
    csv: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The alignments by their names on the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Align {
    /// Rotation, translation and scale
    Sim3,
    /// Rotation and translation
    Se3,
    /// Scale alone, taken from the Sim(3) alignment
    Scale,
    /// Nothing
    None,
}

impl From<Align> for AlignMode {
    fn from(align: Align) -> Self {
        match align {
            Align::Sim3 => Self::Sim3,
            Align::Se3 => Self::Se3,
            Align::Scale => Self::Scale,
            Align::None => Self::None,
        }
    }
}

/// What is adjusted of these estimates unless the user says: not the scale where a map beside each says that a LiDAR made
/// it.
fn usual(estimates: &[PathBuf]) -> Align {
    let is_metric = |estimate: &PathBuf| {
        let folder = if estimate.is_dir() { Some(estimate.as_path()) } else { estimate.parent() };
        let sensors = folder.and_then(|folder| map::sensors_of(folder.join("map.mcap")).ok());
        sensors.is_some_and(|sensors| sensors.iter().eq([&map::SensorKind::Lidar]))
    };
    if estimates.iter().all(is_metric) { Align::Se3 } else { Align::Sim3 }
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Output {
    #[serde(flatten)]
    evaluation: Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<MapDepth>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fragments: Vec<Fragment>,
}

/// Reads estimates and truths, compares them and prints the result.
pub fn run(args: EvalArgs) -> Result<()> {
    let options = Options {
        align: args.align.unwrap_or_else(|| usual(&args.estimates)).into(),
        max_diff: args.max_diff,
        delta: args.delta,
        all_pairs: args.all_pairs,
    };
    check_counts(&args)?;
    if args.table {
        let runs = Runs { estimates: &args.estimates, truths: &args.gt, frames: &args.frames };
        return eval_table::run(&runs, &options, &Form { json: args.json, csv: args.csv.as_deref() });
    }
    let mut agents = read(&args)?;
    match (agents.pop(), agents.is_empty()) {
        (Some(only), true) => run_one(&args, only, &options),
        (last, _) => {
            agents.extend(last);
            if args.gt.len() == 1 && overlap(&agents) {
                warning!(
                    "{} is taken for the truth of all {} estimates, some of them of the same time\nhint: give one \
                     for each in their order: --gt A B",
                    args.gt[0].display(),
                    agents.len()
                );
            }
            let found = evaluate_agents(agents, &options)?;
            eval_agents::print(&args.estimates, &found, options.align, args.json)
        }
    }
}

/// Whether two of the estimates are of the same time.
fn overlap(agents: &[AgentTracks]) -> bool {
    let span = |agent: &AgentTracks| {
        let times = agent.estimate.timestamps.as_ref()?;
        Some((*times.first()?, *times.last()?))
    };
    let mut spans: Vec<(f64, f64)> = agents.iter().filter_map(span).collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    spans.windows(2).any(|pair| pair[1].0 < pair[0].1)
}

/// Whether there is a truth and a table of times for each estimate, or one for all.
fn check_counts(args: &EvalArgs) -> Result<()> {
    let count = args.estimates.len();
    if args.gt.len() != 1 && args.gt.len() != count {
        bail!(
            "{} and {}: give one for each in their order, or one for all\nhint: estimates come before \
             --gt, which takes every file that follows",
            counted(count, "estimate", "estimates"),
            counted(args.gt.len(), "truth", "truths")
        );
    }
    let is_one_for_all = args.table && args.frames.len() == 1;
    if !args.frames.is_empty() && args.frames.len() != count && !is_one_for_all {
        bail!(
            "{} and {} --frames: give one for each in their order",
            counted(count, "estimate", "estimates"),
            args.frames.len()
        );
    }
    if args.map.is_some() && count > 1 {
        bail!("--map is that of one agent: measure its depths with its estimate alone");
    }
    Ok(())
}

/// Reads what belongs to each agent.
fn read(args: &EvalArgs) -> Result<Vec<AgentTracks>> {
    let agent = |(i, estimate): (usize, &PathBuf)| {
        Ok(AgentTracks {
            estimate: read_trajectory(&trajectory_at(estimate)?)?,
            truth: read_truth(args.gt.get(i).unwrap_or(&args.gt[0]))?,
            frames: args.frames.get(i).map(|path| read_times(path)).transpose()?,
        })
    };
    args.estimates.iter().enumerate().map(agent).collect()
}

/// Compares one estimate, the other fragments of its run and, if asked for, the depths of its map.
fn run_one(args: &EvalArgs, agent: AgentTracks, options: &Options) -> Result<()> {
    let AgentTracks { estimate, truth, frames } = agent;
    let depth = match (&args.map, &args.depth, &frames) {
        (Some(map), Some(folder), Some(frames)) => {
            Some(eval_depth::measure(map, folder, frames, &truth, args.max_diff)?)
        }
        _ => None,
    };
    let fragments = other_fragments(&args.estimates[0], &truth, frames.as_deref(), options)?;
    let evaluation = evaluate(estimate, truth, frames.as_deref(), options)?;
    if args.json {
        console::print_json(&Output { evaluation, depth, fragments })?;
    } else {
        console::print(&table(&evaluation, frames.is_some())?)?;
        if !fragments.is_empty() {
            console::print(&fragments_table(&fragments)?)?;
        }
        depth.iter().try_for_each(|depth| console::print(&format!("\n{depth}")))?;
    }
    Ok(())
}

/// `10` is frames, `1.5s` is seconds.
fn parse_delta(text: &str) -> Result<Delta> {
    if let Some(seconds) = text.strip_suffix('s') {
        match seconds.parse::<f64>() {
            Ok(seconds) if seconds.is_finite() && seconds > 0.0 => return Ok(Delta::Seconds(seconds)),
            _ => bail!("expected a time above zero, as in `1.5s`"),
        }
    }
    match text.parse::<usize>() {
        Ok(frames) if frames > 0 => Ok(Delta::Frames(frames)),
        _ => bail!("expected a number of frames from 1, or seconds as in `1.5s`"),
    }
}

fn table(evaluation: &Evaluation, frames_given: bool) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    let alignment = match evaluation.align {
        AlignMode::None => "none".to_owned(),
        AlignMode::Se3 => "SE(3)".to_owned(),
        AlignMode::Sim3 => format!("Sim(3), scale {:.6}", evaluation.truth_from_estimate.scale),
        AlignMode::Scale => format!("scale {:.6}", evaluation.truth_from_estimate.scale),
    };
    writeln!(out, "compared    {} poses, alignment {alignment}", evaluation.pairs)?;
    if let Some(c) = evaluation.coverage {
        let what = if frames_given { "frames" } else { "ground-truth poses" };
        writeln!(out, "coverage    {} of {} {what} ({:.1} %)", c.covered, c.total, 100.0 * c.share)?;
    }
    let heads = ["rmse", "mean", "median", "std", "min", "max", "sse"];
    write!(out, "\n{:<16}", "")?;
    heads.iter().try_for_each(|head| write!(out, "{head:>12}"))?;
    writeln!(out)?;
    row(&mut out, "ATE m", &evaluation.ate)?;
    if let Some(rpe) = &evaluation.rpe {
        row(&mut out, "RPE m", &rpe.translation)?;
        row(&mut out, "RPE deg", &rpe.rotation_deg)?;
        let overlap = if rpe.all_pairs { ", overlapping" } else { "" };
        match rpe.delta {
            Delta::Frames(n) => writeln!(out, "RPE over {n} frame(s){overlap}")?,
            Delta::Seconds(s) => writeln!(out, "RPE over {s} s{overlap}")?,
        }
    }
    if let Some(segments) = &evaluation.segments {
        writeln!(out, "\n{:<16}{:>12}{:>12}{:>12}", "segments", "count", "trans %", "rot deg/m")?;
        for l in &segments.lengths {
            let name = format!("{} m", l.length);
            let (t, r) = (l.translation_percent, l.rotation_deg_per_m);
            writeln!(out, "{name:<16}{:>12}{t:>12.4}{r:>12.6}", l.count)?;
        }
        let (t, r) = (segments.translation_percent, segments.rotation_deg_per_m);
        writeln!(out, "{:<16}{:>12}{t:>12.4}{r:>12.6}", "all", "")?;
    }
    Ok(out)
}

fn fragments_table(fragments: &[Fragment]) -> Result<String, std::fmt::Error> {
    let mut out = String::from("\nother fragments, each aligned by itself\n");
    writeln!(out, "{:<20}{:>8}{:>12}{:>12}{:>12}", "", "poses", "ATE rmse", "ATE median", "ATE max")?;
    for Fragment { trajectory, evaluation } in fragments {
        match evaluation {
            Some(Evaluation { pairs, ate, .. }) => {
                let [rmse, median, max] = [ate.rmse, ate.median, ate.max];
                writeln!(out, "{trajectory:<20}{pairs:>8}{rmse:>12.6}{median:>12.6}{max:>12.6}")?;
            }
            None => writeln!(out, "{trajectory:<20} too few poses have a truth")?,
        }
    }
    Ok(out)
}

fn row(out: &mut String, name: &str, s: &Statistics) -> std::fmt::Result {
    write!(out, "{name:<16}")?;
    [s.rmse, s.mean, s.median, s.std, s.min, s.max, s.sse]
        .iter()
        .try_for_each(|v| write!(out, "{v:>12.6}"))?;
    writeln!(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_frames_or_seconds() {
        assert_eq!(parse_delta("10").unwrap(), Delta::Frames(10));
        assert_eq!(parse_delta("1.5s").unwrap(), Delta::Seconds(1.5));
        for bad in ["0", "-1", "0s", "NaNs", "infs", "s", "x", "1.5"] {
            assert!(parse_delta(bad).is_err(), "{bad}");
        }
    }
}
