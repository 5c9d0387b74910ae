//! The optimal scale σ* from three adjacent keyframe pairs (Loop-box, §IV-C3, Eqs. 4–5, Algorithm 1).
//!
//! The pairs are z = −1, 0, 1: the neighbours (i − 1, j ∓ 1) and (i + 1, j ± 1) of the loop closure (i, j),
//! which is the centre. [`algorithm_1`] is the paper's estimator to the letter; [`inverse_variance`] is the one
//! to use. Both fall back to the centre pair where the volumes of its two clouds do not fit.

#[cfg(test)]
mod tests;
mod volume;

pub use volume::volume_ratio;

use serde::{Deserialize, Serialize};

/// How σ* is chosen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimalScaleParams {
    /// The neighbours count only where [`volume_ratio`] is above this. Default 0.5 (Algorithm 1); 0 to 1.
    pub min_volume_ratio: f64,
    /// Algorithm 1's first Δ*: scales that differ by this or more are never averaged. Default 5
    /// (Algorithm 1); above 0, target units per source unit.
    pub max_scale_gap: f64,
    /// Largest χ² of the difference of two scales that [`inverse_variance`] fuses. Default 6.635, the 99 %
    /// quantile with 1 degree of freedom; 3 to 11.
    pub max_chi2: f64,
    /// Relative standard deviation that every pair's scale has beyond its own variance, in [`inverse_variance`].
    /// Default 0.01; 0 or more. The depths of a keyframe share errors that the matches between them do not show,
    /// and real, noisy maps differ by that much from keyframe to keyframe.
    pub shared_deviation: f64,
}

impl Default for OptimalScaleParams {
    fn default() -> Self {
        Self { min_volume_ratio: 0.5, max_scale_gap: 5.0, max_chi2: 6.635, shared_deviation: 0.01 }
    }
}

/// The scale of one of the three pairs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairEstimate {
    /// σ_z: target units per source unit, > 0.
    pub scale: f64,
    /// Variance of `scale`, > 0.
    pub variance: f64,
    /// γ_z: how many key points of the two keyframes match.
    pub match_count: usize,
}

impl PairEstimate {
    /// The estimate with a further relative standard deviation.
    fn widened(self, deviation: f64) -> Self {
        Self { variance: self.variance + (deviation * self.scale).powi(2), ..self }
    }
}

/// The estimates of z = −1, 0, 1 in that order; `None` where a pair has none.
pub type Neighbourhood = [Option<PairEstimate>; 3];

/// What σ* rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Basis {
    /// Two or three estimates that agree.
    Agreement,
    /// The only pair that has an estimate: nothing confirms it.
    Single,
    /// The centre pair alone: the volumes of its clouds do not fit, or (Algorithm 1) no two scales were taken.
    Centre,
    /// The matches of all keyframes around the place together, where no pair has enough.
    Neighbourhood,
}

/// σ* with its evidence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OptimalScale {
    /// σ*: target units per source unit.
    pub scale: f64,
    /// Variance of `scale`. It takes the errors of the pairs as independent; where neighbouring keyframes
    /// share the errors of their depths it is too small, by at most a factor of the number used.
    pub variance: f64,
    /// What it rests on.
    pub basis: Basis,
    /// Which of z = −1, 0, 1 went into it.
    pub used: [bool; 3],
    /// Δ: the largest difference between two scales used; 0 for one.
    pub scale_gap: f64,
    /// γ: the mean number of matches of the pairs used.
    pub match_count: f64,
}

/// Why there is no σ*.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum OptimalScaleRefusal {
    /// No pair, or not the one needed, has an estimate.
    #[error(
        "no usable scale: the centre pair is needed where its neighbours do not count, and it has no estimate"
    )]
    NoEstimate,
    /// A scale or variance is not finite and positive, or the volume ratio is not a number.
    #[error("the scales, their variances and the volume ratio must be finite, scales and variances positive")]
    InvalidInput,
    /// No two of the scales agree within their variances.
    #[error(
        "no two of the adjacent pairs agree on a scale: they differ by {scale_gap}, more than their variances allow"
    )]
    Inconsistent {
        /// The smallest difference between two of them.
        scale_gap: f64,
    },
}

/// Two different indices of the three, in the order in which Algorithm 1 visits them.
const VISITS: [(usize, usize); 6] = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)];

/// Algorithm 1 of the paper to the letter, to compare with.
///
/// It walks over x, y ∈ {−1, 0, 1}, x ≠ y, and takes `σ* = (σx + σy) / 2` when γxy > γ\* and Δ < Δ\* and
/// Δ\* ≠ 0, where `Δ = |σx − σy|`; γ\* and Δ\* are those of the last pair taken. Readings of what it leaves open:
/// - γxy is the mean of γx and γy; γ\* starts at 0, Δ\* at 5.
/// - `else σ* = σ₀₀`, whose indentation the text does not settle, belongs to `r_vol > 0.5`. Were it the inner
///   test's, the last visit, which repeats a pair and so fails, would always undo the result.
/// - r_vol carries no index: it is that of the centre pair (see [`volume_ratio`]).
/// - A pair without an estimate is not visited. When no two are taken, σ* is the centre's.
///
/// As both tests must hold at once, a pair of scales visited first is kept against one that agrees better
/// with fewer matches: the result depends on which neighbour is called −1. [`inverse_variance`] does not.
pub fn algorithm_1(
    estimates: &Neighbourhood,
    volume_ratio: f64,
    params: &OptimalScaleParams,
) -> Result<OptimalScale, OptimalScaleRefusal> {
    check(estimates, volume_ratio)?;
    let mut taken = None;
    if volume_ratio > params.min_volume_ratio {
        let (mut best_gap, mut best_count) = (params.max_scale_gap, 0.0);
        for (x, y) in VISITS {
            let (Some(a), Some(b)) = (estimates[x], estimates[y]) else { continue };
            let gap = (a.scale - b.scale).abs();
            let count = 0.5 * (a.match_count as f64 + b.match_count as f64);
            if best_count < count && best_gap > gap && best_gap != 0.0 {
                let (scale, variance) = (0.5 * (a.scale + b.scale), 0.25 * (a.variance + b.variance));
                taken = Some(result(estimates, subset(&[x, y]), scale, variance, Basis::Agreement));
                (best_gap, best_count) = (gap, count);
            }
        }
    }
    taken.map_or_else(|| centre(estimates), Ok)
}

/// The inverse-variance mean of the estimates that agree with each other: the default.
///
/// It works on ln σ, whose variance is `variance / σ²`, so that σ and 1/σ are treated alike. Two estimates agree
/// if `(ln σx − ln σy)² / (var x + var y) ≤ max_chi2`. All three are fused if each two agree; else the two that
/// agree, and of several such twos the one with more matches (Eq. 4), then with the smaller χ². A single
/// estimate is returned as it is, marked [`Basis::Single`].
pub fn inverse_variance(
    estimates: &Neighbourhood,
    volume_ratio: f64,
    params: &OptimalScaleParams,
) -> Result<OptimalScale, OptimalScaleRefusal> {
    check(estimates, volume_ratio)?;
    let estimates = &estimates.map(|estimate| Some(estimate?.widened(params.shared_deviation)));
    let present = estimates.map(|estimate| estimate.is_some());
    match present.iter().filter(|present| **present).count() {
        0 => return Err(OptimalScaleRefusal::NoEstimate),
        1 => return Ok(fuse(estimates, present, Basis::Single)),
        _ if volume_ratio > params.min_volume_ratio => {}
        _ => return centre(estimates),
    }
    let twos: Vec<Two> = [(0, 1), (0, 2), (1, 2)].iter().filter_map(|&xy| Two::new(estimates, xy)).collect();
    let agree = |two: &&Two| two.chi2 <= params.max_chi2;
    if twos.iter().all(|two| agree(&two)) {
        return Ok(fuse(estimates, present, Basis::Agreement));
    }
    let best = twos
        .iter()
        .filter(agree)
        .max_by(|a, b| a.match_count.cmp(&b.match_count).then(b.chi2.total_cmp(&a.chi2)));
    match best {
        Some(two) => Ok(fuse(estimates, two.members, Basis::Agreement)),
        None => {
            let scale_gap = twos.iter().map(|two| two.scale_gap).fold(f64::INFINITY, f64::min);
            Err(OptimalScaleRefusal::Inconsistent { scale_gap })
        }
    }
}

/// Two of the three estimates.
struct Two {
    members: [bool; 3],
    chi2: f64,
    scale_gap: f64,
    match_count: usize,
}

impl Two {
    /// `None` where one of them has no estimate.
    fn new(estimates: &Neighbourhood, (x, y): (usize, usize)) -> Option<Self> {
        let (a, b) = (estimates[x]?, estimates[y]?);
        let difference = (a.scale / b.scale).ln();
        Some(Self {
            members: subset(&[x, y]),
            chi2: difference * difference / (log_variance(&a) + log_variance(&b)),
            scale_gap: (a.scale - b.scale).abs(),
            match_count: a.match_count + b.match_count,
        })
    }
}

/// Variance of ln σ.
fn log_variance(estimate: &PairEstimate) -> f64 {
    estimate.variance / (estimate.scale * estimate.scale)
}

/// The inverse-variance mean of the estimates `used`, in logarithms.
fn fuse(estimates: &Neighbourhood, used: [bool; 3], basis: Basis) -> OptimalScale {
    let (mut information, mut sum) = (0.0, 0.0);
    for estimate in members(estimates, used) {
        let weight = log_variance(&estimate).recip();
        information += weight;
        sum += weight * estimate.scale.ln();
    }
    let scale = (sum / information).exp();
    result(estimates, used, scale, scale * scale / information, basis)
}

/// The centre pair's scale.
fn centre(estimates: &Neighbourhood) -> Result<OptimalScale, OptimalScaleRefusal> {
    let centre = estimates[1].ok_or(OptimalScaleRefusal::NoEstimate)?;
    Ok(result(estimates, subset(&[1]), centre.scale, centre.variance, Basis::Centre))
}

/// The result with what follows from which estimates were used.
fn result(
    estimates: &Neighbourhood,
    used: [bool; 3],
    scale: f64,
    variance: f64,
    basis: Basis,
) -> OptimalScale {
    let (mut least, mut largest, mut matches, mut count) = (f64::INFINITY, 0.0, 0.0, 0.0);
    for estimate in members(estimates, used) {
        least = estimate.scale.min(least);
        largest = estimate.scale.max(largest);
        matches += estimate.match_count as f64;
        count += 1.0;
    }
    OptimalScale { scale, variance, basis, used, scale_gap: largest - least, match_count: matches / count }
}

/// The estimates that are there and `used`.
fn members(estimates: &Neighbourhood, used: [bool; 3]) -> impl Iterator<Item = PairEstimate> {
    estimates.iter().zip(used).filter(|(_, used)| *used).filter_map(|(estimate, _)| *estimate)
}

/// Marks `indices`.
fn subset(indices: &[usize]) -> [bool; 3] {
    std::array::from_fn(|i| indices.contains(&i))
}

/// Refuses numbers that mean nothing.
fn check(estimates: &Neighbourhood, volume_ratio: f64) -> Result<(), OptimalScaleRefusal> {
    let positive = |v: f64| v.is_finite() && v > 0.0;
    let valid = |estimate: &PairEstimate| positive(estimate.scale) && positive(estimate.variance);
    let all = !volume_ratio.is_nan() && estimates.iter().flatten().all(valid);
    if all { Ok(()) } else { Err(OptimalScaleRefusal::InvalidInput) }
}
