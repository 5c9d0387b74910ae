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
use judge::{FoundLater, Fragment, Posed, Seen, found_later, gap, judge};
use loopbox_tests::Recording;
use serde_json::Value;
use std::collections::BTreeSet;
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
    /// Of a recording that comes back, how.
    returned: Option<Returned>,
    /// Of each fragment with frames that were found later than they were seen.
    found_later: Vec<FoundLater>,
}

/// How a drive that comes back is found to do so.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Returned {
    /// Loops that the run closed.
    loops: usize,
    /// Between where frames that come back are found and where they are, from the nearest frame of the begin: median, metres; none
    /// where both are not in one fragment.
    gap: Option<f64>,
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
    let posed = posed(&case, &out)?;
    let outcome = Outcome {
        kind,
        seed,
        visible: case.seen.iter().filter(|seen| **seen != Seen::Nothing).count(),
        fragments: posed.iter().map(|fragment| judge(fragment, case.rate())).collect(),
        is_reported: is_reported(&out)?,
        returned: returned(&case, &posed, &out)?,
        found_later: posed.iter().filter_map(|fragment| found_later(fragment)).collect(),
    };
    std::fs::remove_dir_all(&home).with_context(|| format!("{}: cannot be removed", home.display()))?;
    Ok(outcome)
}

/// The frames with a pose of each fragment of a run.
fn posed(case: &Case, out: &Path) -> Result<Vec<Vec<Posed>>> {
    let shots = &case.recording.shots;
    let run = Run::read(out, Value::Null)?;
    let is_live = |row: &&Value| row["state"] == "tracking" && row["on_trial"] != true;
    let live: BTreeSet<u64> =
        run.rows().iter().filter(is_live).filter_map(|row| row["index"].as_u64()).collect();
    let mut fragments = Vec::new();
    for trajectory in rendering::trajectories(out)? {
        let times = trajectory.timestamps.as_deref().unwrap_or_default();
        let posed = times.iter().zip(&trajectory.world_from_camera).filter_map(|(time, found)| {
            let frame = rendering::nearest(shots, *time)?;
            let truth = Pose::from(shots[frame].world_from_camera);
            let is_live = live.contains(&(frame as u64));
            Some(Posed { seen: case.seen[frame], time: *time, truth, found: *found, is_live })
        });
        fragments.push(posed.collect());
    }
    Ok(fragments)
}

/// How a drive that comes back is found to do so; none of other recordings.
fn returned(case: &Case, fragments: &[Vec<Posed>], out: &Path) -> Result<Option<Returned>> {
    if case.returning == 0 {
        return Ok(None);
    }
    let loops =
        Run::read(out, Value::Null)?.record("/map/loops").context("run.json counts no loops")? as usize;
    let shots = &case.recording.shots;
    let times = (shots[case.returning].timestamp, shots[shots.len() - case.returning].timestamp);
    let gap = fragments.iter().filter_map(|fragment| gap(fragment, times)).reduce(f64::min);
    Ok(Some(Returned { loops, gap }))
}

/// Whether a run says that tracking was lost, or that frames or a scale are doubtful.
fn is_reported(out: &Path) -> Result<bool> {
    let run = Run::read(out, Value::Null)?;
    let losses = run.record("/frames/losses").context("run.json counts no losses")?;
    let doubts = run.record("/frames/scale_doubts").context("run.json counts no doubts of scale")?
        + run.record("/frames/scale_breaks").unwrap_or_default();
    Ok(losses + doubts + run.record("/frames/doubted").unwrap_or_default() > 0.0)
}
