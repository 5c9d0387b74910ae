//! Trajectories in files compared with the truth in files, as people name them.

use anyhow::{Result, bail};
use eval::{Evaluation, Options, Trajectory, read_times, read_trajectory};
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

/// The file of an estimate: it itself, or that in the folder of a run.
///
/// # Errors
/// When the folder holds none.
pub fn trajectory_at(path: &Path) -> Result<PathBuf> {
    let file = path.join("trajectory.txt");
    match (path.is_dir(), file.is_file()) {
        (false, _) => Ok(path.to_owned()),
        (true, true) => Ok(file),
        (true, false) => bail!(
            "{}: holds no trajectory.txt\nhint: give the folder of a run, or a trajectory; `loopbox export --tum` writes \
             that of a map",
            path.display()
        ),
    }
}
