//! Parameters of the pose-graph optimisation.

use super::{KernelShape, RobustKernel};
use crate::params;
use map::EdgeKind;

const HUBER: RobustKernel = RobustKernel { shape: KernelShape::Huber, width: 3.0 };
const GEMAN_MC_CLURE: RobustKernel = RobustKernel { shape: KernelShape::GemanMcClure, width: 5.0 };
const CAUCHY: RobustKernel = RobustKernel { shape: KernelShape::Cauchy, width: 5.0 };

params! {
    /// Parameters of the pose-graph optimisation.
    pub struct PoseGraphParams {
        /// Kernel of edges between successive keyframes. Default Huber 3 σ: they are hardly ever wrong.
        pub odometry: RobustKernel = HUBER,
        /// Kernel of edges between keyframes that share points. Default Huber 3 σ.
        pub covisibility: RobustKernel = HUBER,
        /// Kernel of loop edges. Default Cauchy 5 σ: a wrong loop must lose its pull. Narrower resists
        /// more false loops and trusts true ones less.
        pub loop_closure: RobustKernel = CAUCHY,
        /// Kernel of edges between merged maps. Default Geman–McClure 5 σ. Half of them may be wrong, and far
        /// wrong: by Cauchy's costs, which grow without bound, a compromise between all of them can be
        /// cheaper than the truth.
        pub merge: RobustKernel = GEMAN_MC_CLURE,
        /// Most linear systems solved in the last stage. Range 1–1000; bounds the time.
        pub max_iterations: usize = 50,
        /// Most linear systems solved in each earlier stage, while redescending kernels are still
        /// widened. Range 1–50.
        pub stage_iterations: usize = 5,
        /// The same as `min_relative_decrease` for the earlier stages, which need only find the way.
        /// Range 1e-12–1e-1.
        pub stage_min_relative_decrease: f64 = 1e-3,
        /// Factor by which the widening shrinks from stage to stage. Range 1.2–10; smaller
        /// finds better minima and costs time (Yang 2020 uses √1.4 on the width; ours is measured).
        pub stage_factor: f64 = 3.0,
        /// The last stage ends when the relative decrease of the cost falls below this. Range 1e-12–1e-2.
        pub min_relative_decrease: f64 = 1e-6,
        /// Damping relative to the diagonal in the first step. Range 0–1; the odometry is a
        /// good start, so the first step is almost Gauss–Newton.
        pub initial_damping: f64 = 1e-6,
        /// Edges whose kernel weight ends below this are reported as suppressed. Range 0–1.
        pub suppressed_weight: f64 = 0.1,
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
