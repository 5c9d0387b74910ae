//! What becomes of a run to which something happens: recordings with faults rendered, and mapped by the program.

use crate::measure::Runner;
use crate::rendering;
use crate::report::{MISSING, length, number};
use anyhow::Result;
use eval::{DEFAULT_MAX_DIFF, Options, Pose, Trajectory, evaluate};
use loopbox_tests::faults::{Fault, Faulty, Shows, faulty};
use std::fmt::Write;
use std::path::Path;

/// A recording and what came of it.
pub struct Outcome {
    fault: Fault,
    seed: u64,
    /// Frames in which there is something to see, and those of them with a pose in a map of more than one frame.
    visible: usize,
    posed: usize,
    /// Frames with a pose and nothing to see.
    invented: usize,
    /// Maps in the end.
    maps: usize,
    /// Frames of the place in the map that most of them are in.
    together: usize,
    /// Frames that show the place.
    of_place: usize,
    /// Error of that map and the largest of the others', metres.
    ate: Option<f64>,
    others: Option<f64>,
}

/// Renders and maps the recordings of so many seeds.
///
/// # Errors
/// When files cannot be written or read, or the program fails.
pub fn measure(runner: &Runner, seeds: &[u64], only: &[String]) -> Result<Vec<Outcome>> {
    let wanted = |fault: &Fault| only.is_empty() || only.iter().any(|name| name == label(*fault));
    let mut all = Vec::new();
    for &seed in seeds {
        for fault in Fault::ALL.into_iter().filter(wanted) {
            let outcome = measure_one(runner, fault, seed)?;
            eprintln!("{}", row(&outcome));
            all.push(outcome);
        }
    }
    Ok(all)
}

/// A fault's name in files and tables.
fn label(fault: Fault) -> &'static str {
    match fault {
        Fault::None => "none",
        Fault::Black => "black",
        Fault::Frozen => "frozen",
        Fault::Dropped => "dropped",
        Fault::Turned => "turned",
        Fault::Covered => "covered",
        Fault::Carried => "carried",
        Fault::SimilarPlace => "alike",
        Fault::Aside => "aside",
    }
}

fn measure_one(runner: &Runner, fault: Fault, seed: u64) -> Result<Outcome> {
    let folder = runner.work.join("faults").join(format!("{}-{seed}", label(fault)));
    let made = faulty(fault, seed);
    let out = rendering::run(runner, &made.recording, &folder)?;
    judge(fault, seed, &made, &out)
}

/// Compares the trajectories of a run with the truth.
fn judge(fault: Fault, seed: u64, made: &Faulty, out: &Path) -> Result<Outcome> {
    let count = |wanted: &dyn Fn(Shows) -> bool| made.shows.iter().filter(|shows| wanted(**shows)).count();
    let mut outcome = Outcome {
        fault,
        seed,
        visible: count(&|shows| shows != Shows::Nothing),
        posed: 0,
        invented: 0,
        maps: 0,
        together: 0,
        of_place: count(&|shows| shows == Shows::Place),
        ate: None,
        others: None,
    };
    let mut maps = Vec::new();
    for trajectory in rendering::trajectories(out)? {
        let true_states = true_states(made, &trajectory);
        let of = |wanted: Shows| true_states.iter().filter(|shows| **shows == wanted).count();
        outcome.posed += of(Shows::Place) + of(Shows::Elsewhere);
        outcome.invented += of(Shows::Nothing);
        maps.push((of(Shows::Place), error(made, trajectory)));
    }
    outcome.maps = maps.len();
    maps.sort_by_key(|(frames, _)| std::cmp::Reverse(*frames));
    let mut maps = maps.into_iter();
    if let Some((together, ate)) = maps.next() {
        (outcome.together, outcome.ate) = (together, ate);
    }
    outcome.others = maps.filter_map(|(_, ate)| ate).reduce(f64::max);
    Ok(outcome)
}

/// What the frames of a trajectory show.
fn true_states(made: &Faulty, trajectory: &Trajectory) -> Vec<Shows> {
    let times = trajectory.timestamps.iter().flatten();
    times.filter_map(|time| Some(made.shows[rendering::nearest(&made.recording.shots, *time)?])).collect()
}

/// Error of a trajectory over the frames in which there is something to see, metres.
fn error(made: &Faulty, trajectory: Trajectory) -> Option<f64> {
    let seen = made.recording.shots.iter().zip(&made.shows).filter(|(_, shows)| **shows != Shows::Nothing);
    let (times, poses): (Vec<f64>, Vec<Pose>) =
        seen.map(|(shot, _)| (shot.timestamp, Pose::from(shot.world_from_camera))).unzip();
    let truth = Trajectory { timestamps: Some(times), world_from_camera: poses };
    let options = Options { max_diff: DEFAULT_MAX_DIFF.min(0.01), ..Options::default() };
    evaluate(trajectory, truth, None, &options).ok().map(|evaluation| evaluation.ate.rmse)
}

/// The table of the results page.
pub fn section(all: &[Outcome]) -> String {
    let mut out = String::from(
        "| what happens | seed | frames with something to see, of them with a pose | with nothing to see, with a pose | maps \
         (places) | frames of the place in one map | its ATE | worst ATE of the others |\n|---|---|---|---|---|---|---|---|\n",
    );
    for outcome in all {
        let _ = writeln!(out, "{}", row(outcome));
    }
    out
}

fn row(o: &Outcome) -> String {
    let metres = |error: Option<f64>| error.map_or(MISSING.to_owned(), length);
    let share = |part: usize, whole: usize| number(Some(100.0 * part as f64 / whole.max(1) as f64), 1, " %");
    format!(
        "| {} | {} | {} of {}: {} | {} | {} ({}) | {} of {}: {} | {} | {} |",
        label(o.fault),
        o.seed,
        o.posed,
        o.visible,
        share(o.posed, o.visible),
        o.invented,
        o.maps,
        o.fault.places(),
        o.together,
        o.of_place,
        share(o.together, o.of_place),
        metres(o.ate),
        metres(o.others),
    )
}
