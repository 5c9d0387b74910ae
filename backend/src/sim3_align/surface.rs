//! The surface that a keyframe sees, in square cells: a plane each, between depths that lie in one.
//!
//! Semi-dense depths stand at edges. What tells two rooms with the same posters apart is the grain of the wall between them,
//! where there are none. Along a plane inverse depth is an affine function of the pixel, so a cell's plane comes from depths
//! in it or, where it has too few, from those around it on all sides.

use super::band::{Band, GrainParams, Grid, Layer, box_means, grain};
use super::level_depth::LevelDepth;
use crate::params;
use geometry::{Pinhole, Pyramid};
use nalgebra::{Matrix3, Vector3};

params! {
    /// Parameters of the cells of a keyframe's surface.
    pub struct SurfaceParams {
        /// Cells along the width of an image. Range 8–64; of a view of 75° one of 24 is a tenth of a metre wide at two.
        pub columns: usize = 24,
        /// The finest pyramid level whose image is at most so wide is looked at, pixels. Range 40–4000; grain shows at some
        /// pixels.
        pub max_width: usize = 400,
        /// Half the side of the square whose mean is taken off each pixel, cells. Range 0.1–2.
        pub band: f64 = 0.3,
        /// Fewest depths that make a plane. Range 4–1000.
        pub min_points: usize = 8,
        /// How many cells around are asked at most for depths where a cell has too few. Range 0–8.
        pub reach: usize = 3,
        /// Depths lie in a plane within so many of their standard deviations. Range 1–10.
        pub deviations: f64 = 3.0,
        /// And within this part of the depth besides, which is that of right planes by the slopes within a pixel. Range 0–0.2.
        pub relative: f64 = 0.01,
        /// Least share of them that must. Range 0.5–1.
        pub min_share: f64 = 0.8,
        /// What is between the edges.
        pub grain: GrainParams = GrainParams::default(),
    }
}

/// Inverse depth `at + along·(x − x₀, y − y₀)` over pixels around the middle `(x₀, y₀)` of a cell, 1/keyframe unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane {
    pub at: f64,
    pub along: [f64; 2],
}

/// A keyframe's surface at one level of its pyramid.
pub struct Surface {
    /// The level of the pyramid.
    pub(super) level: usize,
    pub(super) camera: Pinhole,
    /// Side of a cell, pixels.
    pub(super) cell: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Of each cell, by rows.
    pub(super) planes: Vec<Option<Plane>>,
    /// Edges and all between them.
    pub(super) pattern: Band,
    /// What is between the edges.
    pub(super) grain: Band,
}

impl Surface {
    pub(super) fn new(
        pyramid: &Pyramid,
        depths: &[LevelDepth],
        camera: &Pinhole,
        params: &SurfaceParams,
    ) -> Self {
        let width = pyramid.level(0).width();
        let last = depths.len() - 1;
        let level = (0..last).find(|&level| width >> level <= params.max_width).unwrap_or(last);
        let image = pyramid.level(level);
        let (width, height) = (image.width(), image.height());
        let cell = width.div_ceil(params.columns.max(1)).max(4);
        let (columns, rows) = (width / cell, height / cell);
        let grey = image.data();
        let radius = ((params.band * cell as f64).round() as usize).max(1);
        let means = box_means(grey, width, radius);
        let band = grey.iter().zip(&means).map(|(v, mean)| f32::from(*v) - mean).collect();
        let grain = grain(grey, &means, width, &params.grain);
        let points = points_of(&depths[level], cell, columns, rows);
        let planes = (0..rows * columns)
            .map(|i| plane(&points, [i % columns, i / columns], [cell, columns, rows], params));
        let planes = planes.collect();
        let grid = Grid { width, cell, columns, rows };
        Self {
            level,
            camera: camera.at_level(level),
            cell,
            columns,
            rows,
            planes,
            pattern: Band::new((band, 1), grey, &grid),
            grain: Band::new((grain, 2 * params.grain.blur + 1), grey, &grid),
        }
    }

    /// What is compared of the cells.
    pub(super) fn band(&self, layer: Layer) -> &Band {
        match layer {
            Layer::Pattern => &self.pattern,
            Layer::Grain => &self.grain,
        }
    }

    pub(super) fn width(&self) -> usize {
        self.camera.width
    }

    /// The middle of a cell, pixels.
    pub(super) fn middle(&self, cell: usize) -> [f64; 2] {
        let half = 0.5 * (self.cell as f64 - 1.0);
        [(cell % self.columns * self.cell) as f64 + half, (cell / self.columns * self.cell) as f64 + half]
    }

    /// The cell of a pixel.
    pub(super) fn cell_at(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let at = |v: f64, count: usize| {
            let cell = ((v + 0.5) / self.cell as f64).floor();
            (cell >= 0.0 && cell < count as f64).then_some(cell as usize)
        };
        Some(at(y, self.rows)? * self.columns + at(x, self.columns)?)
    }

    /// Inverse depth at a pixel by the plane of a cell.
    pub(super) fn inverse_depth(&self, cell: usize, [x, y]: [f64; 2]) -> Option<f64> {
        let plane = self.planes[cell]?;
        let [x0, y0] = self.middle(cell);
        Some(plane.at + plane.along[0] * (x - x0) + plane.along[1] * (y - y0))
    }
}

/// A depth: pixel, inverse depth and its standard deviation.
type Depth = [f64; 4];

/// The depths of each cell.
fn points_of(depth: &LevelDepth, cell: usize, columns: usize, rows: usize) -> Vec<Vec<Depth>> {
    let mut points = vec![Vec::new(); columns * rows];
    for point in &depth.points {
        let (x, y) = (usize::from(point.x), usize::from(point.y));
        if x / cell < columns && y / cell < rows {
            let deviation = f64::from(point.variance).sqrt();
            points[y / cell * columns + x / cell].push([
                x as f64,
                y as f64,
                f64::from(point.inverse_depth),
                deviation,
            ]);
        }
    }
    points
}

/// The plane of a cell from the smallest square of cells around it whose depths suffice; nothing where these lie in none.
fn plane(
    points: &[Vec<Depth>],
    [column, row]: [usize; 2],
    [cell, columns, rows]: [usize; 3],
    params: &SurfaceParams,
) -> Option<Plane> {
    let half = 0.5 * (cell as f64 - 1.0);
    let middle = [(column * cell) as f64 + half, (row * cell) as f64 + half];
    let mut around: Vec<Depth> = Vec::new();
    for reach in 0..=params.reach {
        around.clear();
        for y in row.saturating_sub(reach)..(row + reach + 1).min(rows) {
            for x in column.saturating_sub(reach)..(column + reach + 1).min(columns) {
                around.extend(&points[y * columns + x]);
            }
        }
        if around.len() >= params.min_points && surrounds(around.iter().map(|[x, y, ..]| [*x, *y]), middle) {
            return fit(&around, middle, params);
        }
    }
    None
}

/// Whether there are points on all sides: in three of four quarters around it, those across among them.
pub(super) fn surrounds(points: impl Iterator<Item = [f64; 2]>, [x0, y0]: [f64; 2]) -> bool {
    let mut quarters = [0usize; 4];
    for [x, y] in points {
        quarters[usize::from(x > x0) + 2 * usize::from(y > y0)] += 1;
    }
    let enough = quarters.map(|count| count >= 2);
    enough.iter().filter(|enough| **enough).count() >= 3
}

/// The plane through most depths; nothing where too many lie beside it.
fn fit(points: &[Depth], [x0, y0]: [f64; 2], params: &SurfaceParams) -> Option<Plane> {
    let limit = |point: &Depth| params.deviations * point[3] + params.relative * point[2];
    let off = |plane: &Vector3<f64>, [x, y, d, _]: &Depth| d - plane.dot(&Vector3::new(1.0, x - x0, y - y0));
    let mut plane: Option<Vector3<f64>> = None;
    for _ in 0..4 {
        // Of the symmetric matrix of the normal equations, the upper half by rows.
        let (mut normal, mut right) = ([0.0; 6], Vector3::zeros());
        for point in points {
            let (x, y, limit) = (point[0] - x0, point[1] - y0, limit(point));
            let outlying = plane.map_or(0.0, |plane| off(&plane, point).abs() / limit);
            // Cauchy's weights: redescending.
            let weight = 1.0 / (limit.powi(2) * (1.0 + (2.0 * outlying).powi(2)));
            let products = [1.0, x, y, x * x, x * y, y * y];
            normal.iter_mut().zip(products).for_each(|(sum, product)| *sum += product * weight);
            right += Vector3::new(1.0, x, y) * (weight * point[2]);
        }
        let [a, b, c, d, e, f] = normal;
        plane = Some(Matrix3::new(a, b, c, b, d, e, c, e, f).try_inverse()? * right);
    }
    let plane = plane?;
    let inside = points.iter().filter(|point| off(&plane, point).abs() <= limit(point)).count();
    let holds = inside as f64 >= params.min_share * points.len() as f64 && plane[0] > 0.0;
    holds.then_some(Plane { at: plane[0], along: [plane[1], plane[2]] })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depths of a slanted plane around a bare cell, a tenth of them wrong.
    #[test]
    fn a_bare_cell_lies_in_the_plane_around_it() {
        let inverse_depth = |x: f64, y: f64| 0.5 + 0.001 * x - 0.002 * y;
        let mut points = vec![Vec::new(); 25];
        for (i, cell) in points.iter_mut().enumerate() {
            for k in 0..10usize {
                let (x, y) = ((i % 5 * 10 + k) as f64, (i / 5 * 10 + (k * 7) % 10) as f64);
                let wrong = if k == 3 { 1.4 } else { 1.0 };
                cell.push([x, y, wrong * inverse_depth(x, y), 0.002]);
            }
        }
        points[12].clear();
        let found = plane(&points, [2, 2], [10, 5, 5], &SurfaceParams::default()).unwrap();
        assert!((found.at - inverse_depth(24.5, 24.5)).abs() < 2e-3, "{found:?}");
        assert!((found.along[0] - 0.001).abs() < 2e-4 && (found.along[1] + 0.002).abs() < 2e-4);
        // Two planes at right angles make none.
        for (i, cell) in points.iter_mut().enumerate().filter(|(i, _)| i % 5 > 2) {
            cell.iter_mut().for_each(|point| point[2] *= 1.0 + 0.3 * (i % 5 - 2) as f64);
        }
        assert!(
            plane(&points, [2, 2], [10, 5, 5], &SurfaceParams { min_share: 0.9, ..SurfaceParams::default() })
                .is_none()
        );
        assert!(
            plane(&points, [2, 2], [10, 5, 5], &SurfaceParams { reach: 0, ..SurfaceParams::default() })
                .is_none()
        );
    }
}
