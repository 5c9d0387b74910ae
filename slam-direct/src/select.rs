//! Which pixels of a keyframe become points: well spread, each the most distinct of its cell.

use crate::mask::Mask;
use geometry::GrayImage;
use std::ops::Range;

/// A pixel worth a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    /// Column and row.
    pub pixel: [f32; 2],
    /// Distinctness: the smaller eigenvalue of the structure tensor plus a share of the larger one, so that
    /// edges serve where there are no corners. Squared grey levels per pixel.
    pub score: f32,
}

/// Pixels kept free along the image border: a patch and its search need room.
const BORDER: usize = 8;
/// Share of the larger eigenvalue in the score.
const EDGE_SHARE: f32 = 0.05;
/// Half side of the structure tensor's window.
const HALF_WINDOW: usize = 2;

/// The most distinct pixel of each `cell × cell` block with a score of at least `min_score`;
/// `skip(cx, cy)` names blocks to leave out; none is where the `mask` covers. In row order of the blocks.
pub(crate) fn select(
    image: &GrayImage,
    cell: usize,
    min_score: f32,
    mask: &Mask,
    skip: impl Fn(usize, usize) -> bool,
) -> Vec<Candidate> {
    let (columns, rows) = (image.width() / cell, image.height() / cell);
    let mut all = Vec::new();
    let mut tensors = Tensors::default();
    for cy in 0..rows {
        for cx in 0..columns {
            if skip(cx, cy) {
                continue;
            }
            if let Some(best) = best_of_block(image, mask, cx * cell, cy * cell, cell, &mut tensors)
                .filter(|c| c.score >= min_score)
            {
                all.push(best);
            }
        }
    }
    all
}

/// Every second pixel is scored: neighbours share most of their window.
const STEP: usize = 2;

geometry::multiversion! {
    fn best_of_block(
        image: &GrayImage,
        mask: &Mask,
        x0: usize,
        y0: usize,
        cell: usize,
        tensors: &mut Tensors,
    ) -> Option<Candidate> {
        let (left, right) = (x0.max(BORDER), (x0 + cell).min(image.width() - BORDER));
        let (top, bottom) = (y0.max(BORDER), (y0 + cell).min(image.height() - BORDER));
        if left >= right || top >= bottom {
            return None;
        }
        tensors.fill(image, left..right, top - HALF_WINDOW..bottom + HALF_WINDOW);
        let mut best: Option<Candidate> = None;
        for y in (top..bottom).step_by(STEP) {
            let scores = tensors.scores(y - top);
            for (x, &score) in (left..right).zip(scores).step_by(STEP) {
                if best.is_none_or(|b| score > b.score) && !mask.covers(x, y) {
                    best = Some(Candidate { pixel: [x as f32, y as f32], score });
                }
            }
        }
        best
    }
}

/// Pixels of a window along a side.
const WINDOW: usize = 2 * HALF_WINDOW + 1;

/// The structure tensor's terms `[Σgx², Σgxgy, Σgy²]` of the pixels of a block. Gradients are differences over two pixels.
/// Each term has an array of its own, so that the processor works on several pixels side by side.
#[derive(Default)]
struct Tensors {
    /// Of the pixels of one row.
    products: [Vec<i32>; 3],
    /// Summed over the columns of the window around each pixel, row by row.
    sums: [Vec<i32>; 3],
    /// Pixels in a row.
    width: usize,
    /// Summed over the whole windows, and scores, of the row last asked for.
    totals: [Vec<i32>; 3],
    scores: Vec<f32>,
}

impl Tensors {
    #[inline(always)]
    fn fill(&mut self, image: &GrayImage, columns: Range<usize>, rows: Range<usize>) {
        let (width, reach) = (columns.len(), columns.start - HALF_WINDOW..columns.end + HALF_WINDOW);
        self.width = width;
        self.scores.resize(width, 0.0);
        self.totals.iter_mut().for_each(|totals| totals.resize(width, 0));
        self.products.iter_mut().for_each(|products| products.resize(reach.len(), 0));
        self.sums.iter_mut().for_each(|sums| sums.resize(rows.len() * width, 0));
        for (at, y) in rows.enumerate() {
            let left = &image.row(y)[reach.start - 1..reach.end - 1];
            let right = &image.row(y)[reach.start + 1..reach.end + 1];
            let (above, below) = (&image.row(y - 1)[reach.clone()], &image.row(y + 1)[reach.clone()]);
            let [xx, xy, yy] = &mut self.products;
            let products = xx.iter_mut().zip(xy).zip(yy);
            for ((((a, b), c), d), ((xx, xy), yy)) in
                left.iter().zip(right).zip(above).zip(below).zip(products)
            {
                let (gx, gy) = (i32::from(*b) - i32::from(*a), i32::from(*d) - i32::from(*c));
                (*xx, *xy, *yy) = (gx * gx, gx * gy, gy * gy);
            }
            for (products, sums) in self.products.iter().zip(&mut self.sums) {
                let sums = &mut sums[at * width..(at + 1) * width];
                for (sum, window) in sums.iter_mut().zip(products.windows(WINDOW)) {
                    *sum = window.iter().sum();
                }
            }
        }
    }

    /// The scores of the pixels of a row of the block.
    #[inline(always)]
    fn scores(&mut self, row: usize) -> &[f32] {
        let width = self.width;
        for (total, sums) in self.totals.iter_mut().zip(&self.sums) {
            let rows: [&[i32]; WINDOW] = std::array::from_fn(|k| &sums[(row + k) * width..][..width]);
            let total = &mut total[..width];
            for i in 0..width {
                total[i] = rows.iter().map(|row| row[i]).sum();
            }
        }
        let [xx, xy, yy] = &self.totals;
        for (((score, xx), xy), yy) in self.scores.iter_mut().zip(xx).zip(xy).zip(yy) {
            *score = self::score([*xx, *xy, *yy]);
        }
        &self.scores
    }
}

/// The score of a structure tensor's terms, see [`Tensors`].
#[inline(always)]
fn score(tensor: [i32; 3]) -> f32 {
    let area = (4 * WINDOW * WINDOW) as f32;
    let [xx, xy, yy] = tensor.map(|sum| sum as f32 / area);
    let half_trace = 0.5 * (xx + yy);
    let root = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
    (half_trace - root) + EDGE_SHARE * (half_trace + root)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prefers_the_corner_and_skips_flat_blocks() {
        let mut image = GrayImage::filled(64, 64, 50);
        for y in 24..40 {
            for x in 26..40 {
                image.set(x, y, 200);
            }
        }
        let found = select(&image, 32, 5.0, &Mask::default(), |_, _| false);
        assert!(!found.is_empty());
        for c in &found {
            let near = |v: f32, a: f32| (v - a).abs() <= 4.0;
            assert!(
                (near(c.pixel[0], 26.0) || near(c.pixel[0], 40.0))
                    && (near(c.pixel[1], 24.0) || near(c.pixel[1], 40.0)),
                "{c:?}"
            );
        }
        assert!(select(&GrayImage::filled(64, 64, 50), 32, 5.0, &Mask::default(), |_, _| false).is_empty());
    }
}
