//! How much of the differences of Gaussians is noise.

use geometry::{Image, median};

/// Side of a tile, pixels of the first octave: some fifty of its pixels are independent of each other.
const TILE: usize = 32;

/// So many tiles are less quiet than the one that tells the noise, for each that is as quiet or quieter. Most show things.
const LESS_QUIET: usize = 9;

/// The standard deviation of normally distributed numbers in medians of their absolute values.
const MEDIAN_TO_DEVIATION: f32 = 1.4826;

/// The standard deviation, grey levels, that rounding an image to whole grey levels (1/√12) has in the finest differences
/// searched: those of images with blurs of 1.95 and 2.49 pixels beyond the camera's, which keep 0.0438 of white noise.
const ROUNDING: f32 = 0.0126;

/// The standard deviation of the noise, grey levels, in the finest of the differences in which extrema are looked for, of
/// octaves from the first on. In coarser ones it is smaller.
///
/// The quietest tiles of an image show it alone (Olsen, "Estimation of Noise in Images: An Evaluation", CVGIP 1993), by the
/// median of absolute values, which a thing at a tile's border does not move. It is not less than that of rounding, which
/// images without light do not show.
pub fn deviation(octaves: &[Vec<Image<f32>>]) -> f32 {
    let Some(finest) = octaves.first().and_then(|differences| differences.get(1)) else { return ROUNDING };
    let (columns, rows) = (finest.width() / TILE, finest.height() / TILE);
    let corners = (0..rows).flat_map(|row| (0..columns).map(move |column| (column * TILE, row * TILE)));
    let mut medians: Vec<f32> = corners.map(|(x, y)| median_size(finest, x, y, TILE, TILE)).collect();
    if medians.is_empty() {
        medians.push(median_size(finest, 0, 0, finest.width(), finest.height()));
    }
    let quiet = (medians.len() - 1) / (LESS_QUIET + 1);
    let (_, quiet, _) = medians.select_nth_unstable_by(quiet, f32::total_cmp);
    (MEDIAN_TO_DEVIATION * *quiet).max(ROUNDING)
}

/// The median of the absolute values in a part of an image.
fn median_size(image: &Image<f32>, x: usize, y: usize, width: usize, height: usize) -> f32 {
    let rows = (y..y + height).map(|y| &image.row(y)[x..x + width]);
    let mut sizes: Vec<f32> = rows.flatten().map(|value| value.abs()).collect();
    median(&mut sizes).unwrap_or_default()
}
