//! Trajectories in files compared with the truth in files, as people name them.

use anyhow::{Result, bail};
use eval::{Evaluation, Options, read_times, read_trajectory};
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
    Ok(eval::evaluate(estimate, read_trajectory(truth)?, frames.as_deref(), options)?)
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
