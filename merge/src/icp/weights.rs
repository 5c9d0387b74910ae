//! Which correspondences count, and how much: trimming and robust kernels.

use serde::{Deserialize, Serialize};

/// How a residual loses weight as it grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobustKernel {
    /// All count the same.
    None,
    /// `1 / (1 + u²)`: never quite forgets an outlier.
    Cauchy,
    /// Geman–McClure, `1 / (1 + u²)²`: an outlier counts for nothing.
    GemanMcClure,
}

impl RobustKernel {
    /// Weight of a residual of `ratio` u times the kernel's width, 0 to 1.
    pub(super) fn weight(self, ratio: f64) -> f64 {
        let cauchy = 1.0 / (1.0 + ratio * ratio);
        match self {
            Self::None => 1.0,
            Self::Cauchy => cauchy,
            Self::GemanMcClure => cauchy * cauchy,
        }
    }
}

/// The largest of the smallest `share` of `values`: what trimming keeps is not above it. `values` not empty.
pub(super) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut values = values.to_vec();
    let rank = (share.clamp(0.0, 1.0) * values.len() as f64).ceil() as usize;
    let rank = rank.clamp(1, values.len()) - 1;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantile_is_the_value_of_its_rank() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(quantile(&values, 0.5), 2.0);
        assert_eq!(quantile(&values, 0.51), 3.0);
        assert_eq!(quantile(&values, 1.0), 4.0);
        assert_eq!(quantile(&values, 0.0), 1.0);
    }

    #[test]
    fn kernels_fall_from_one() {
        for kernel in [RobustKernel::Cauchy, RobustKernel::GemanMcClure] {
            assert_eq!(kernel.weight(0.0), 1.0);
            assert!(kernel.weight(1.0) <= 0.5 && kernel.weight(10.0) < 0.01);
        }
        assert_eq!(RobustKernel::None.weight(10.0), 1.0);
    }
}
