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
    pub fn new((values, side): (Vec<f32>, usize), grey: &[u8], grid: &Grid) -> Self {
        let &Grid { width, cell, columns, rows } = grid;
        let first = |i: usize| [i % columns * cell, i / columns * cell];
        let moments = |i: usize| {
            let [x0, y0] = first(i);
            let (mut square, mut sum, mut count) = (0.0f64, 0.0f64, 0usize);
            for y in y0..y0 + cell {
                let row = y * width + x0..y * width + x0 + cell;
                for (&value, &grey) in values[row.clone()].iter().zip(&grey[row]) {
                    if !value.is_nan() {
                        square += f64::from(value).powi(2);
                        sum += f64::from(grey);
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
pub(super) fn grain(grey: &[u8], means: &[f32], width: usize, params: &GrainParams) -> Vec<f32> {
    let edges = edges(grey, means, width, params);
    let near_edges = box_sums(&edges, width, params.margin);
    let taken: Vec<u8> = near_edges.iter().map(|sum| u8::from(*sum == 0)).collect();
    let kept: Vec<u8> = grey.iter().zip(&taken).map(|(value, taken)| value * taken).collect();
    let means = |values: &[u8], radius: usize| box_means(values, width, radius);
    let around = [means(&kept, params.radius), means(&taken, params.radius)];
    let near = [means(&kept, params.blur), means(&taken, params.blur)];
    let value = |i: usize| near[0][i] / near[1][i] - around[0][i] / around[1][i];
    (0..grey.len()).map(|i| if taken[i] > 0 { value(i) } else { f32::NAN }).collect()
}

/// 1 where the image has the slope of an edge, else 0.
fn edges(grey: &[u8], means: &[f32], width: usize, params: &GrainParams) -> Vec<u8> {
    let height = grey.len() / width;
    let row = |y: usize| &grey[y * width..][..width];
    let mut edges = Vec::with_capacity(grey.len());
    for y in 0..height {
        let (top, bottom) = (y.saturating_sub(1), (y + 1).min(height - 1));
        let (here, above, below, means) = (row(y), row(top), row(bottom), &means[y * width..][..width]);
        edges.extend((0..width).map(|x| {
            let slope = |before: u8, after: u8, steps: usize| {
                (f32::from(after) - f32::from(before)) / steps.max(1) as f32
            };
            let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
            let along = slope(here[left], here[right], right - left);
            let down = slope(above[x], below[x], bottom - top);
            let least = params.min_edge.max(params.edge * f64::from(means[x]));
            u8::from(is_longer([along, down], least))
        }));
    }
    edges
}

/// Whether a slope is at least so large: `hypot`, which is asked only where its rounding may decide.
fn is_longer([along, down]: [f32; 2], least: f64) -> bool {
    const ROUNDING: f64 = 1e-6;
    let squared = f64::from(along).powi(2) + f64::from(down).powi(2);
    if (squared - least * least).abs() > ROUNDING * (squared + least * least) {
        squared > least * least
    } else {
        f64::from(along.hypot(down)) >= least
    }
}

/// The ratio of the eigenvalues of the structure tensor of a cell's band.
fn roundness(band: &[f32], width: usize, [x0, y0]: [usize; 2], cell: usize) -> f64 {
    let (mut xx, mut xy, mut yy) = (0.0f64, 0.0f64, 0.0f64);
    for y in y0..y0 + cell - 1 {
        let row = |y: usize| &band[y * width + x0..][..cell];
        for (here, below) in row(y).windows(2).zip(row(y + 1)) {
            let [value, right, below] = [here[0], here[1], *below].map(f64::from);
            let (dx, dy) = (right - value, below - value);
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
pub(super) fn box_means(values: &[u8], width: usize, radius: usize) -> Vec<f32> {
    let height = values.len() / width;
    let within = |at: usize, size: usize| (at + radius + 1).min(size) - at.saturating_sub(radius);
    let columns: Vec<f32> = (0..width).map(|x| within(x, width) as f32).collect();
    let mut means = Vec::with_capacity(values.len());
    for (y, sums) in box_sums(values, width, radius).chunks_exact(width).enumerate() {
        let rows = within(y, height) as f32;
        // All are whole numbers that a float holds, so that the quotient is rounded once.
        means.extend(sums.iter().zip(&columns).map(|(sum, columns)| *sum as f32 / (rows * columns)));
    }
    means
}

geometry::multiversion! {
    /// The sum over that square: of columns from row to row, then of these along each row.
    fn box_sums(values: &[u8], width: usize, radius: usize) -> Vec<i32> {
        let mut sums = vec![0; values.len()];
        let height = values.len() / width;
        let row = |y: usize| &values[y * width..][..width];
        let mut columns = vec![0i32; width];
        for y in 0..radius.min(height) {
            columns.iter_mut().zip(row(y)).for_each(|(sum, value)| *sum += i32::from(*value));
        }
        // Sums of all columns before each.
        let mut before = vec![0i32; width + 1];
        for y in 0..height {
            if y + radius < height {
                columns.iter_mut().zip(row(y + radius)).for_each(|(sum, value)| *sum += i32::from(*value));
            }
            if y > radius {
                let gone = row(y - radius - 1);
                columns.iter_mut().zip(gone).for_each(|(sum, value)| *sum -= i32::from(*value));
            }
            let mut sum = 0;
            for (column, before) in columns.iter().zip(&mut before[1..]) {
                sum += column;
                *before = sum;
            }
            let sums = &mut sums[y * width..][..width];
            let at = |x: usize| before[(x + radius + 1).min(width)] - before[x.saturating_sub(radius)];
            let inner = radius..width.saturating_sub(radius);
            for x in (0..width).filter(|x| !inner.contains(x)) {
                sums[x] = at(x);
            }
            if let (Some(sums), Some(ends)) = (sums.get_mut(inner), before.get(2 * radius + 1..)) {
                sums.iter_mut().zip(ends).zip(&before).for_each(|((sum, end), start)| *sum = end - start);
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_the_square() {
        let values: Vec<u8> = (0..35).map(|i| ((i * 37) % 11) as u8).collect();
        let means = box_means(&values, 7, 2);
        for (i, mean) in means.iter().enumerate() {
            let near = |j: &usize| (j % 7).abs_diff(i % 7) <= 2 && (j / 7).abs_diff(i / 7) <= 2;
            let around: Vec<f32> = (0..35).filter(near).map(|j| f32::from(values[j])).collect();
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
            let grey = |i: usize| (100.0 + noise(i) + with * step(i)).round() as u8;
            let grey: Vec<u8> = (0..width * height).map(grey).collect();
            let means = box_means(&grey, width, 4);
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
