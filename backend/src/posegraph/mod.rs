//! Sim(3) pose-graph optimisation over keyframes (Engel 2014, §3.6).
//!
//! Nodes are keyframe poses, edges relative similarities with a 7×7 information. The optimiser is
//! Levenberg–Marquardt on a sparse Cholesky factorisation; scale is a degree of freedom like any
//! other, so scale drift is spread around a loop when the loop closes.
//!
//! Edges that may be wrong (loops, merges) get a redescending kernel. Such a kernel would also
//! ignore a *true* loop after a long drift, so all kernels are first widened until the cost of every edge is
//! convex and then narrowed in stages. For Geman–McClure this is the graduated non-convexity of Yang et al.
//! ("Graduated Non-Convexity for Robust Spatial Perception", RA-L 2020, widening = √μ), with μ narrowed by 9
//! a stage where the paper takes 1.4, and each stage minimised where it takes one step: on maps joined by as many
//! wrong edges as right ones that is as sure and takes a quarter of the steps.
//!
//! Wrong edges that agree with each other on one other answer can still win: with nine such among twenty they do
//! in half of the cases. So the edges of a merge first pass [`consistent_set`], which is not misled as long as
//! the right ones are more; the kernel takes care of what is left.

mod consistency;
mod error;
mod kernel;
mod params;
mod residual;
mod solver;
#[cfg(test)]
pub(crate) mod tests;

pub use consistency::{ConsistencyParams, ConsistentSet, MapGraph, consistent_set};
pub use error::PoseGraphError;
pub use kernel::{KernelShape, RobustKernel};
pub use params::PoseGraphParams;
pub use residual::{EdgeResidual, evaluate_edge};

use geometry::Sim3;
use map::{Edge, KeyframeId};
use solver::Solver;
use std::collections::{BTreeMap, BTreeSet};

/// What an optimisation did.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseGraphReport {
    /// Linear systems solved, over all stages.
    pub iterations: usize,
    /// Robust cost `Σ ρ(rᵀ Λ r)` before, with the kernels at their own width.
    pub initial_cost: f64,
    /// The same cost after.
    pub final_cost: f64,
    /// Whether the last stage ended because the cost no longer fell, rather than by its iteration limit.
    pub converged: bool,
    /// Indices into the given edges of those whose kernel weight ended below
    /// [`PoseGraphParams::suppressed_weight`]: they disagree with the rest of the graph.
    pub suppressed: Vec<usize>,
}

/// Moves the nodes to the minimum of the robust cost over `edges`, holding the `fixed` ones.
///
/// With no fixed node, or in a part of the graph that hangs on none, the free gauge is held by the
/// damping alone: such a part keeps its place on the whole. The result does not depend on the number
/// of cores. On an error the nodes are as they were.
pub fn optimise(
    nodes: &mut BTreeMap<KeyframeId, Sim3>,
    edges: &[Edge],
    fixed: &BTreeSet<KeyframeId>,
    params: &PoseGraphParams,
) -> Result<PoseGraphReport, PoseGraphError> {
    optimise_with_known_scales(nodes, edges, fixed, &BTreeSet::new(), params)
}

/// The same, where the scales of the nodes in `known_scale` are known and stay: a LiDAR's keyframes are in metres. Such a
/// node moves in six degrees of freedom, λ of its tangent is zero, and through edges to others it tells them their scale.
///
/// # Errors
/// As [`optimise`].
pub fn optimise_with_known_scales(
    nodes: &mut BTreeMap<KeyframeId, Sim3>,
    edges: &[Edge],
    fixed: &BTreeSet<KeyframeId>,
    known_scale: &BTreeSet<KeyframeId>,
    params: &PoseGraphParams,
) -> Result<PoseGraphReport, PoseGraphError> {
    error::check(nodes, edges, params)?;
    let mut solver = Solver::new(nodes, edges, fixed, known_scale, params)?;
    let report = solver.run()?;
    // The solver keeps the nodes in the order of their ids.
    for (world_from_keyframe, optimised) in nodes.values_mut().zip(solver.world_from_keyframes()) {
        *world_from_keyframe = optimised;
    }
    Ok(report)
}
