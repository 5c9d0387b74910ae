//! The surroundings of a key point, sampled on a grid that is turned and sized as the key point is.

use crate::numbers::{direction, rounded};
use geometry::Image;
use geometry::lanes::LANES;

/// Gradients along a side.
pub const SIZE: usize = 20;

/// Grey levels along a side: one more at either end for the differences.
const LEVELS: usize = SIZE + 2;

/// Samples of a row that are worked on: a multiple of what processors do side by side.
const ROW: usize = LEVELS.next_multiple_of(LANES);

/// Steps of a turn in which the gradients' directions are told.
pub const FULL_CIRCLE: usize = 256;

/// Gradients around a point, by rows. Of each row the first [`SIZE`] count.
pub struct Patch {
    levels: [[f32; ROW + 2]; LEVELS],
    /// Lengths, grey levels in two steps of the grid.
    pub lengths: [[f32; ROW]; SIZE],
    /// Directions, from along the rows towards the next row, 0 to [`FULL_CIRCLE`].
    pub turns: [[u32; ROW]; SIZE],
}

impl Patch {
    /// One to be filled.
    pub fn new() -> Self {
        Self { levels: [[0.0; ROW + 2]; LEVELS], lengths: [[0.0; ROW]; SIZE], turns: [[0; ROW]; SIZE] }
    }

    /// Samples an image around `middle`. A row's samples are `step` from each other, those of a column as far, a quarter of a
    /// turn from x towards y further; pixels.
    #[inline(always)]
    pub fn fill(&mut self, image: &Image<f32>, middle: [f32; 2], step: [f32; 2]) {
        for (j, row) in self.levels.iter_mut().enumerate() {
            let down = from_middle(j);
            sample(image, [middle[0] - step[1] * down, middle[1] + step[0] * down], step, row);
        }
        let rows = self.lengths.iter_mut().zip(&mut self.turns);
        for ((lengths, turns), levels) in rows.zip(self.levels.windows(3)) {
            let (up, row, down) = (&levels[0], &levels[1], &levels[2]);
            for i in 0..ROW {
                let (dx, dy) = (row[i + 2] - row[i], down[i + 1] - up[i + 1]);
                lengths[i] = (dx * dx + dy * dy).sqrt();
                turns[i] = rounded(direction(dx, dy) * FULL_CIRCLE as f32);
            }
        }
    }
}

/// Steps from the middle of the grey levels.
#[inline(always)]
fn from_middle(i: usize) -> f32 {
    i as f32 - (LEVELS - 1) as f32 / 2.0
}

/// Grey levels along a line through `middle`, `step` from each other, interpolated bilinearly; beyond the image those at
/// its border.
#[inline(always)]
fn sample(image: &Image<f32>, middle: [f32; 2], step: [f32; 2], row: &mut [f32; ROW + 2]) {
    let (width, height) = (image.width(), image.height());
    let (right, bottom) = ((width - 2) as f32, (height - 2) as f32);
    let (mut corner, mut along, mut down) = ([0; ROW], [0.0; ROW], [0.0; ROW]);
    for i in 0..ROW {
        let (x, y) = (middle[0] + step[0] * from_middle(i), middle[1] + step[1] * from_middle(i));
        let (column, line) = (clamped(x.floor(), right), clamped(y.floor(), bottom));
        (along[i], down[i]) = (clamped(x - column, 1.0), clamped(y - line, 1.0));
        corner[i] = rounded(line) * width as u32 + rounded(column);
    }
    let mut corners = [[0.0; ROW]; 4];
    let (upper, lower) = (image.data(), &image.data()[width..]);
    for (i, &corner) in corner.iter().take(LEVELS).enumerate() {
        let pair = corner as usize..corner as usize + 2;
        let (upper, lower) = (&upper[pair.clone()], &lower[pair]);
        (corners[0][i], corners[1][i]) = (upper[0], upper[1]);
        (corners[2][i], corners[3][i]) = (lower[0], lower[1]);
    }
    for i in 0..ROW {
        let upper = corners[0][i] + along[i] * (corners[1][i] - corners[0][i]);
        let lower = corners[2][i] + along[i] * (corners[3][i] - corners[2][i]);
        row[i] = upper + down[i] * (lower - upper);
    }
}

/// A number between zero and `most`, as processors choose of two; zero for what is none.
#[inline(always)]
fn clamped(value: f32, most: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < most { value } else { most }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grey levels that grow by 3 along x and by 4 along y.
    fn slope(width: usize, height: usize) -> Image<f32> {
        let level = |i: usize| 3.0 * (i % width) as f32 + 4.0 * (i / width) as f32;
        Image::from_vec(width, height, (0..width * height).map(level).collect()).unwrap()
    }

    #[test]
    fn a_slope_has_its_gradient_however_the_grid_is_turned() {
        let mut patch = Patch::new();
        for tenth in 0..10 {
            let angle = f64::from(tenth) * 0.1 * std::f64::consts::TAU;
            let step = [1.3 * angle.cos() as f32, 1.3 * angle.sin() as f32];
            patch.fill(&slope(80, 70), [40.3, 33.8], step);
            let direction = 4f64.atan2(3.0) - angle;
            for (lengths, turns) in patch.lengths.iter().zip(&patch.turns) {
                for (length, direction_step) in lengths.iter().zip(turns).take(SIZE) {
                    assert!((length - 2.0 * 1.3 * 5.0).abs() < 1e-2, "{length}");
                    let off =
                        f64::from(*direction_step) / FULL_CIRCLE as f64 - direction / std::f64::consts::TAU;
                    assert!((off - off.round()).abs() < 0.6 / FULL_CIRCLE as f64, "{off}");
                }
            }
        }
    }

    #[test]
    fn beyond_the_image_there_is_no_gradient() {
        let mut patch = Patch::new();
        let lengths = |patch: &Patch| patch.lengths.map(|row| row[..SIZE].to_vec()).into_iter().flatten();
        for middle in [[-40.0, 5.0], [60.0, 50.0], [5.0, 1e9], [f32::NAN, 5.0]] {
            patch.fill(&slope(30, 20), middle, [1.0, 0.0]);
            assert!(lengths(&patch).all(|length| length <= 10.0), "{middle:?}");
        }
        patch.fill(&slope(30, 20), [-40.0, -40.0], [1.0, 0.0]);
        assert!(lengths(&patch).all(|length| length == 0.0));
    }
}
