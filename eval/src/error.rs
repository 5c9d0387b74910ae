//! What can go wrong, and how to mend it.

use geometry::umeyama::UmeyamaError;
use std::path::PathBuf;

/// Why an evaluation is not possible.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// A file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of a file is not what it should be.
    #[error("{}:{line}: {problem}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// What is wrong and what was expected.
        problem: String,
    },
    /// A file holds no pose or no time.
    #[error("{}: holds no {what}; only empty lines and comments were found", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What was expected.
        what: &'static str,
    },
    /// One trajectory has time stamps and the other has none.
    #[error(
        "one trajectory has time stamps (TUM) and the other has none (KITTI): give --frames with one time per pose"
    )]
    MixedTimes,
    /// Without time stamps poses correspond by their order, which needs equal numbers.
    #[error(
        "the estimate has {estimate} poses and the ground truth {truth}, without time stamps to match them by: \
         give --frames with one time per pose, or use TUM files"
    )]
    CountMismatch {
        /// Poses of the estimate.
        estimate: usize,
        /// Poses of the ground truth.
        truth: usize,
    },
    /// No time of one trajectory is near a time of the other.
    #[error(
        "no pose of the estimate lies within {max_diff} s of one of the ground truth: \
         are both from one recording and one clock? --max-diff widens the search{}", nanoseconds(*of_truth)
    )]
    NoPairs {
        /// The widest difference allowed, seconds.
        max_diff: f64,
        /// A time of the ground truth, as it was read as seconds.
        of_truth: f64,
    },
    /// The trajectories cannot be aligned.
    #[error("{0}; use --align none or a longer trajectory")]
    Align(#[from] UmeyamaError),
    /// One of several agents cannot be evaluated.
    #[error("agent {number}: {reason}")]
    Agent {
        /// Which of them, from 1.
        number: usize,
        /// Why not.
        reason: Box<EvalError>,
    },
    /// An estimate that is another agent's by its path.
    #[error(
        "it follows the ground truth of agent {other}, and its own not nearly as well: are the truths given in the order of \
         the estimates? Give one for each: --gt A B"
    )]
    Mistaken {
        /// That agent, from 1.
        other: usize,
    },
    /// An estimate that has nothing in common with the ground truth it was compared with.
    #[error(
        "it does not follow its ground truth: aligned alone, its positions are {rmse:.3} m off, where the truth itself \
         spreads over {spread:.3} m; is that the truth of this recording? Give one for each in their order: --gt A B"
    )]
    Stranger {
        /// RMS distance after the agent's own Sim(3) alignment, in the unit of the ground truth.
        rmse: f64,
        /// RMS distance of the true positions from their middle, in that unit.
        spread: f64,
    },
    /// A setting lies outside its range.
    #[error("{0}")]
    Setting(String),
}

/// Seconds since 1970 end before this in any recording; thousandths and finer begin beyond.
const LATEST_S: f64 = 2e10;

/// What is said of times that are none in seconds.
fn nanoseconds(time: f64) -> String {
    if time.abs() < LATEST_S {
        return String::new();
    }
    let unit = match time.abs() {
        ..2e13 => "milliseconds",
        ..2e16 => "microseconds",
        _ => "nanoseconds",
    };
    format!(
        "\nhint: the truth's times, such as {time}, look like {unit}: a trajectory has seconds in its first column"
    )
}
