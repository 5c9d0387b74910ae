//! Parameters of the pose-graph optimisation.

use super::{KernelShape, RobustKernel};
use map::EdgeKind;
use serde::{Deserialize, Serialize};

/// Parameters of the pose-graph optimisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseGraphParams {
    /// Kernel of edges between successive keyframes. Default Huber 3 σ: they are hardly ever wrong.
    pub odometry: RobustKernel,
    /// Kernel of edges between keyframes that share points. Default Huber 3 σ.
    pub covisibility: RobustKernel,
    /// Kernel of loop edges. Default Cauchy 5 σ: a wrong loop must lose its pull. Narrower resists
    /// more false loops and trusts true ones less.
    pub loop_closure: RobustKernel,
    /// Kernel of edges between merged maps. Default Cauchy 5 σ, as loops.
    pub merge: RobustKernel,
    /// Most linear systems solved in the last stage. Default 50, range 1–1000; bounds the time.
    pub max_iterations: usize,
    /// Most linear systems solved in each earlier stage, while redescending kernels are still
    /// widened. Default 5, range 1–50.
    pub stage_iterations: usize,
    /// Factor by which the widening shrinks from stage to stage. Default 3, range 1.2–10; smaller
    /// finds better minima and costs time (Yang 2020 uses √1.4 on the width; ours is measured).
    pub stage_factor: f64,
    /// A stage ends when the relative decrease of the cost falls below this. Default 1e-6, range 1e-12–1e-2.
    pub min_relative_decrease: f64,
    /// Damping relative to the diagonal in the first step. Default 1e-6, range 0–1; the odometry is a
    /// good start, so the first step is almost Gauss–Newton.
    pub initial_damping: f64,
    /// Edges whose kernel weight ends below this are reported as suppressed. Default 0.1, range 0–1.
    pub suppressed_weight: f64,
}

impl Default for PoseGraphParams {
    fn default() -> Self {
        let huber = RobustKernel { shape: KernelShape::Huber, width: 3.0 };
        let cauchy = RobustKernel { shape: KernelShape::Cauchy, width: 5.0 };
        Self {
            odometry: huber,
            covisibility: huber,
            loop_closure: cauchy,
            merge: cauchy,
            max_iterations: 50,
            stage_iterations: 5,
            stage_factor: 3.0,
            min_relative_decrease: 1e-6,
            initial_damping: 1e-6,
            suppressed_weight: 0.1,
        }
    }
}

impl PoseGraphParams {
    /// The kernel of edges of a kind.
    pub fn kernel(&self, kind: EdgeKind) -> RobustKernel {
        match kind {
            EdgeKind::Odometry => self.odometry,
            EdgeKind::Covisibility => self.covisibility,
            EdgeKind::Loop => self.loop_closure,
            EdgeKind::Merge => self.merge,
        }
    }
}
