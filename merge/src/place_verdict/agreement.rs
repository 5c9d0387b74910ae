//! How alike cells look that are of one surface, and those that are not, by their contrast.

/// Bins of contrast, evenly spread over its logarithm, and the least and the most.
const CONTRASTS: usize = 16;
const CONTRAST: [f64; 2] = [0.004, 0.6];
/// Bins of correlation from −1 to 1.
const CORRELATIONS: usize = 50;
/// Standard deviations of the kernels, bins: a factor of 1.4 of contrast, 0.06 of correlation.
const SPREAD: [f64; 2] = [1.0, 1.5];
/// How many cells that may look any way at all there are besides those measured, at each contrast.
const PSEUDO: f64 = 2.0;

/// Densities of correlations.
pub(super) struct Agreement {
    ln_ratios: Vec<f64>,
}

impl Agreement {
    /// From contrasts and correlations of cells of one surface, and of unrelated ones.
    pub fn new(same: impl Iterator<Item = [f64; 2]>, other: impl Iterator<Item = [f64; 2]>) -> Self {
        let (same, other) = (density(same), density(other));
        Self { ln_ratios: same.iter().zip(&other).map(|(same, other)| (same / other).ln()).collect() }
    }

    /// ln p(correlation | one surface) − ln p(correlation | unrelated), of cells of a contrast.
    pub fn ln_ratio(&self, contrast: f64, correlation: f64) -> f64 {
        self.ln_ratios[bin(contrast, correlation)]
    }
}

fn bin(contrast: f64, correlation: f64) -> usize {
    let [least, most] = CONTRAST.map(f64::ln);
    let at = |share: f64, count: usize| ((share * count as f64).max(0.0) as usize).min(count - 1);
    let row = at((contrast.max(1e-9).ln() - least) / (most - least), CONTRASTS);
    row * CORRELATIONS + at(0.5 * (correlation + 1.0), CORRELATIONS)
}

/// Of each bin, the share of the cells of its contrast.
fn density(cells: impl Iterator<Item = [f64; 2]>) -> Vec<f64> {
    let mut counts = vec![0.0; CONTRASTS * CORRELATIONS];
    for [contrast, correlation] in cells {
        counts[bin(contrast, correlation)] += 1.0;
    }
    let blurred = blurred(&counts);
    let mut density = vec![0.0; counts.len()];
    for (row, out) in blurred.chunks(CORRELATIONS).zip(density.chunks_mut(CORRELATIONS)) {
        let sum: f64 = row.iter().sum::<f64>() + PSEUDO;
        out.iter_mut().zip(row).for_each(|(out, v)| *out = (v + PSEUDO / CORRELATIONS as f64) / sum);
    }
    density
}

/// Each bin by Gaussian weights of those around it; what would fall outside stays at the border.
fn blurred(counts: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; counts.len()];
    for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0.0) {
        let (row, column) = (i / CORRELATIONS, i % CORRELATIONS);
        let rows = kernel(row, CONTRASTS, SPREAD[0]);
        let columns = kernel(column, CORRELATIONS, SPREAD[1]);
        for (r, by_row) in &rows {
            for (c, by_column) in &columns {
                out[r * CORRELATIONS + c] += count * by_row * by_column;
            }
        }
    }
    out
}

/// Bins around one with their weights, which sum up to 1.
fn kernel(at: usize, count: usize, spread: f64) -> Vec<(usize, f64)> {
    let reach = (3.0 * spread).ceil() as usize;
    let bins = at.saturating_sub(reach)..(at + reach + 1).min(count);
    let weights: Vec<(usize, f64)> =
        bins.map(|bin| (bin, (-0.5 * (bin.abs_diff(at) as f64 / spread).powi(2)).exp())).collect();
    let sum: f64 = weights.iter().map(|(_, weight)| weight).sum();
    weights.into_iter().map(|(bin, weight)| (bin, weight / sum)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grain shows above some contrast only: below, what agrees says nothing.
    #[test]
    fn cells_say_what_their_contrast_can() {
        let spread = |i: usize| 0.06 * ((i * 37) % 11) as f64 / 11.0;
        let same =
            (0..600).map(|i| if i % 2 == 0 { [0.2, 0.9 + spread(i)] } else { [0.01, 0.2 + spread(i)] });
        let other = (0..600).map(|i| [if i % 2 == 0 { 0.2 } else { 0.01 }, 0.2 + spread(i)]);
        let agreement = Agreement::new(same, other);
        assert!(agreement.ln_ratio(0.2, 0.93) > 3.0 && agreement.ln_ratio(0.2, 0.22) < -3.0);
        assert!(agreement.ln_ratio(0.01, 0.22).abs() < 0.2);
        // Nothing was measured there.
        let nothing = Agreement::new(std::iter::empty(), std::iter::empty());
        assert_eq!(nothing.ln_ratio(0.2, 0.9), 0.0);
        assert!(agreement.ln_ratio(f64::NAN, f64::NAN).is_finite());
    }
}
