//! What is compared of a surface: its image without the local mean, as a whole or between the edges only.
//!
//! Edges, print and things of one make are alike at many places, and outweigh the grain around them by far. What is between the
//! edges, grain, stains and wear, no other place has.

use crate::params;

params! {
    /// Parameters of what is taken as being between edges.
    pub struct GrainParams {
        /// Least slope of an edge, parts of the local mean in a pixel. Range 0.01–1: print and edges have contrasts of a tenth and more,
        /// grain of plaster, concrete, cloth and paint 1 to 4 %.
        pub edge: f64 = 0.08,
        /// And least slope of one, grey levels in a pixel. Range 1–100: noise of 2 grey levels has slopes of 1.4.
        pub min_edge: f64 = 6.0,
        /// How far beside an edge nothing is taken, pixels. Range 0–20: edges are blurred by a pixel or two.
        pub margin: usize = 2,
        /// Half the side of the square whose mean is taken off each pixel, pixels. Range 1–20; twice `margin` and one at most, for it may not
        /// reach across an edge: two pixels of it and a margin to each side are left out.
        pub radius: usize = 5,
        /// Half the side of the square whose mean each pixel is, pixels. Range 0–3, below `radius`: the noise of pixels hides a grain of 2 or 3
        /// grey levels, that of nine together is a third.
        pub blur: usize = 1,
    }
}

/// Least share of a cell that is between edges where its grain is looked at.
const MIN_SHARE: f64 = 0.25;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layer {
    /// Edges and all between them.
    Pattern,
    /// What is between the edges.
    Grain,
}

impl Layer {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Pattern, Self::Grain];
}

/// An image without its local mean, and what each cell has of it.
pub(super) struct Band {
    /// Grey levels, by rows; no number where nothing is compared.
    pub values: Vec<f32>,
    /// Of each cell, the standard deviation, grey levels; 0 where too few of its pixels are compared.
    pub deviations: Vec<f64>,
    /// Side of the square whose mean each value is, pixels: so many times less of it is noise and rounding.
    pub side: usize,
    /// Of each cell, the contrast: that over the mean intensity.
    pub contrasts: Vec<f64>,
    /// Of each cell, how much less its band changes along one direction than across it, 0 for an edge to 1 for grain: the ratio of
    /// the eigenvalues of the structure tensor (Förstner and Gülch 1987).
    pub roundness: Vec<f64>,
}

/// Where cells are in an image.
pub(super) struct Grid {
    pub width: usize,
    /// Side of a cell, pixels.
    pub cell: usize,
    pub columns: usize,
    pub rows: usize,
}

impl Band {
    /// From values each of which is the mean of a square of `side` pixels.
    pub fn new((values, side): (Vec<f32>, usize), grey: &[f32], grid: &Grid) -> Self {
        let &Grid { width, cell, columns, rows } = grid;
        let first = |i: usize| [i % columns * cell, i / columns * cell];
        let moments = |i: usize| {
            let [x0, y0] = first(i);
            let (mut square, mut sum, mut count) = (0.0f64, 0.0f64, 0usize);
            for y in y0..y0 + cell {
                for x in x0..x0 + cell {
                    let value = f64::from(values[y * width + x]);
                    if !value.is_nan() {
                        square += value.powi(2);
                        sum += f64::from(grey[y * width + x]);
                        count += 1;
                    }
                }
            }
            let enough = count as f64 >= MIN_SHARE * (cell * cell) as f64;
            if enough { ((square / count as f64).sqrt(), sum / count as f64) } else { (0.0, 0.0) }
        };
        let moments: Vec<(f64, f64)> = (0..rows * columns).map(moments).collect();
        let roundness = (0..rows * columns).map(|i| roundness(&values, width, first(i), cell)).collect();
        let deviations = moments.iter().map(|(deviation, _)| *deviation).collect();
        let contrasts = moments.iter().map(|(deviation, mean)| deviation / mean.max(1.0)).collect();
        Self { values, deviations, side, contrasts, roundness }
    }

    /// Whether a cell has more than rounding leaves, of which a single pixel has `least` grey levels.
    pub fn shows(&self, cell: usize, least: f64) -> bool {
        self.deviations[cell] * self.side as f64 >= least
    }
}

/// The image between the edges without its local mean; no number at edges and beside them.
pub(super) fn grain(grey: &[f32], means: &[f32], width: usize, params: &GrainParams) -> Vec<f32> {
    let height = grey.len() / width;
    let is_edge = |i: usize| {
        let (x, y) = (i % width, i / width);
        let slope =
            |before: usize, after: usize, steps: usize| (grey[after] - grey[before]) / steps.max(1) as f32;
        let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
        let (top, bottom) = (y.saturating_sub(1), (y + 1).min(height - 1));
        let along = slope(y * width + left, y * width + right, right - left);
        let down = slope(top * width + x, bottom * width + x, bottom - top);
        f64::from(along.hypot(down)) >= params.min_edge.max(params.edge * f64::from(means[i]))
    };
    let edges: Vec<f32> = (0..grey.len()).map(|i| f32::from(u8::from(is_edge(i)))).collect();
    // A mean of so many zeros and ones: far from rounding.
    let near = box_means(&edges, width, height, params.margin);
    let taken: Vec<f32> = near.iter().map(|share| f32::from(u8::from(*share < 1e-5))).collect();
    let share = box_means(&taken, width, height, params.radius);
    let kept: Vec<f32> = grey.iter().zip(&taken).map(|(value, taken)| value * taken).collect();
    let kept_means = box_means(&kept, width, height, params.radius);
    let near_share = box_means(&taken, width, height, params.blur);
    let near_means = box_means(&kept, width, height, params.blur);
    let value = |i: usize| near_means[i] / near_share[i] - kept_means[i] / share[i];
    (0..grey.len()).map(|i| if taken[i] > 0.0 { value(i) } else { f32::NAN }).collect()
}

/// The ratio of the eigenvalues of the structure tensor of a cell's band.
fn roundness(band: &[f32], width: usize, [x0, y0]: [usize; 2], cell: usize) -> f64 {
    let (mut xx, mut xy, mut yy) = (0.0f64, 0.0f64, 0.0f64);
    for y in y0..y0 + cell - 1 {
        for x in x0..x0 + cell - 1 {
            let at = |x: usize, y: usize| f64::from(band[y * width + x]);
            let (dx, dy) = (at(x + 1, y) - at(x, y), at(x, y + 1) - at(x, y));
            if !dx.is_nan() && !dy.is_nan() {
                xx += dx * dx;
                xy += dx * dy;
                yy += dy * dy;
            }
        }
    }
    let (mean, off) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    if mean > 0.0 { (mean - off) / (mean + off) } else { 0.0 }
}

/// The mean over the square of so many pixels to each side of each pixel, cut at the border.
pub(super) fn box_means(values: &[f32], width: usize, height: usize, radius: usize) -> Vec<f32> {
    let mut sums = vec![0.0f64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0.0;
        for x in 0..width {
            row += f64::from(values[y * width + x]);
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let mean = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (left, right) = (x.saturating_sub(radius), (x + radius + 1).min(width));
        let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(height));
        let at = |x: usize, y: usize| sums[y * (width + 1) + x];
        let sum = at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top);
        (sum / ((right - left) * (bottom - top)) as f64) as f32
    };
    (0..width * height).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_the_square() {
        let values: Vec<f32> = (0..35).map(|i| ((i * 37) % 11) as f32).collect();
        let means = box_means(&values, 7, 5, 2);
        for (i, mean) in means.iter().enumerate() {
            let near = |j: &usize| (j % 7).abs_diff(i % 7) <= 2 && (j / 7).abs_diff(i / 7) <= 2;
            let around: Vec<f32> = (0..35).filter(near).map(|j| values[j]).collect();
            assert!((mean - around.iter().sum::<f32>() / around.len() as f32).abs() < 1e-5);
        }
    }

    /// A grain of 3 grey levels beside a step of 60: the step is left out, and the grain is the same as without it.
    #[test]
    fn grain_is_what_is_between_edges() {
        let (width, height) = (40, 30);
        let noise = |i: usize| 3.0 * ((((i * 7919) % 101) as f32 / 50.0) - 1.0);
        let step = |i: usize| if i % width < 17 { 0.0 } else { 60.0 };
        let found = |with: f32, params: &GrainParams| {
            let grey: Vec<f32> = (0..width * height).map(|i| 100.0 + noise(i) + with * step(i)).collect();
            let means = box_means(&grey, width, height, 4);
            grain(&grey, &means, width, params)
        };
        let (usual, narrow) = (GrainParams::default(), GrainParams { radius: 3, ..GrainParams::default() });
        let reach = 2 + usual.radius;
        for (params, reach) in [(narrow, 5), (usual, reach)] {
            let (plain, beside) = (found(0.0, &params), found(1.0, &params));
            assert!(plain.iter().all(|value| !value.is_nan()));
            for i in 0..width * height {
                let from_step = (i % width).abs_diff(17).min((i % width).abs_diff(16));
                assert_eq!(beside[i].is_nan(), from_step <= 2, "{i}");
                // Means that do not reach what is left out are the same.
                assert!(from_step <= reach || (plain[i] - beside[i]).abs() < 1e-4, "{i}");
                assert!(beside[i].is_nan() || beside[i].abs() < 7.0, "{i}");
            }
        }
    }
}
