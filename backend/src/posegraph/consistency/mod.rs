//! Pairwise-consistent measurements between two maps (PCM; Mangelson et al., ICRA 2018).
//!
//! Two closures between the same maps make a loop: over the one, along the second map, back over the other
//! and along the first map. If both are right the loop ends where it began, up to the noise of the
//! closures and the drift of the maps. Wrong closures seldom agree with each other by chance, and less
//! often in number; so the largest set of which every two agree is taken to be the right ones.

mod clique;
mod drift;
#[cfg(test)]
mod tests;

use super::PoseGraphError;
use super::error::{check_measurement, check_nodes};
use crate::params;
use clique::VertexSet;
use drift::{Neighbours, ShortestPath};
use geometry::Sim3;
use map::{Edge, KeyframeId};
use nalgebra::SMatrix;
use std::collections::BTreeMap;

params! {
    /// Parameters of the selection of consistent closures between two maps.
    pub struct ConsistencyParams {
        /// Largest χ² of the loop of two closures that agree. Range 7–100; 24.32 is the 99.9 % quantile with
        /// 7 degrees of freedom. Higher keeps more right closures and lets more wrong ones join them.
        pub max_squared_error: f64 = 24.32,
        /// Standard deviation of the drift in position along a map, share of the way, each axis. Range 0–0.2.
        /// Higher keeps right closures that are far apart and tells less of wrong ones. Measured on our maps
        /// against ground truth: 0.0005 on rendered images, 0.02–0.03 on a car's, 0.004–0.03 on hand-held ones.
        pub drift_translation: f64 = 0.02,
        /// Standard deviation of the drift in orientation, degrees for the first edge of a way along a map;
        /// grows with the root of their number. Range 0–5; trades as above. Measured per keyframe: 0.002 on
        /// rendered images, 0.15 on a car's, 0.1–0.3 on hand-held ones.
        pub drift_rotation: f64 = 0.2,
        /// Standard deviation of the drift in the logarithm of scale for the first edge of a way; grows with
        /// the root of their number. Range 0–0.2; trades as above. Measured per keyframe: 0.0003 on rendered
        /// images, 0.015 on a car's.
        pub drift_scale: f64 = 0.015,
        /// Most branches of the search for the largest set; beyond, the best set found so far is taken. Range
        /// 1–1e8; a hundred closures need few thousand.
        pub max_steps: usize = 200_000,
    }
}

/// A map as a graph: its keyframes and the edges between them.
#[derive(Clone, Copy, Debug)]
pub struct MapGraph<'a> {
    /// `world_from_keyframe` of every keyframe.
    pub nodes: &'a BTreeMap<KeyframeId, Sim3>,
    /// Edges between them; only what they join is used here, to tell along which ways drift gathers.
    pub edges: &'a [Edge],
}

/// Which closures agree with each other.
#[derive(Clone, Debug, PartialEq)]
pub struct ConsistentSet {
    /// Indices of the closures of the largest consistent set, ascending.
    pub selected: Vec<usize>,
    /// Indices of the others, ascending.
    pub rejected: Vec<usize>,
    /// Number of closures in the largest consistent set among the rejected ones. A rival nearly as large as
    /// the selection means that the closures do not say which is right.
    pub rival: usize,
    /// Whether no larger consistent set exists. False when the search hit [`ConsistencyParams::max_steps`]
    /// and what it had found so far was taken.
    pub exact: bool,
}

/// Selects, of `closures` between keyframes of the map `from` (each one's `from`) and of the map `to`, the
/// largest set of which every two are consistent.
///
/// Both maps may be the same, then these are loops. Closures whose ends hang together in no way with those of
/// the others within a map agree with none. Measurements need a positive definite information: without
/// a covariance nothing can be said to disagree.
pub fn consistent_set(
    closures: &[Edge],
    from: MapGraph,
    to: MapGraph,
    params: &ConsistencyParams,
) -> Result<ConsistentSet, PoseGraphError> {
    let pairs = Pairs::new(closures, from, to, params)?;
    let count = closures.len();
    let mut neighbours = vec![VertexSet::empty(count); count];
    let mut all = VertexSet::empty(count);
    for second in 0..count {
        all.insert(second);
        for first in 0..second {
            let error = pairs.squared_error(first, second);
            if error.is_some_and(|error| error <= params.max_squared_error) {
                neighbours[first].insert(second);
                neighbours[second].insert(first);
            }
        }
    }
    let best = clique::largest(&neighbours, &all, params.max_steps);
    let rejected: Vec<usize> = (0..count).filter(|i| best.vertices.binary_search(i).is_err()).collect();
    let mut others = VertexSet::empty(count);
    rejected.iter().for_each(|&i| others.insert(i));
    let rival = clique::largest(&neighbours, &others, params.max_steps).vertices.len();
    Ok(ConsistentSet { selected: best.vertices, rejected, rival, exact: best.exact })
}

/// What is needed to compare any two closures.
struct Pairs<'a> {
    closures: &'a [Edge],
    from: MapGraph<'a>,
    to: MapGraph<'a>,
    covariance: Vec<SMatrix<f64, 7, 7>>,
    /// Ways from the ends of each closure, in the map `from` and in the map `to`.
    shortest_paths: Vec<[BTreeMap<KeyframeId, ShortestPath>; 2]>,
    params: &'a ConsistencyParams,
}

impl<'a> Pairs<'a> {
    fn new(
        closures: &'a [Edge],
        from: MapGraph<'a>,
        to: MapGraph<'a>,
        params: &'a ConsistencyParams,
    ) -> Result<Self, PoseGraphError> {
        check_nodes(from.nodes)?;
        check_nodes(to.nodes)?;
        let (in_from, in_to) = (Neighbours::new(&from), Neighbours::new(&to));
        let (mut covariance, mut shortest_paths) = (Vec::new(), Vec::new());
        for (index, closure) in closures.iter().enumerate() {
            for (nodes, id) in [(from.nodes, closure.from), (to.nodes, closure.to)] {
                if !nodes.contains_key(&id) {
                    return Err(PoseGraphError::UnknownKeyframe { index, missing: id });
                }
            }
            check_measurement(index, closure)?;
            let information = (closure.information + closure.information.transpose()) * 0.5;
            let inverse = information.cholesky().ok_or(PoseGraphError::InvalidInformation {
                index,
                from: closure.from,
                to: closure.to,
                what: "it is not positive definite, so there is no covariance to compare by".into(),
            })?;
            covariance.push(inverse.inverse());
            shortest_paths.push([
                in_from.shortest_paths(from.nodes, closure.from),
                in_to.shortest_paths(to.nodes, closure.to),
            ]);
        }
        Ok(Self { closures, from, to, covariance, shortest_paths, params })
    }

    /// χ² of the loop over two closures, 7 degrees of freedom; `None` when a map does not join their ends.
    ///
    /// With closures `M`, and `A`, `B` from the second's ends to the first's within the maps, the loop is
    /// `M₁ B M₂⁻¹ A⁻¹`. Left perturbations ε of the four move it, near the identity, by
    /// `ε₁ + Ad(M₁) ε_B − Ad(A) ε₂ − ε_A`. `A` stands where `M₁ B M₂⁻¹` would: it is the same for closures that
    /// agree, and a closure that is wrong by far cannot hide in the uncertainty it brings itself.
    fn squared_error(&self, first: usize, second: usize) -> Option<f64> {
        let (one, two) = (&self.closures[first], &self.closures[second]);
        let path_from = self.shortest_paths[first][0].get(&two.from)?;
        let path_to = self.shortest_paths[first][1].get(&two.to)?;
        let (from, to) = (&self.from.nodes[&one.from], &self.to.nodes[&one.to]);
        let a = from.inverse() * self.from.nodes[&two.from];
        let b = to.inverse() * self.to.nodes[&two.to];
        let error = (one.from_from_to * b * two.from_from_to.inverse() * a.inverse()).log();
        let moved = |by: SMatrix<f64, 7, 7>, covariance: SMatrix<f64, 7, 7>| by * covariance * by.transpose();
        let covariance = self.covariance[first]
            + moved(a.adjoint(), self.covariance[second])
            + path_from.covariance(from.scale, self.params)
            + moved(one.from_from_to.adjoint(), path_to.covariance(to.scale, self.params));
        Some(error.dot(&covariance.cholesky()?.solve(&error)))
    }
}
