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
