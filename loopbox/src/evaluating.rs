//! Trajectories in files compared with the truth in files, as people name them.

use crate::results::file_names::{LIVE_TRAJECTORY, TRAJECTORY, numbered};
use anyhow::{Result, bail};
use eval::{Evaluation, Options, Trajectory, read_times, read_trajectory};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Compares the trajectory at `estimate`, a file or the folder of a run, with the truth; `frames` names the times of the
/// recording's frames, which coverage counts.
///
/// ```no_run
/// use loopbox::evaluating::evaluate;
///
/// let evaluation = evaluate("out/a".as_ref(), "demo/parking_a/groundtruth.txt".as_ref(), None, &Default::default())?;
/// println!("{:.4} m", evaluation.ate.rmse);
/// # Ok::<(), anyhow::Error>(())
/// ```
///
/// # Errors
/// When a file cannot be read, or the two have no times in common.
pub fn evaluate(
    estimate: &Path,
    truth: &Path,
    frames: Option<&Path>,
    options: &Options,
) -> Result<Evaluation> {
    let frames = frames.map(read_times).transpose()?;
    let estimate = read_trajectory(&trajectory_at(estimate)?)?;
    Ok(eval::evaluate(estimate, read_truth(truth)?, frames.as_deref(), options)?)
}

/// A part of a run that hangs together with no other, compared with the truth.
#[derive(Clone, Debug, Serialize)]
pub struct Fragment {
    /// Its file in the folder of the run.
    pub trajectory: String,
    /// How far it is from the truth, aligned by itself: it has a world and a unit of its own. `None` where it has too few
    /// poses, or none at the times of the truth.
    #[serde(flatten)]
    pub evaluation: Option<Evaluation>,
}

/// The other fragments of the run whose results are at `estimate`, each compared by itself; none where that is a file.
///
/// # Errors
/// When a file cannot be read.
pub fn other_fragments(
    estimate: &Path,
    truth: &Trajectory,
    frames: Option<&[f64]>,
    options: &Options,
) -> Result<Vec<Fragment>> {
    let names = (1..).map(|place| numbered(TRAJECTORY, place));
    let there = names.take_while(|name| estimate.join(name).is_file());
    there
        .map(|trajectory| {
            let poses = read_trajectory(&estimate.join(&trajectory))?;
            let evaluation = eval::evaluate(poses, truth.clone(), frames, options).ok();
            Ok(Fragment { trajectory, evaluation })
        })
        .collect()
}

/// Reads a true trajectory of a camera. EuRoC's ground truth is of the body: where it lies beside `cam0`, as
/// in `mav0/state_groundtruth_estimate0/data.csv`, the camera's place on the body is taken from `cam0/sensor.yaml`.
///
/// # Errors
/// When the file cannot be read, or the `sensor.yaml` that belongs to it.
pub fn read_truth(path: &Path) -> Result<Trajectory> {
    let truth = read_trajectory(path)?;
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let of_euroc = whole.extension().is_some_and(|extension| extension == "csv");
    let sensor = whole.parent().and_then(Path::parent).map(|mav| mav.join("cam0/sensor.yaml"));
    match sensor.filter(|sensor| of_euroc && sensor.is_file()) {
        Some(sensor) => Ok(match calib::read_body_from_camera(&sensor)? {
            Some(body_from_camera) => truth.seen_from(&body_from_camera),
            None => truth,
        }),
        None => Ok(truth),
    }
}

/// The trajectories in the folder of a merge, in order of their names.
fn trajectories_of_agents(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_one = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("trajectory-") && name.ends_with(".txt") && *name != *LIVE_TRAJECTORY
    };
    let mut found: Vec<String> = entries.filter(is_one).map(|path| path.display().to_string()).collect();
    found.sort();
    found
}

/// The file of an estimate: it itself, or that in the folder of a run.
///
/// # Errors
/// When the folder holds none.
pub fn trajectory_at(path: &Path) -> Result<PathBuf> {
    let file = path.join(TRAJECTORY);
    match (path.is_dir(), file.is_file()) {
        (false, _) => Ok(path.to_owned()),
        (true, true) => Ok(file),
        (true, false) => match trajectories_of_agents(path).as_slice() {
            [] => bail!(
                "{}: holds no trajectory.txt\nhint: give the folder of a run, or a trajectory; `loopbox export --tum` writes \
                 that of a map",
                path.display()
            ),
            several => bail!(
                "{}: holds the trajectories of several agents\nhint: give those to be measured, before --gt with one truth for each \
                 in the same order: {}",
                path.display(),
                several.join(" ")
            ),
        },
    }
}
