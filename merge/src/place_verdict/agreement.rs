//! How alike cells look that are of one surface, and those that are not.
//!
//! What noise, blur, exposure, gleams and errors of pose and depth make of a cell, its own map shows: how alike the cell looks in
//! other keyframes of that map. A cell that these do not know again says nothing of the other map either; one that they
//! all know and the other map does not is another surface. So the likelihood of a correlation is that of cells whose own maps know them as
//! well, against that of unrelated cells of as much contrast.

use backend::sim3_align::{CellMatch, Layer};
use geometry::median;

/// Bins of contrast, evenly spread over its logarithm, and the least and the most.
const CONTRASTS: usize = 16;
const CONTRAST: [f64; 2] = [0.004, 0.6];
/// Bins of how well a cell's own map knows it, evenly spread over Fisher's z = artanh of the correlation, and the largest z.
const KNOWN: usize = 10;
const MOST_KNOWN: f64 = 2.0;
/// Bins of correlation from −1 to 1.
const CORRELATIONS: usize = 50;
/// Standard deviations of the kernels, bins: a factor of 1.4 of contrast, 0.15 of z, 0.06 of correlation.
const CONTRAST_SPREAD: f64 = 1.0;
const KNOWN_SPREAD: f64 = 0.75;
const CORRELATION_SPREAD: f64 = 1.5;
/// How many cells that may look any way at all there are besides those measured, in each row of bins.
const PSEUDO: f64 = 2.0;

/// Probability that a cell is hidden where the other keyframe knows no depth: as likely as not, for nothing is known of it.
const HIDDEN: f64 = 0.5;

/// Densities of correlations of each layer.
pub(super) struct Agreements([Agreement; 2]);

impl Agreements {
    /// From those of a layer.
    pub fn new(of: impl Fn(Layer) -> Agreement) -> Self {
        Self([of(Layer::Pattern), of(Layer::Grain)])
    }

    /// Those of a layer.
    pub fn of(&self, layer: Layer) -> &Agreement {
        &self.0[layer as usize]
    }
}

/// Densities of correlations.
pub(super) struct Agreement {
    /// By how well the cell's own map knows it.
    same: Vec<f64>,
    /// By contrast.
    other: Vec<f64>,
    /// The median correlation of unrelated cells; 0 without any.
    pub unrelated: f64,
}

impl Agreement {
    /// From cells of one surface, of each its mean correlation in other keyframes and that in one more, and from contrasts and
    /// correlations of unrelated ones.
    pub fn new(same: impl Iterator<Item = [f64; 2]>, other: impl Iterator<Item = [f64; 2]>) -> Self {
        let same = same.map(|[known, correlation]| (known_row(known), correlation));
        let other: Vec<(usize, f64)> =
            other.map(|[contrast, correlation]| (contrast_row(contrast), correlation)).collect();
        let mut correlations: Vec<f64> = other.iter().map(|(_, correlation)| *correlation).collect();
        let unrelated = median(&mut correlations).unwrap_or(0.0);
        Self {
            same: density(same, KNOWN, KNOWN_SPREAD),
            unrelated,
            other: density(other.into_iter(), CONTRASTS, CONTRAST_SPREAD),
        }
    }

    /// ln p(correlation | one surface) − ln p(correlation | unrelated) of a cell that correlates by `known`, −1 to 1, in other keyframes
    /// of its own map. Where something may hide the cell, what is seen there is with probability [`HIDDEN`] something unrelated
    /// though the surface is one: it can agree, but hardly differ.
    pub fn ln_ratio(&self, cell: &CellMatch, known: f64) -> f64 {
        let column = column(cell.correlation);
        let same = self.same[known_row(known) * CORRELATIONS + column];
        let ratio = same / self.other[contrast_row(cell.contrast) * CORRELATIONS + column];
        if cell.is_visible { ratio.ln() } else { (HIDDEN + (1.0 - HIDDEN) * ratio).ln() }
    }
}

fn bin(share: f64, count: usize) -> usize {
    ((share * count as f64).max(0.0) as usize).min(count - 1)
}

fn contrast_row(contrast: f64) -> usize {
    let [least, most] = CONTRAST.map(f64::ln);
    bin((contrast.max(1e-9).ln() - least) / (most - least), CONTRASTS)
}

fn known_row(known: f64) -> usize {
    bin(known.clamp(-0.999, 0.999).atanh() / MOST_KNOWN, KNOWN)
}

fn column(correlation: f64) -> usize {
    bin(0.5 * (correlation + 1.0), CORRELATIONS)
}

/// Of each bin, the share of the cells of its row.
fn density(cells: impl Iterator<Item = (usize, f64)>, rows: usize, spread: f64) -> Vec<f64> {
    let mut counts = vec![0.0; rows * CORRELATIONS];
    for (row, correlation) in cells {
        counts[row * CORRELATIONS + column(correlation)] += 1.0;
    }
    let blurred = blurred(&counts, rows, spread);
    let mut density = vec![0.0; counts.len()];
    for (row, out) in blurred.chunks(CORRELATIONS).zip(density.chunks_mut(CORRELATIONS)) {
        let sum: f64 = row.iter().sum::<f64>() + PSEUDO;
        out.iter_mut().zip(row).for_each(|(out, v)| *out = (v + PSEUDO / CORRELATIONS as f64) / sum);
    }
    density
}

/// Each bin by Gaussian weights of those around it; what would fall outside stays at the border.
fn blurred(counts: &[f64], rows: usize, spread: f64) -> Vec<f64> {
    let mut out = vec![0.0; counts.len()];
    for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0.0) {
        let (row, column) = (i / CORRELATIONS, i % CORRELATIONS);
        let near = kernel(row, rows, spread);
        let columns = kernel(column, CORRELATIONS, CORRELATION_SPREAD);
        for (r, by_row) in &near {
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

    fn spread(i: usize) -> f64 {
        0.06 * ((i * 37) % 11) as f64 / 11.0
    }

    fn cell(contrast: f64, correlation: f64, is_visible: bool) -> CellMatch {
        let centre = nalgebra::Vector3::z();
        let layer = Layer::Pattern;
        CellMatch { cell: 0, layer, centre, width: 0.1, contrast, roundness: 0.7, correlation, is_visible }
    }

    /// Cells that their own map knows again and the other does not are another surface; those that it does not know say nothing.
    #[test]
    fn cells_say_what_their_own_map_knows_of_them() {
        let same =
            (0..600).map(|i| if i % 2 == 0 { [0.92, 0.9 + spread(i)] } else { [0.2, 0.2 + spread(i)] });
        let other = (0..600).map(|i| [if i % 2 == 0 { 0.2 } else { 0.01 }, 0.2 + spread(i)]);
        let agreement = Agreement::new(same, other);
        let of = |known: f64, correlation: f64| agreement.ln_ratio(&cell(0.2, correlation, true), known);
        assert!(of(0.92, 0.93) > 3.0 && of(0.92, 0.22) < -3.0);
        assert!(of(0.2, 0.22).abs() < 0.2);
        // Something may hide it.
        let of = |known: f64, correlation: f64| agreement.ln_ratio(&cell(0.2, correlation, false), known);
        assert!(of(0.92, 0.93) > 2.5 && (-0.7..0.0).contains(&of(0.92, 0.22)));
        // Nothing was measured there.
        let nothing = Agreement::new(std::iter::empty(), std::iter::empty());
        assert_eq!(nothing.ln_ratio(&cell(0.2, 0.9, true), 0.9), 0.0);
        assert!(agreement.ln_ratio(&cell(f64::NAN, f64::NAN, true), f64::NAN).is_finite());
    }
}
