//! Where a tracker may be sure of itself and wrong: what moves, a scale that is not carried, a turn before any map, another place
//! after a loss. A run that is wrong has reported so, or has not.

mod cases;
mod judge;
mod report;

pub use report::section;

use crate::measure::{Run, Runner};
use crate::rendering;
use crate::side_by_side::side_by_side;
use anyhow::{Context, Result, bail};
use cases::{Case, Kind};
use eval::Pose;
use judge::{Fragment, Posed, Seen, judge};
use loopbox_tests::Recording;
use serde_json::Value;
use std::path::Path;

/// What became of a recording.
pub struct Outcome {
    kind: Kind,
    seed: u64,
    /// Frames in which there is something to see.
    visible: usize,
    fragments: Vec<Fragment>,
    /// Whether the run says that something was lost or is doubtful.
    is_reported: bool,
}

/// Renders and maps recordings of so many seeds.
///
/// # Errors
/// When files cannot be written or read, or the program fails.
pub fn measure(runner: &Runner, seeds: &[u64], only: &[String]) -> Result<Vec<Outcome>> {
    let is_asked = |kind: &Kind| only.is_empty() || only.contains(&kind.name());
    let kinds: Vec<Kind> = Kind::all().into_iter().filter(is_asked).collect();
    if kinds.is_empty() {
        bail!("nothing doubtful is called {}: try robot or covered", only.join(" or "));
    }
    let jobs: Vec<(Kind, u64)> =
        kinds.iter().flat_map(|kind| seeds.iter().map(|seed| (*kind, *seed))).collect();
    side_by_side(&jobs, |&(kind, seed)| {
        let outcome = measure_one(runner, kind, seed)?;
        eprintln!("{}", report::line(&outcome));
        Ok(outcome)
    })
}

fn measure_one(runner: &Runner, kind: Kind, seed: u64) -> Result<Outcome> {
    let home = runner.work.join("doubt").join(format!("{kind:?}-{seed}").replace([' ', '(', ')', ','], "-"));
    let case = kind.recording(seed);
    let assumed = Recording { camera: case.assumed, shots: case.recording.shots.clone() };
    let out = rendering::run(runner, &assumed, &home)?;
    let outcome = Outcome {
        kind,
        seed,
        visible: case.seen.iter().filter(|seen| **seen != Seen::Nothing).count(),
        fragments: fragments(&case, &out)?,
        is_reported: is_reported(&out)?,
    };
    std::fs::remove_dir_all(&home).with_context(|| format!("{}: cannot be removed", home.display()))?;
    Ok(outcome)
}

/// What became of each fragment of a run.
fn fragments(case: &Case, out: &Path) -> Result<Vec<Fragment>> {
    let shots = &case.recording.shots;
    let rate = (shots.len() - 1) as f64 / (shots[shots.len() - 1].timestamp - shots[0].timestamp);
    let mut fragments = Vec::new();
    for trajectory in rendering::trajectories(out)? {
        let times = trajectory.timestamps.as_deref().unwrap_or_default();
        let posed: Vec<Posed> = times
            .iter()
            .zip(&trajectory.world_from_camera)
            .filter_map(|(time, found)| {
                let frame = rendering::nearest(shots, *time)?;
                let truth = Pose::from(shots[frame].world_from_camera);
                Some(Posed { seen: case.seen[frame], time: *time, truth, found: *found })
            })
            .collect();
        fragments.push(judge(&posed, rate));
    }
    Ok(fragments)
}

/// Whether a run says that tracking was lost, or that frames or a scale are doubtful.
fn is_reported(out: &Path) -> Result<bool> {
    let run = Run::read(out, Value::Null)?;
    let losses = run.record("/frames/losses").context("run.json counts no losses")?;
    let doubts = run.record("/frames/scale_doubts").context("run.json counts no doubts of scale")?
        + run.record("/frames/scale_breaks").unwrap_or_default();
    Ok(losses + doubts + run.record("/frames/doubted").unwrap_or_default() > 0.0)
}
