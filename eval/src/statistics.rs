//! One number's spread over a trajectory.

use serde::{Deserialize, Serialize};

/// Statistics of a list of errors, in the unit of the errors (`sse` in its square).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// How many errors there are.
    pub count: usize,
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; the mean of the middle two when their number is even.
    pub median: f64,
    /// Standard deviation of the population (divided by the count).
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Sum of squares.
    pub sse: f64,
}

impl Statistics {
    /// The statistics of `errors`; `None` when there are none.
    pub fn of(errors: &[f64]) -> Option<Self> {
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (&min, &max) = (sorted.first()?, sorted.last()?);
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let sse = sorted.iter().map(|e| e * e).sum::<f64>();
        let variance = sorted.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n;
        Some(Self {
            count: sorted.len(),
            rmse: (sse / n).sqrt(),
            mean,
            median: median_of_sorted(&sorted),
            std: variance.sqrt(),
            min,
            max,
            sse,
        })
    }
}

/// The median of a sorted list that is not empty.
pub(crate) fn median_of_sorted(sorted: &[f64]) -> f64 {
    let middle = sorted.len() / 2;
    if sorted.len() % 2 == 1 { sorted[middle] } else { 0.5 * (sorted[middle - 1] + sorted[middle]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_four_numbers() {
        let s = Statistics::of(&[4.0, 1.0, 1.0, 2.0]).unwrap();
        assert_eq!((s.count, s.mean, s.median, s.min, s.max, s.sse), (4, 2.0, 1.5, 1.0, 4.0, 22.0));
        assert_eq!((s.rmse, s.std), (5.5f64.sqrt(), 1.5f64.sqrt()));
        assert_eq!(Statistics::of(&[]), None);
    }
}
