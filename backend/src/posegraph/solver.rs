//! Levenberg–Marquardt over the graph, with kernels narrowed in stages.

use super::residual::residual;
use super::{PoseGraphError, PoseGraphParams, PoseGraphReport, RobustKernel, evaluate_edge};
use crate::block_system::{BlockSlot, BlockSystem};
use geometry::Sim3;
use map::{Edge, KeyframeId};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Damping beyond which no step can lower the cost by more than rounding.
const MAX_DAMPING: f64 = 1e8;

/// Where λ is in a tangent.
const SCALE: usize = 6;

/// Fewest edges that are worth a thread of their own.
const EDGES_AT_A_TIME: usize = 32;

/// An edge in terms of node indices.
struct Constraint {
    from: usize,
    to: usize,
    from_from_to: Sim3,
    information: SMatrix<f64, 7, 7>,
    kernel: RobustKernel,
    /// Where the coupling block lies, when both ends are free.
    slot: Option<BlockSlot>,
}

/// An edge's part of the normal equations: blocks and gradients of its ends, block between them.
struct Contribution {
    from: Option<(SMatrix<f64, 7, 7>, SVector<f64, 7>)>,
    to: Option<(SMatrix<f64, 7, 7>, SVector<f64, 7>)>,
    pair: Option<SMatrix<f64, 7, 7>>,
}

/// The state of one optimisation.
pub(super) struct Solver<'a> {
    params: &'a PoseGraphParams,
    /// `keyframe_from_world` of every node in order of id.
    poses: Vec<Sim3>,
    /// Index among the free nodes.
    free: Vec<Option<usize>>,
    /// Whether a node's scale stays as it is.
    known_scale: Vec<bool>,
    constraints: Vec<Constraint>,
    system: BlockSystem<7>,
}

impl<'a> Solver<'a> {
    /// Sets up the pattern of the linear system; the input was checked.
    pub(super) fn new(
        nodes: &BTreeMap<KeyframeId, Sim3>,
        edges: &[Edge],
        fixed: &BTreeSet<KeyframeId>,
        known_scale: &BTreeSet<KeyframeId>,
        params: &'a PoseGraphParams,
    ) -> Result<Self, PoseGraphError> {
        let index: BTreeMap<KeyframeId, usize> = nodes.keys().enumerate().map(|(i, &id)| (id, i)).collect();
        let mut free_count = 0;
        let mut number = |id| {
            let is_free = !fixed.contains(id);
            free_count += is_free as usize;
            is_free.then(|| free_count - 1)
        };
        let free: Vec<Option<usize>> = nodes.keys().map(&mut number).collect();
        let mut constraints: Vec<Constraint> = edges
            .iter()
            .map(|edge| Constraint {
                from: index[&edge.from],
                to: index[&edge.to],
                from_from_to: edge.from_from_to,
                information: (edge.information + edge.information.transpose()) * 0.5,
                kernel: params.kernel(edge.kind),
                slot: None,
            })
            .collect();
        let coupled = |c: &Constraint| {
            let (from, to) = (free[c.from]?, free[c.to]?);
            Some((from.max(to), from.min(to)))
        };
        let system = BlockSystem::new(free_count, constraints.iter().filter_map(coupled))?;
        for constraint in &mut constraints {
            constraint.slot = coupled(constraint).map(|(greater, smaller)| system.slot(greater, smaller));
        }
        let poses = nodes.values().map(Sim3::inverse).collect();
        let known_scale = nodes.keys().map(|id| known_scale.contains(id)).collect();
        Ok(Self { params, poses, free, known_scale, constraints, system })
    }

    /// The nodes as they stand, in order of id.
    pub(super) fn world_from_keyframes(&self) -> impl Iterator<Item = Sim3> + '_ {
        self.poses.iter().map(|pose| {
            let mut world_from_keyframe = pose.inverse();
            world_from_keyframe.rotation.renormalize();
            world_from_keyframe
        })
    }

    /// Runs all stages.
    pub(super) fn run(&mut self) -> Result<PoseGraphReport, PoseGraphError> {
        let initial_cost = self.cost(&self.poses, 1.0);
        let mut iterations = 0;
        let mut converged = true;
        if self.free.iter().any(Option::is_some) && !self.constraints.is_empty() {
            let factor = self.params.stage_factor.max(1.2);
            let mut widening = self.first_widening();
            while widening > 1.0 {
                let params = self.params;
                iterations +=
                    self.minimise(widening, params.stage_iterations, params.stage_min_relative_decrease).0;
                widening /= factor;
            }
            let (last, ended) =
                self.minimise(1.0, self.params.max_iterations, self.params.min_relative_decrease);
            iterations += last;
            converged = ended;
        }
        let suppressed = (0..self.constraints.len())
            .filter(|&i| {
                let constraint = &self.constraints[i];
                constraint.kernel.weight(self.squared_error(constraint, &self.poses))
                    < self.params.suppressed_weight
            })
            .collect();
        let final_cost = self.cost(&self.poses, 1.0);
        Ok(PoseGraphReport { iterations, initial_cost, final_cost, converged, suppressed })
    }

    /// How much the kernels must widen for the cost of every edge to be convex where the edge stands.
    fn first_widening(&self) -> f64 {
        self.constraints
            .iter()
            .map(|c| self.squared_error(c, &self.poses).sqrt() / c.kernel.convex_within())
            .fold(1.0, f64::max)
            .min(1e6)
    }

    /// Levenberg–Marquardt with one set of kernels; gives the systems solved and whether it settled.
    fn minimise(&mut self, widening: f64, max_iterations: usize, min_decrease: f64) -> (usize, bool) {
        let mut damping = self.params.initial_damping;
        let mut cost = self.cost(&self.poses, widening);
        self.linearise(widening);
        for iteration in 1..=max_iterations {
            let Some((step, promised)) = self.step(damping) else {
                damping = (damping * 10.0).max(1e-9);
                if damping > MAX_DAMPING {
                    return (iteration, true);
                }
                continue;
            };
            // Half the cost is what the quadratic model promises to lower.
            if 2.0 * promised <= min_decrease * cost {
                self.accept_if_better(&step, widening, &mut cost);
                return (iteration, true);
            }
            let before = cost;
            if !self.accept_if_better(&step, widening, &mut cost) {
                damping = (damping * 10.0).max(1e-9);
                if damping > MAX_DAMPING {
                    return (iteration, true);
                }
                continue;
            }
            if before - cost <= min_decrease * before {
                return (iteration, true);
            }
            damping *= 0.2;
            self.linearise(widening);
        }
        (max_iterations, false)
    }

    /// The step `δ = −(H + damping·diag(H))⁻¹ g` and the decrease `−gᵀδ − ½ δᵀHδ` that it promises
    /// of half the cost; `None` when the damped matrix is not positive definite.
    fn step(&mut self, damping: f64) -> Option<(Vec<f64>, f64)> {
        let largest = self.system.diagonal().fold(0.0, f64::max);
        // A floor keeps nodes without edges, and free gauges, solvable: they do not move.
        let floor = 1e-12 * largest.max(f64::MIN_POSITIVE);
        let added = |diagonal: f64| damping * diagonal + floor;
        self.system.damp(added);
        let step = self.system.solve()?;
        // With (H + D) δ = −g the promise −gᵀδ − ½ δᵀHδ becomes ½ (δᵀDδ − gᵀδ).
        let promised = step
            .iter()
            .zip(self.system.gradient())
            .zip(self.system.diagonal())
            .map(|((d, g), diagonal)| 0.5 * (added(diagonal) * d * d - g * d))
            .sum();
        Some((step, promised))
    }

    /// Takes the step when it lowers the cost.
    fn accept_if_better(&mut self, step: &[f64], widening: f64, cost: &mut f64) -> bool {
        let mut moved = self.poses.clone();
        for (pose, free) in moved.iter_mut().zip(&self.free) {
            if let Some(free) = free {
                *pose = Sim3::exp(&SVector::from_column_slice(&step[free * 7..free * 7 + 7])) * *pose;
            }
        }
        let new_cost = self.cost(&moved, widening);
        // Also false for NaN: a step out of bounds is no step.
        let better = new_cost < *cost;
        if better {
            self.poses = moved;
            *cost = new_cost;
        }
        better
    }

    /// Fills the normal equations at the present poses.
    fn linearise(&mut self, widening: f64) {
        // Edges are evaluated side by side and added in their order: the sums do not depend on the cores.
        let parts: Vec<Option<Contribution>> = self
            .constraints
            .par_iter()
            .with_min_len(EDGES_AT_A_TIME)
            .map(|constraint| self.contribution(constraint, widening))
            .collect();
        self.system.clear();
        for (constraint, part) in self.constraints.iter().zip(parts) {
            let Some(part) = part else { continue };
            if let (Some(node), Some((block, gradient))) = (self.free[constraint.from], part.from) {
                self.system.add_node(node, &block, &gradient);
            }
            if let (Some(node), Some((block, gradient))) = (self.free[constraint.to], part.to) {
                self.system.add_node(node, &block, &gradient);
            }
            if let (Some(slot), Some(block)) = (constraint.slot, part.pair) {
                self.system.add_pair(slot, &block);
            }
        }
    }

    /// What an edge adds to the normal equations; nothing when both its ends are fixed.
    fn contribution(&self, constraint: &Constraint, widening: f64) -> Option<Contribution> {
        let (from, to) = (self.free[constraint.from], self.free[constraint.to]);
        from.or(to)?;
        let (from_pose, to_pose) = (&self.poses[constraint.from], &self.poses[constraint.to]);
        let edge = evaluate_edge(from_pose, to_pose, &constraint.from_from_to);
        let weighted = constraint.information * edge.residual;
        let kernel = constraint.kernel.widened(widening);
        let weight = kernel.weight(edge.residual.dot(&weighted));
        let (weighted, information) = (weighted * weight, constraint.information * weight);
        // by_to is by_from followed by −Ad, so the other blocks follow from the first.
        let block = edge.by_from.transpose() * information * edge.by_from;
        let gradient = edge.by_from.transpose() * weighted;
        let mut coupling = block * edge.adjoint;
        let mut of_from = (block, gradient);
        let mut of_to = (edge.adjoint.transpose() * coupling, -(edge.adjoint.transpose() * gradient));
        // Without any part in λ a node's scale stays: the floor below is all that its equation has.
        if self.known_scale[constraint.from] {
            without_scale(&mut of_from);
            coupling.row_mut(SCALE).fill(0.0);
        }
        if self.known_scale[constraint.to] {
            without_scale(&mut of_to);
            coupling.column_mut(SCALE).fill(0.0);
        }
        Some(Contribution {
            from: from.map(|_| of_from),
            to: to.map(|_| of_to),
            pair: constraint.slot.map(|_| if from > to { -coupling } else { -coupling.transpose() }),
        })
    }

    fn squared_error(&self, constraint: &Constraint, poses: &[Sim3]) -> f64 {
        let r = residual(&poses[constraint.from], &poses[constraint.to], &constraint.from_from_to);
        // Rounding may turn the error of an ill-conditioned information slightly negative.
        r.dot(&(constraint.information * r)).max(0.0)
    }

    fn cost(&self, poses: &[Sim3], widening: f64) -> f64 {
        let cost = |c: &Constraint| c.kernel.widened(widening).cost(self.squared_error(c, poses));
        let costs: Vec<f64> = self.constraints.par_iter().with_min_len(EDGES_AT_A_TIME).map(cost).collect();
        costs.into_iter().sum()
    }
}

/// Takes λ out of a node's part of the normal equations.
fn without_scale((block, gradient): &mut (SMatrix<f64, 7, 7>, SVector<f64, 7>)) {
    block.row_mut(SCALE).fill(0.0);
    block.column_mut(SCALE).fill(0.0);
    gradient[SCALE] = 0.0;
}
