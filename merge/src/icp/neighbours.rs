//! Nearest points of a cloud.

use kiddo::SquaredEuclidean;
use kiddo::immutable::float::kdtree::ImmutableKdTree;
use nalgebra::Vector3;
use std::num::NonZero;

/// A cloud sorted for the search of neighbours. It never changes, so equal clouds give equal answers.
pub(super) struct Neighbours {
    tree: ImmutableKdTree<f64, u64, 3, 32>,
}

impl Neighbours {
    /// Sorts `points`, of which there must be at least one; all finite.
    pub(super) fn new(points: &[Vector3<f64>]) -> Self {
        let points: Vec<[f64; 3]> = points.iter().map(|&point| point.into()).collect();
        Self { tree: ImmutableKdTree::new_from_slice(&points) }
    }

    /// Index of the point nearest to `position` and the squared distance to it.
    pub(super) fn nearest(&self, position: &Vector3<f64>) -> (usize, f64) {
        let found = self.tree.nearest_one::<SquaredEuclidean>(&(*position).into());
        (found.item as usize, found.distance)
    }

    /// Indices of the `count` points nearest to `position`, nearest first; fewer in a smaller cloud.
    pub(super) fn nearest_many(
        &self,
        position: &Vector3<f64>,
        count: NonZero<usize>,
    ) -> impl Iterator<Item = usize> {
        let found = self.tree.nearest_n::<SquaredEuclidean>(&(*position).into(), count);
        found.into_iter().map(|neighbour| neighbour.item as usize)
    }
}
