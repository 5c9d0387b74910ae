//! The clouds prepared for registration, and the correspondences between them.

use super::covariance::{Correspondence, PointNoise, TangentMatrix};
use super::error::{IcpRefusal, OpenDirection};
use super::neighbours::Neighbours;
use super::shape::{Shape, shapes};
use super::weights::quantile;
use super::{Cloud, IcpParams, POINTS_AT_A_TIME, ResidualKind, solve};
use geometry::Sim3;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// Least planarity of a target point that point-to-plane uses: below it the normal is not one.
const MIN_PLANARITY: f64 = 0.2;

/// Robust standard deviations per median of absolute values, for normal noise.
const DEVIATIONS_PER_MEDIAN: f64 = 1.4826;

/// Weight from which a correspondence counts as an inlier.
const INLIER_WEIGHT: f64 = 0.5;

/// Least last distance in median radii of the neighbourhoods: nearer, a sparse cloud has no correspondences.
const LEAST_RADII: f64 = 2.0;

/// Two clouds, the target in the normalised frame.
pub(super) struct Problem<'a> {
    source: &'a Cloud,
    target: &'a Cloud,
    neighbours: Neighbours,
    target_shapes: Vec<Shape>,
    /// Only for the residual kind that uses them.
    source_shapes: Vec<Shape>,
    kind: ResidualKind,
    /// How far apart corresponding points may be in the last iterations, extents.
    pub(super) last_max_distance: f64,
}

/// Correspondences not yet weighed.
pub(super) struct Candidates {
    /// With the metric without weights.
    pairs: Vec<(Correspondence, f64)>,
    /// Source points that have a target point near enough.
    matched: usize,
    /// Source points.
    given: usize,
}

/// Weighed correspondences and what they say of the fit.
pub(super) struct Matches {
    /// With the weights in their metrics.
    pub(super) correspondences: Vec<Correspondence>,
    /// The weights, 0 to 1, of the correspondences.
    weights: Vec<f64>,
    pub(super) inlier_share: f64,
    pub(super) overlap: f64,
    /// In extents.
    pub(super) rmse: f64,
}

impl<'a> Problem<'a> {
    /// Prepares checked clouds; `target` in the normalised frame.
    pub(super) fn new(source: &'a Cloud, target: &'a Cloud, params: &IcpParams) -> Self {
        let count = NonZero::new(params.shape_neighbours.max(4)).unwrap_or(NonZero::<usize>::MIN);
        let neighbours = Neighbours::new(&target.points);
        let target_shapes = shapes(&target.points, &neighbours, count);
        let source_shapes = match params.kind {
            ResidualKind::Generalized => shapes(&source.points, &Neighbours::new(&source.points), count),
            ResidualKind::PointToPoint | ResidualKind::PointToPlane => Vec::new(),
        };
        let radii: Vec<f64> = target_shapes.iter().map(|shape| shape.radius).collect();
        let last_max_distance = params.last_max_distance.max(LEAST_RADII * quantile(&radii, 0.5));
        Self {
            source,
            target,
            neighbours,
            target_shapes,
            source_shapes,
            kind: params.kind,
            last_max_distance,
        }
    }

    /// The nearest target point of each source point not farther than `max_distance`, in extents.
    pub(super) fn matches(&self, normalised_from_source: &Sim3, max_distance: f64) -> Candidates {
        let linear = linear_part(normalised_from_source);
        let translation = normalised_from_source.translation;
        let meet = |(source, point): (usize, &Vector3<f64>)| {
            let moved = linear * point + translation;
            let (target, squared_distance) = self.neighbours.nearest(&moved);
            if squared_distance > max_distance * max_distance {
                return None;
            }
            Some(self.metric(source, target, &linear).map(|(metric, importance)| {
                let residual: Vector3<f64> = moved - self.target.points[target];
                (Correspondence { source, target, moved, residual, metric }, importance)
            }))
        };
        let points = &self.source.points;
        let met: Vec<_> =
            points.par_iter().enumerate().with_min_len(POINTS_AT_A_TIME).filter_map(meet).collect();
        Candidates { matched: met.len(), given: points.len(), pairs: met.into_iter().flatten().collect() }
    }

    /// Ω of a pair and how much it counts before any residual is seen; `None` if not at all.
    fn metric(&self, source: usize, target: usize, linear: &Matrix3<f64>) -> Option<(Matrix3<f64>, f64)> {
        let shape = &self.target_shapes[target];
        match self.kind {
            ResidualKind::PointToPoint => Some((Matrix3::identity(), 1.0)),
            ResidualKind::PointToPlane => (shape.planarity >= MIN_PLANARITY)
                .then(|| (shape.normal * shape.normal.transpose(), shape.planarity)),
            ResidualKind::Generalized => {
                let mut of_source = self.source_shapes[source].spread;
                let mut of_target = shape.spread;
                of_source += self.source.covariances.as_ref().map_or_else(Matrix3::zeros, |all| all[source]);
                of_target += self.target.covariances.as_ref().map_or_else(Matrix3::zeros, |all| all[target]);
                let sum = of_target + linear * of_source * linear.transpose();
                sum.try_inverse().map(|inverse| ((inverse + inverse.transpose()) * 0.5, 1.0))
            }
        }
    }

    /// The covariances of the points of each correspondence, target side first moved to the normalised frame.
    pub(super) fn noise(&self, matches: &Matches, normalised_from_source: &Sim3) -> Vec<PointNoise> {
        let linear = linear_part(normalised_from_source);
        // Where only the one side knows its noise, the other's is taken as small beside it.
        let of = |cloud: &Cloud, index: usize| match self.knows_noise() && cloud.covariances.is_none() {
            true => Matrix3::zeros(),
            false => cloud.covariance(index),
        };
        matches
            .correspondences
            .iter()
            .map(|c| PointNoise {
                source: match self.knows_noise() {
                    true => linear * of(self.source, c.source) * linear.transpose(),
                    // Equally good in the unit of the target.
                    false => Matrix3::identity(),
                },
                target: of(self.target, c.target),
            })
            .collect()
    }

    /// Whether a cloud came with covariances.
    pub(super) fn knows_noise(&self) -> bool {
        self.source.covariances.is_some() || self.target.covariances.is_some()
    }

    /// The motion that the target's shape constrains least.
    pub(super) fn least_constrained(&self, matches: &Matches, estimate_scale: bool) -> OpenDirection {
        let mut sum = TangentMatrix::zeros();
        let mut total = 0.0;
        for (c, &weight) in matches.correspondences.iter().zip(&matches.weights) {
            let jacobian = c.jacobian();
            sum += jacobian.transpose() * (self.target_shapes[c.target].constrained * jacobian) * weight;
            total += weight;
        }
        solve::least_constrained(sum / total, estimate_scale)
    }
}

impl Candidates {
    /// Trims and weighs; `widening` is the kernel's width over its last width.
    pub(super) fn weighted(self, params: &IcpParams, widening: f64) -> Result<Matches, IcpRefusal> {
        let overlap = self.matched as f64 / self.given as f64;
        let (given, needed) = (self.pairs.len(), params.min_points.max(10));
        if self.matched < needed {
            return Err(IcpRefusal::LittleOverlap { overlap, needed: params.min_overlap });
        }
        if given < needed {
            return Err(IcpRefusal::FewCorrespondences { given, needed });
        }
        let residuals: Vec<f64> = self
            .pairs
            .iter()
            .map(|(c, _)| c.residual.dot(&(c.metric * c.residual)).max(0.0).sqrt())
            .collect();
        let limit = quantile(&residuals, params.keep_share);
        let deviation = DEVIATIONS_PER_MEDIAN * quantile(&residuals, 0.5);
        let width = (params.kernel_width * deviation * widening).max(1e-9);

        let (mut inliers, mut squared) = (0, 0.0);
        let mut matches = Matches {
            correspondences: Vec::with_capacity(self.pairs.len()),
            weights: Vec::with_capacity(self.pairs.len()),
            inlier_share: 0.0,
            overlap,
            rmse: 0.0,
        };
        let count = self.pairs.len() as f64;
        for ((mut c, importance), residual) in self.pairs.into_iter().zip(residuals) {
            if residual > limit {
                continue;
            }
            let robust = params.kernel.weight(residual / width);
            if robust >= INLIER_WEIGHT {
                inliers += 1;
                squared += c.residual.norm_squared();
            }
            c.metric *= robust * importance;
            matches.correspondences.push(c);
            matches.weights.push(robust * importance);
        }
        matches.inlier_share = f64::from(inliers) / count;
        matches.rmse = (squared / f64::from(inliers.max(1))).sqrt();
        Ok(matches)
    }
}

/// σR.
fn linear_part(similarity: &Sim3) -> Matrix3<f64> {
    similarity.rotation.to_rotation_matrix().into_inner() * similarity.scale
}
