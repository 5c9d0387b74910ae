//! Fusing an observation into a hypothesis.

/// Growth of the variance at each fused observation (Engel 2013: the model is never exact).
const GROWTH: f32 = 1.01;
/// Squared normalised difference up to which an observation agrees with a hypothesis (3 σ).
const GATE: f32 = 9.0;

/// The product of two Gaussians over inverse depth, or `None` when they disagree by more than 3 σ
/// (Engel, Sturm, Cremers, ICCV 2013, Eq. 13, after growing the prior's variance by 1 %).
#[inline(always)]
pub(super) fn fused(d: f32, v: f32, d_observed: f32, v_observed: f32) -> Option<(f32, f32)> {
    let v = GROWTH * v;
    let difference = d - d_observed;
    let sum = v + v_observed;
    (difference * difference <= GATE * sum)
        .then(|| ((v * d_observed + v_observed * d) / sum, v * v_observed / sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn fusion_is_a_weighted_mean_with_less_variance(
            d in 0.1f32..2.0, v in 1e-5f32..1e-2, offset in -1.0f32..1.0, w in 1e-5f32..1e-2,
        ) {
            let observed = d + 2.0 * offset * (v + w).sqrt();
            let (fused_d, fused_v) = fused(d, v, observed, w).unwrap();
            prop_assert!(fused_d >= d.min(observed) - 1e-6 && fused_d <= d.max(observed) + 1e-6);
            prop_assert!(fused_v < w && fused_v < GROWTH * v);
        }

        #[test]
        fn contradiction_is_refused(d in 0.1f32..2.0, v in 1e-5f32..1e-2, w in 1e-5f32..1e-2) {
            prop_assert!(fused(d, v, d + 3.5 * (v + w).sqrt(), w).is_none());
        }
    }
}
