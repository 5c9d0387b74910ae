//! All measures of one estimate.

use crate::align::alignment;
use crate::coverage::FRAME_TOLERANCE;
use crate::{
    AlignMode, Associated, Coverage, DEFAULT_MAX_DIFF, Delta, EvalError, Rpe, SegmentErrors, Statistics,
    Trajectory, associate, ate, coverage, rpe, segment_errors,
};
use geometry::Sim3;
use serde::Serialize;

/// How an estimate is compared with its ground truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// What is adjusted first. Default Sim(3).
    pub align: AlignMode,
    /// Widest time difference of a pair, seconds, ≥ 0. Default [`DEFAULT_MAX_DIFF`].
    pub max_diff: f64,
    /// Interval of the relative pose error. Default one frame.
    pub delta: Delta,
    /// Whether RPE pairs overlap. Default no, as `evo` does.
    pub all_pairs: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            align: AlignMode::default(),
            max_diff: DEFAULT_MAX_DIFF,
            delta: Delta::Frames(1),
            all_pairs: false,
        }
    }
}

/// All measures of one estimate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Poses compared.
    pub pairs: usize,
    /// What was adjusted.
    pub align: AlignMode,
    /// Maps the estimate into the frame and unit of the ground truth.
    pub truth_from_estimate: Sim3,
    /// Absolute trajectory error, in the unit of the ground truth.
    pub ate: Statistics,
    /// Relative pose error; `None` when the trajectory is shorter than the interval.
    pub rpe: Option<Rpe>,
    /// KITTI segment errors; `None` when the path is too short for any.
    pub segments: Option<SegmentErrors>,
    /// Share of the recording's frames with an estimate, or of the ground truth's poses when the frames are
    /// not given; `None` without time stamps.
    pub coverage: Option<Coverage>,
}

/// Compares an estimate with its ground truth. `frames` are the times of the recording's frames, seconds:
/// they say how many frames there were to estimate, and give time stamps to files without (KITTI).
pub fn evaluate(
    estimate: Trajectory,
    truth: Trajectory,
    frames: Option<&[f64]>,
    options: &Options,
) -> Result<Evaluation, EvalError> {
    let matched = Matched::new(estimate, truth, frames, options.max_diff)?;
    let truth_from_estimate = alignment(&matched.pairs, options.align)?;
    matched.measured(&truth_from_estimate, options)
}

/// An estimate that is matched with its ground truth, but not aligned.
pub(crate) struct Matched {
    pub pairs: Associated,
    coverage: Option<Coverage>,
}

impl Matched {
    /// Finds the poses that belong together and counts them; see [`evaluate`].
    pub(crate) fn new(
        estimate: Trajectory,
        truth: Trajectory,
        frames: Option<&[f64]>,
        max_diff: f64,
    ) -> Result<Self, EvalError> {
        let (estimate, truth) = match frames {
            Some(times) => (stamped(estimate, times)?, stamped(truth, times)?),
            None => (estimate, truth),
        };
        let pairs = associate(&estimate, &truth, max_diff)?;
        let coverage = match (&estimate.timestamps, frames, &truth.timestamps) {
            (Some(estimated), Some(frames), _) => Some(coverage(frames, estimated, FRAME_TOLERANCE)),
            (Some(estimated), None, Some(truth)) => Some(coverage(truth, estimated, max_diff)),
            _ => None,
        };
        Ok(Self { pairs, coverage })
    }

    /// All measures after `truth_from_estimate`, which was found by `options.align`.
    pub(crate) fn measured(
        &self,
        truth_from_estimate: &Sim3,
        options: &Options,
    ) -> Result<Evaluation, EvalError> {
        let aligned = self.pairs.transformed(truth_from_estimate);
        Ok(Evaluation {
            pairs: aligned.len(),
            align: options.align,
            truth_from_estimate: *truth_from_estimate,
            ate: ate(&aligned).ok_or(EvalError::NoPairs { max_diff: options.max_diff, of_truth: 0.0 })?,
            rpe: rpe(&aligned, options.delta, options.all_pairs)?,
            segments: segment_errors(&aligned),
            coverage: self.coverage,
        })
    }
}

fn stamped(trajectory: Trajectory, times: &[f64]) -> Result<Trajectory, EvalError> {
    let poses = trajectory.len();
    trajectory.with_timestamps(times).ok_or_else(|| {
        let frames = times.len();
        EvalError::Setting(format!(
            "{poses} poses without time stamps for {frames} frame times: one row per frame is needed"
        ))
    })
}
