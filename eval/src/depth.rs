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
    /// Median of the squared errors over their stated variances (normalised estimation error squared): 0.45 where the variances
    /// are true and the errors normal, more where they are stated too small.
    pub median_nees: f64,
    /// Their mean: 1 where the variances are true. Few wrong depths make it large.
    pub mean_nees: f64,
    /// Share of points within two stated standard deviations, 0–1: 0.95 where these are true.
    pub within_two_deviations: f64,
}

/// A point's inverse depth as it was estimated, and as it is, each > 0 and in a unit of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthPair {
    /// Estimated, in 1/unit of the map.
    pub estimate: f32,
    /// Standard deviation that is stated of it, 1/unit of the map.
    pub deviation: f32,
    /// What it is, 1/unit of the truth.
    pub truth: f32,
}

/// Compares estimated inverse depths with true ones; `None` when there are none.
pub fn depth_accuracy(pairs: &[InverseDepthPair]) -> Option<DepthAccuracy> {
    if pairs.is_empty() {
        return None;
    }
    let ratio = |pair: &InverseDepthPair| f64::from(pair.truth) / f64::from(pair.estimate);
    let scale = median_of_sorted(&sorted(pairs.iter().map(ratio)));
    let error = |pair: &InverseDepthPair| (scale * f64::from(pair.estimate) - f64::from(pair.truth)).abs();
    let errors = sorted(pairs.iter().map(|pair| error(pair) / f64::from(pair.truth)));
    let outliers = errors.len() - errors.partition_point(|&e| e <= OUTLIER_BOUND);
    let normalised = sorted(pairs.iter().map(|pair| error(pair) / (scale * f64::from(pair.deviation))));
    Some(DepthAccuracy {
        count: errors.len(),
        scale,
        median_relative_error: median_of_sorted(&errors),
        outlier_share: outliers as f64 / errors.len() as f64,
        median_nees: median_of_sorted(&normalised).powi(2),
        mean_nees: normalised.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64,
        within_two_deviations: normalised.partition_point(|&e| e <= 2.0) as f64 / errors.len() as f64,
    })
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_is_free_and_outliers_count() {
        let pair = |truth: f32| InverseDepthPair { estimate: truth * 4.0, deviation: 0.4 * truth, truth };
        let mut pairs = [0.1, 0.2, 0.3, 0.4, 0.5].map(pair);
        let exact = depth_accuracy(&pairs).unwrap();
        assert!((exact.scale - 0.25).abs() < 1e-7 && exact.median_relative_error < 1e-6);
        pairs[0].estimate *= 1.2;
        pairs[1].estimate *= 1.05;
        let off = depth_accuracy(&pairs).unwrap();
        assert_eq!((off.count, off.outlier_share), (5, 0.2));
        assert!((off.scale - 0.25).abs() < 1e-7);
        assert_eq!(depth_accuracy(&[]), None);
    }

    #[test]
    fn deviations_are_compared_with_the_errors_whatever_the_unit() {
        let mut random = geometry::Random::new(3);
        let mut pair = |stated: f64| {
            let error = 0.02 * random.normal();
            InverseDepthPair {
                estimate: (8.0 * (1.0 + error)) as f32,
                deviation: (0.16 * stated) as f32,
                truth: 2.0,
            }
        };
        let honest: Vec<_> = (0..4000).map(|_| pair(1.0)).collect();
        let bold: Vec<_> = (0..4000).map(|_| pair(0.25)).collect();
        let (honest, bold) = (depth_accuracy(&honest).unwrap(), depth_accuracy(&bold).unwrap());
        assert!((honest.within_two_deviations - 0.954).abs() < 0.02, "{honest:?}");
        assert!((honest.median_nees - 0.455).abs() < 0.06, "{honest:?}");
        assert!(
            (honest.mean_nees - 1.0).abs() < 0.1 && (bold.mean_nees - 16.0).abs() < 1.6,
            "{honest:?} {bold:?}"
        );
        assert!((bold.within_two_deviations - 0.383).abs() < 0.04 && bold.median_nees > 5.0, "{bold:?}");
    }
}
