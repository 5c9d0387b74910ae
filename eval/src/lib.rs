//! How good an estimated trajectory or map is, measured against ground truth.
//!
//! The measures are those of the field: absolute trajectory error (ATE) and relative pose error (RPE) of
//! Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems" (IROS 2012), the segment errors of
//! the KITTI odometry benchmark (Geiger et al., CVPR 2012), and the depth errors of semi-dense maps.
//! This crate knows trajectories and numbers only: nothing of maps, images or how an estimate was made.

mod agents;
mod align;
mod associate;
mod ate;
mod coverage;
mod depth;
mod error;
mod evaluation;
mod read;
mod rpe;
mod segments;
mod statistics;
mod trajectory;
mod warp;

pub use agents::{AgentEvaluation, AgentTracks, AgentsEvaluation, MergeError, evaluate_agents};
pub use align::{AlignMode, align};
pub use associate::{Associated, DEFAULT_MAX_DIFF, associate};
pub use ate::ate;
pub use coverage::{Coverage, coverage};
pub use depth::{DepthAccuracy, InverseDepthPair, OUTLIER_BOUND, depth_accuracy};
pub use error::EvalError;
pub use evaluation::{Evaluation, Options, evaluate};
pub use read::{read_times, read_trajectory};
pub use rpe::{Delta, Rpe, rpe};
pub use segments::{LengthError, SegmentErrors, segment_errors};
pub use statistics::Statistics;
pub use trajectory::{Pose, Trajectory};
pub use warp::warp_inverse_depth;
