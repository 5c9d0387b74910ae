//! Ranges of inverse depth around the sparse backbone.

use super::DepthParams;
use geometry::Pinhole;

/// Side of a cell, pixels: small cells keep searches short where the backbone is dense.
const CELL: usize = 16;
/// Cells on either side that are asked for points.
const MAX_REACH: usize = 4;

/// A point of the sparse backbone, projected into the keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeedPoint {
    /// Position in the keyframe image, pixels.
    pub pixel: [f32; 2],
    /// Inverse depth in the keyframe, 1/keyframe unit.
    pub inverse_depth: f32,
    /// Variance of the inverse depth.
    pub variance: f32,
}

/// The range of inverse depth to search in each cell of the image: that of the backbone points in the cell and
/// those around it, as far out as the first point lies, widened; of all points where none is near.
#[derive(Clone, Debug)]
pub(super) struct PriorRanges {
    columns: usize,
    ranges: Vec<[f32; 2]>,
}

impl PriorRanges {
    /// Ranges when nothing is known yet: the parameters' bounds everywhere.
    pub fn unknown(camera: &Pinhole, params: &DepthParams) -> Self {
        let columns = camera.width.div_ceil(CELL).max(1);
        let rows = camera.height.div_ceil(CELL).max(1);
        let all = [params.min_inverse_depth, params.max_inverse_depth];
        Self { columns, ranges: vec![all; columns * rows] }
    }

    /// Ranges around `points`; invalid points are left out.
    pub fn from_points(camera: &Pinhole, points: &[SeedPoint], params: &DepthParams) -> Self {
        const NONE: [f32; 2] = [f32::INFINITY, 0.0];
        let mut all = Self::unknown(camera, params);
        let rows = all.ranges.len() / all.columns;
        let mut cells = vec![NONE; all.ranges.len()];
        for point in points.iter().filter(|p| is_usable(p, camera)) {
            let (column, row) = (point.pixel[0] as usize / CELL, point.pixel[1] as usize / CELL);
            let sigma2 = 2.0 * point.variance.sqrt();
            let cell = &mut cells[row * all.columns + column];
            let low = (point.inverse_depth - sigma2).max(0.5 * point.inverse_depth);
            *cell = joined(*cell, [low, point.inverse_depth + sigma2]);
        }
        let whole = cells.iter().fold(NONE, |a, &b| joined(a, b));
        if whole[1] == 0.0 {
            return all;
        }
        let margin = params.range_margin;
        for row in 0..rows {
            for column in 0..all.columns {
                let around = |reach: usize| {
                    let mut range = NONE;
                    for r in row.saturating_sub(reach)..=(row + reach).min(rows - 1) {
                        for c in column.saturating_sub(reach)..=(column + reach).min(all.columns - 1) {
                            range = joined(range, cells[r * all.columns + c]);
                        }
                    }
                    range
                };
                let range = (1..=MAX_REACH).map(around).find(|range| range[1] > 0.0).unwrap_or(NONE);
                let [low, high] = if range[1] == 0.0 { whole } else { range };
                all.ranges[row * all.columns + column] = [low / margin, high * margin];
            }
        }
        all
    }

    /// The range for a pixel of the image.
    #[inline]
    pub fn at(&self, pixel: [f32; 2]) -> [f32; 2] {
        let [column, row] = pixel.map(|v| v as u32 as usize / CELL);
        self.ranges[row * self.columns + column]
    }
}

/// The least range that holds both.
fn joined(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Whether a point lies in the image and its numbers mean something.
fn is_usable(point: &SeedPoint, camera: &Pinhole) -> bool {
    let [x, y] = point.pixel;
    (0.0..camera.width as f32).contains(&x)
        && (0.0..camera.height as f32).contains(&y)
        && point.inverse_depth > 0.0
        && point.inverse_depth.is_finite()
        && point.variance >= 0.0
        && point.variance.is_finite()
}
