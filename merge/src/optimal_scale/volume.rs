//! The ratio of two clouds' volumes.

use geometry::Sim3;
use nalgebra::Vector3;

/// Share of the points left out at either end of each axis: far, wrong points would else make the box.
const TRIM: f64 = 0.05;
/// Fewest points of a cloud: fewer have no 5 % quantile.
const MIN_POINTS: usize = 20;

/// r_vol of Algorithm 1: the smaller of two clouds' bounding volumes over the larger, in (0, 1].
///
/// `target_from_source` (rotation and σ; the translation does not matter) brings the source cloud to the
/// target's axes and unit first, so 1 means that both fill boxes of the same size. Each box spans the 5 % to
/// 95 % quantiles of the coordinates. `None` if a cloud has fewer than 20 points, lies in a plane along the
/// axes, or holds a number that is not finite. The paper says only "volume ratio"; boxes and quantiles are
/// ours.
pub fn volume_ratio(
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    target_from_source: &Sim3,
) -> Option<f64> {
    let moved: Vec<_> = source.iter().map(|&point| *target_from_source * point).collect();
    let (a, b) = (bounding_volume(&moved)?, bounding_volume(target)?);
    Some(a.min(b) / a.max(b))
}

/// Volume of the box between the trimmed quantiles.
fn bounding_volume(points: &[Vector3<f64>]) -> Option<f64> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let trimmed = (TRIM * points.len() as f64) as usize;
    let extent = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() - 1 - trimmed] - values[trimmed]
    };
    let finite = points.iter().all(|point| point.iter().all(|v| v.is_finite()));
    let volume = extent(0) * extent(1) * extent(2);
    Some(volume).filter(|volume| finite && volume.is_finite() && *volume > 0.0)
}
