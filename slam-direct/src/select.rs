//! Which pixels of a keyframe become points: well spread, each the most distinct of its cell.

use geometry::GrayImage;

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
/// `skip(cx, cy)` names blocks to leave out. In row order of the blocks.
pub(crate) fn select(
    image: &GrayImage,
    cell: usize,
    min_score: f32,
    skip: impl Fn(usize, usize) -> bool,
) -> Vec<Candidate> {
    let (columns, rows) = (image.width() / cell, image.height() / cell);
    let mut all = Vec::new();
    for cy in 0..rows {
        for cx in 0..columns {
            if skip(cx, cy) {
                continue;
            }
            if let Some(best) =
                best_of_block(image, cx * cell, cy * cell, cell).filter(|c| c.score >= min_score)
            {
                all.push(best);
            }
        }
    }
    all
}

fn best_of_block(image: &GrayImage, x0: usize, y0: usize, cell: usize) -> Option<Candidate> {
    let (left, right) = (x0.max(BORDER), (x0 + cell).min(image.width() - BORDER));
    let (top, bottom) = (y0.max(BORDER), (y0 + cell).min(image.height() - BORDER));
    if left >= right || top >= bottom {
        return None;
    }
    let mut best: Option<Candidate> = None;
    // Every second pixel is scored: neighbours share most of their window.
    for y in (top..bottom).step_by(2) {
        for x in (left..right).step_by(2) {
            let score = score(image, x, y);
            if best.is_none_or(|b| score > b.score) {
                best = Some(Candidate { pixel: [x as f32, y as f32], score });
            }
        }
    }
    best
}

fn score(image: &GrayImage, x: usize, y: usize) -> f32 {
    let (mut xx, mut xy, mut yy) = (0i32, 0i32, 0i32);
    for v in y - HALF_WINDOW..=y + HALF_WINDOW {
        let (above, row, below) = (image.row(v - 1), image.row(v), image.row(v + 1));
        for u in x - HALF_WINDOW..=x + HALF_WINDOW {
            let gx = row[u + 1] as i32 - row[u - 1] as i32;
            let gy = below[u] as i32 - above[u] as i32;
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    }
    let area = (4 * (2 * HALF_WINDOW + 1) * (2 * HALF_WINDOW + 1)) as f32;
    let (xx, xy, yy) = (xx as f32 / area, xy as f32 / area, yy as f32 / area);
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
        let found = select(&image, 32, 5.0, |_, _| false);
        assert!(!found.is_empty());
        for c in &found {
            let near = |v: f32, a: f32| (v - a).abs() <= 4.0;
            assert!(
                (near(c.pixel[0], 26.0) || near(c.pixel[0], 40.0))
                    && (near(c.pixel[1], 24.0) || near(c.pixel[1], 40.0)),
                "{c:?}"
            );
        }
        assert!(select(&GrayImage::filled(64, 64, 50), 32, 5.0, |_, _| false).is_empty());
    }
}
