//! What the cloud around a point looks like: a surface, an edge, or neither.

use super::POINTS_AT_A_TIME;
use super::neighbours::Neighbours;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// A direction in which the neighbourhood has this share of its largest variance counts as filled.
///
/// Ten points drawn at random from a disc seldom have a ratio below it, ten points of an edge or across a
/// surface seldom one above.
const FILLED: f64 = 0.1;

/// Variance left across a surface or an edge, relative to the variance along it (Segal et al., "Generalized-ICP",
/// RSS 2009, take the same ε).
const THICKNESS: f64 = 1e-3;

/// Variance along a surface or an edge, relative to that of the neighbourhood.
///
/// At 1 (Segal et al.) the depth noise across a surface is as large as the spread along it, and neighbours that
/// happen to lie near hold the cloud back where it should slide.
const FREEDOM: f64 = 100.0;

/// The neighbourhood of a point, from the principal components of its nearest points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    /// Direction of least spread, of length 1; on an edge it is any direction across it.
    pub(super) normal: Vector3<f64>,
    /// How much like a surface: 1 for a plane, 0 for an edge or a ball.
    pub(super) planarity: f64,
    /// Projector on the directions in which the point cannot slide: `n nᵀ` on a surface, `I − u uᵀ` on an edge
    /// along u, zero in a ball.
    pub(super) constrained: Matrix3<f64>,
    /// Covariance of where a point of the same surface or edge may lie: thin across, wide along.
    pub(super) spread: Matrix3<f64>,
    /// Root mean square distance of the neighbours from their mean.
    pub(super) radius: f64,
}

impl Shape {
    /// The shape of the neighbourhood `points`.
    fn of(points: &[Vector3<f64>]) -> Self {
        let count = points.len() as f64;
        let mean = points.iter().sum::<Vector3<f64>>() / count;
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
        let eigen = (scatter / count).symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let axes = order.map(|k| eigen.eigenvectors.column(k).into_owned());
        let largest = eigen.eigenvalues[order[0]].max(0.0);
        // A point that lies on all its neighbours can slide nowhere.
        let filled = order.map(|k| {
            let ratio = if largest > 0.0 { eigen.eigenvalues[k] / largest } else { 1.0 };
            (ratio / FILLED).clamp(0.0, 1.0)
        });
        let along: Matrix3<f64> = (0..3).map(|k| axes[k] * axes[k].transpose() * filled[k]).sum();
        Self {
            normal: axes[2],
            planarity: filled[1] - filled[2],
            constrained: Matrix3::identity() - along,
            spread: (Matrix3::identity() * THICKNESS + along * FREEDOM) * largest,
            radius: eigen.eigenvalues.sum().max(0.0).sqrt(),
        }
    }
}

/// The shape at each point from its `count` nearest points, itself among them.
pub(super) fn shapes(points: &[Vector3<f64>], neighbours: &Neighbours, count: NonZero<usize>) -> Vec<Shape> {
    let shape = |near: &mut Vec<Vector3<f64>>, point: &Vector3<f64>| {
        near.clear();
        near.extend(neighbours.nearest_many(point, count).map(|index| points[index]));
        Shape::of(near)
    };
    points.par_iter().with_min_len(POINTS_AT_A_TIME).map_init(Vec::new, shape).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::Numbers;

    fn spread_over(axes: [f64; 3]) -> Shape {
        let mut numbers = Numbers::new(4);
        let points: Vec<_> =
            (0..40).map(|_| Vector3::from_fn(|k, _| axes[k] * numbers.uniform(-1.0, 1.0))).collect();
        Shape::of(&points)
    }

    #[test]
    fn a_surface_constrains_its_normal_only() {
        let shape = spread_over([1.0, 0.0, 1.0]);
        assert!(shape.normal.y.abs() > 0.999);
        assert!(shape.planarity > 0.999);
        assert!((shape.constrained - Matrix3::from_diagonal(&Vector3::y())).norm() < 1e-9);
    }

    #[test]
    fn an_edge_constrains_all_but_its_direction() {
        let shape = spread_over([0.0, 1.0, 0.01]);
        assert!(shape.planarity < 0.01);
        assert!((shape.constrained - Matrix3::from_diagonal(&Vector3::new(1.0, 0.0, 1.0))).norm() < 0.01);
    }

    #[test]
    fn a_ball_constrains_nothing() {
        let shape = spread_over([1.0, 1.0, 1.0]);
        assert!(shape.planarity == 0.0 && shape.constrained.norm() < 1e-9);
        assert!(shape.spread.cholesky().is_some());
    }
}
