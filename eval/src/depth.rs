//! Errors of a map's inverse depths.

use crate::statistics::median_of_sorted;
use serde::Serialize;

/// Relative errors above this count as outliers.
pub const OUTLIER_BOUND: f64 = 0.1;

/// How well estimated inverse depths agree with true ones, up to one scale for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthAccuracy {
    /// Points compared.
    pub count: usize,
    /// What estimated inverse depths were multiplied by: the median of true ÷ estimated.
    pub scale: f64,
    /// Median of `|scaled estimate − truth| / truth`.
    pub median_relative_error: f64,
    /// Share of points with a relative error above [`OUTLIER_BOUND`], 0–1.
    pub outlier_share: f64,
}

/// Compares `(estimated, true)` inverse depths, all > 0 and each in one unit; `None` when there are none.
pub fn depth_accuracy(pairs: &[(f32, f32)]) -> Option<DepthAccuracy> {
    if pairs.is_empty() {
        return None;
    }
    let pairs = || pairs.iter().map(|&(estimate, truth)| (f64::from(estimate), f64::from(truth)));
    let mut ratios: Vec<f64> = pairs().map(|(estimate, truth)| truth / estimate).collect();
    ratios.sort_by(f64::total_cmp);
    let scale = median_of_sorted(&ratios);
    let mut errors: Vec<f64> =
        pairs().map(|(estimate, truth)| (scale * estimate - truth).abs() / truth).collect();
    errors.sort_by(f64::total_cmp);
    let outliers = errors.len() - errors.partition_point(|&e| e <= OUTLIER_BOUND);
    Some(DepthAccuracy {
        count: errors.len(),
        scale,
        median_relative_error: median_of_sorted(&errors),
        outlier_share: outliers as f64 / errors.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_is_free_and_outliers_count() {
        let truth = [0.1f32, 0.2, 0.3, 0.4, 0.5];
        let mut pairs: Vec<(f32, f32)> = truth.iter().map(|&t| (t * 4.0, t)).collect();
        let exact = depth_accuracy(&pairs).unwrap();
        assert!((exact.scale - 0.25).abs() < 1e-7 && exact.median_relative_error < 1e-6);
        pairs[0].0 *= 1.2;
        pairs[1].0 *= 1.05;
        let off = depth_accuracy(&pairs).unwrap();
        assert_eq!((off.count, off.outlier_share), (5, 0.2));
        assert!((off.scale - 0.25).abs() < 1e-7);
        assert_eq!(depth_accuracy(&[]), None);
    }
}
