//! Which pixels of a keyframe become points: well spread, each the most distinct of its cell.

use crate::mask::Mask;
use geometry::GrayImage;
use std::ops::Range;
use std::slice::ChunksExact;

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
    let mut sums = RowSums::default();
    for cy in 0..rows {
        for cx in 0..columns {
            if skip(cx, cy) {
                continue;
            }
            if let Some(best) = best_of_block(image, mask, cx * cell, cy * cell, cell, &mut sums)
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
        sums: &mut RowSums,
    ) -> Option<Candidate> {
        let (left, right) = (x0.max(BORDER), (x0 + cell).min(image.width() - BORDER));
        let (top, bottom) = (y0.max(BORDER), (y0 + cell).min(image.height() - BORDER));
        if left >= right || top >= bottom {
            return None;
        }
        sums.fill(image, left..right, top - HALF_WINDOW..bottom + HALF_WINDOW);
        let mut best: Option<Candidate> = None;
        for (y, rows) in (top..bottom).zip(sums.windows()).step_by(STEP) {
            for (i, x) in (left..right).step_by(STEP).enumerate() {
                let tensor = rows.clone().map(|row| row[i]).fold([0; 3], add);
                let score = score(tensor);
                if best.is_none_or(|b| score > b.score) && !mask.covers(x, y) {
                    best = Some(Candidate { pixel: [x as f32, y as f32], score });
                }
            }
        }
        best
    }
}

/// The structure tensor's terms `[Σgx², Σgxgy, Σgy²]` of every row of a block, summed over the columns of the windows
/// around every second pixel. Gradients are differences over two pixels.
#[derive(Default)]
struct RowSums {
    products: Vec<[i32; 3]>,
    sums: Vec<[i32; 3]>,
    /// Sums in a row.
    width: usize,
}

impl RowSums {
    #[inline(always)]
    fn fill(&mut self, image: &GrayImage, columns: Range<usize>, rows: Range<usize>) {
        self.width = columns.len().div_ceil(STEP);
        self.sums.clear();
        for y in rows {
            let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
            let reach = columns.start - HALF_WINDOW..columns.end + HALF_WINDOW;
            self.products.clear();
            self.products.extend(reach.map(|x| {
                let gx = i32::from(row[x + 1]) - i32::from(row[x - 1]);
                let gy = i32::from(below[x]) - i32::from(above[x]);
                [gx * gx, gx * gy, gy * gy]
            }));
            let windows = self.products.windows(2 * HALF_WINDOW + 1).step_by(STEP);
            self.sums.extend(windows.map(|window| window.iter().copied().fold([0; 3], add)));
        }
    }

    /// The rows of the window around each row of the block.
    #[inline(always)]
    fn windows(&self) -> impl Iterator<Item = ChunksExact<'_, [i32; 3]>> {
        let size = (2 * HALF_WINDOW + 1) * self.width;
        let starts = (0..=self.sums.len() - size).step_by(self.width);
        starts.map(move |start| self.sums[start..start + size].chunks_exact(self.width))
    }
}

#[inline(always)]
fn add(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// The score of a structure tensor's terms, see [`RowSums`].
fn score(tensor: [i32; 3]) -> f32 {
    let area = (4 * (2 * HALF_WINDOW + 1) * (2 * HALF_WINDOW + 1)) as f32;
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
