//! Images as an ideal camera would have taken them.

use super::{Sensor, Shift, Twist};
use crate::{GrayImage, Image, Pinhole};

/// Side of the squares in which depth is taken to be one, pixels.
const CELL: usize = 32;
/// Side of the squares within which shifts are interpolated, pixels.
const STEP: usize = 8;

/// Inverse depth all over an image from that of some of its pixels: what a rolling shutter's shift needs, of which only a
/// part depends on depth.
#[derive(Clone, Debug)]
pub struct CoarseDepth {
    columns: usize,
    cells: Vec<f32>,
}

impl CoarseDepth {
    /// The mean of the inverse depths in each square of the image; where there is none, that of the squares around. Without
    /// any, all is far away.
    pub fn new(camera: &Pinhole, depths: impl Iterator<Item = ([f32; 2], f32)>) -> Self {
        let (columns, rows) = (camera.width.div_ceil(CELL).max(1), camera.height.div_ceil(CELL).max(1));
        let mut sums = vec![(0.0f64, 0u32); columns * rows];
        for ([x, y], inverse_depth) in depths {
            let (column, row) =
                ((x.max(0.0) as usize / CELL).min(columns - 1), (y.max(0.0) as usize / CELL).min(rows - 1));
            let (sum, count) = &mut sums[row * columns + column];
            (*sum, *count) = (*sum + f64::from(inverse_depth), *count + 1);
        }
        let mut known: Vec<Option<f32>> =
            sums.iter().map(|&(sum, count)| (count > 0).then(|| (sum / f64::from(count)) as f32)).collect();
        while known.iter().any(Option::is_none) && known.iter().any(Option::is_some) {
            let filled = (0..known.len()).map(|i| known[i].or_else(|| around(&known, i, columns)));
            known = filled.collect();
        }
        Self { columns, cells: known.into_iter().map(|cell| cell.unwrap_or(0.0)).collect() }
    }

    /// The inverse depth at a pixel of the image, or at the nearest one that lies in it.
    pub fn at(&self, [x, y]: [f32; 2]) -> f32 {
        let rows = self.cells.len() / self.columns;
        let place = |v: f32, count: usize| {
            let v = (v / CELL as f32 - 0.5).clamp(0.0, (count - 1) as f32);
            let low = (v as usize).min(count.saturating_sub(2));
            (low, (low + 1).min(count - 1), v - low as f32)
        };
        let ((left, right, dx), (top, bottom, dy)) = (place(x, self.columns), place(y, rows));
        let row = |row: usize| {
            let (a, b) = (self.cells[row * self.columns + left], self.cells[row * self.columns + right]);
            a + dx * (b - a)
        };
        row(top) + dy * (row(bottom) - row(top))
    }
}

/// Mean of the known ones among the eight squares around one.
fn around(known: &[Option<f32>], i: usize, columns: usize) -> Option<f32> {
    let (x, y, rows) = (i % columns, i / columns, known.len() / columns);
    let (mut sum, mut count) = (0.0, 0);
    for row in y.saturating_sub(1)..=(y + 1).min(rows - 1) {
        for column in x.saturating_sub(1)..=(x + 1).min(columns - 1) {
            if let Some(depth) = known[row * columns + column] {
                (sum, count) = (sum + depth, count + 1);
            }
        }
    }
    (count > 0).then(|| sum / count as f32)
}

/// Converts one image to that of an ideal pinhole camera, which reads all rows at once.
#[derive(Clone, Debug)]
pub struct Rectification {
    shift: Shift,
    depth: CoarseDepth,
}

impl Rectification {
    /// For an image whose camera had this `motion` and saw these depths; inverse depths are in 1/unit of the motion's
    /// υ.
    pub fn new(sensor: &Sensor, motion: &Twist, depth: CoarseDepth) -> Self {
        Self { shift: Shift::new(sensor, motion), depth }
    }

    /// Where the ideal camera sees what the image shows at `pixel`, of the inverse depth that the surroundings have.
    pub fn pixel(&self, pixel: [f32; 2]) -> [f32; 2] {
        self.pixel_at(pixel, self.depth.at(pixel))
    }

    /// Where the ideal camera sees what the image shows at `pixel`, of this inverse depth.
    pub fn pixel_at(&self, pixel: [f32; 2], inverse_depth: f32) -> [f32; 2] {
        let [x, y] = self.shift.to_undistorted(pixel, inverse_depth);
        [pixel[0] + x, pixel[1] + y]
    }

    /// The ideal camera's image. Pixels that the sensor did not see repeat its border.
    pub fn image(&self, image: &GrayImage) -> GrayImage {
        let (width, height) = (image.width(), image.height());
        let columns = width.div_ceil(STEP) + 1;
        let shifts: Vec<[f32; 2]> = (0..columns * (height.div_ceil(STEP) + 1))
            .map(|i| {
                let pixel = [(i % columns * STEP) as f32, (i / columns * STEP) as f32];
                self.shift.to_distorted(pixel, self.depth.at(pixel))
            })
            .collect();
        let mut out = Image::filled(width, height, 0);
        for y in 0..height {
            let dy = (y % STEP) as f32 / STEP as f32;
            for x in 0..width {
                let (dx, i) = ((x % STEP) as f32 / STEP as f32, y / STEP * columns + x / STEP);
                let shift = [0, 1].map(|axis: usize| {
                    let [a, b, c, d] = [0, 1, columns, columns + 1].map(|j| shifts[i + j][axis]);
                    let (top, bottom) = (a + dx * (b - a), c + dx * (d - c));
                    top + dy * (bottom - top)
                });
                out.set(x, y, cubic(image, x as f32 + shift[0], y as f32 + shift[1]));
            }
        }
        out
    }
}

/// Intensity at a place by Catmull and Rom's cubic, which blurs less than lines do; beyond the border that of the border.
fn cubic(image: &GrayImage, x: f32, y: f32) -> u8 {
    let (x0, y0) = (x.floor(), y.floor());
    let (wx, wy) = (weights(x - x0), weights(y - y0));
    let (x0, y0) = (x0 as i64 - 1, y0 as i64 - 1);
    let (right, bottom) = (image.width() as i64 - 1, image.height() as i64 - 1);
    let is_inside = x0 >= 0 && y0 >= 0 && x0 + 3 <= right && y0 + 3 <= bottom;
    let mut sum = 0.0;
    for (j, wy) in (0..4).zip(wy) {
        let row = image.row((y0 + j).clamp(0, bottom) as usize);
        let along: f32 = if is_inside {
            row[x0 as usize..x0 as usize + 4].iter().zip(wx).map(|(&v, w)| w * f32::from(v)).sum()
        } else {
            (0..4).zip(wx).map(|(i, w)| w * f32::from(row[(x0 + i).clamp(0, right) as usize])).sum()
        };
        sum += wy * along;
    }
    // Saturates.
    sum.round() as u8
}

/// Weights of the four samples around a place `t` of the way between the middle two.
fn weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (2.0 * t2 - t - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 120.0, fy: 120.0, cx: 79.5, cy: 59.5 };

    /// Something smooth.
    fn scene([x, y]: [f64; 2]) -> u8 {
        (128.0 + 60.0 * (x / 9.0).sin() * (y / 7.0).cos() + 40.0 * (y / 11.0).sin()).round() as u8
    }

    #[test]
    fn an_image_becomes_that_of_an_ideal_camera() {
        let sensor = Sensor::ideal(CAMERA).with([-0.03, 0.0, 0.025]);
        let motion = Twist::new(0.5, -0.2, 0.3, 0.4, -0.9, 0.5);
        let depths = (0..120).flat_map(|y| (0..160).map(move |x| ([x as f32, y as f32], 0.5)));
        let rectification = Rectification::new(&sensor, &motion, CoarseDepth::new(&CAMERA, depths));
        let distorted =
            |i: usize| scene(sensor.undistorted_pixel([(i % 160) as f64, (i / 160) as f64], &motion, 0.5));
        let image = GrayImage::from_vec(160, 120, (0..160 * 120).map(distorted).collect()).unwrap();
        let ideal = rectification.image(&image);
        let (mut off, mut before) = (0.0, 0.0);
        for (y, x) in (12..108).flat_map(|y| (12..148).map(move |x| (y, x))) {
            let truth = f64::from(scene([x as f64, y as f64]));
            off += (f64::from(ideal.get(x, y)) - truth).abs();
            before += (f64::from(image.get(x, y)) - truth).abs();
        }
        // What is left is rounding and the cubic's.
        assert!(5.0 * off < before, "{off} of {before}");
        let [x, y] = rectification.pixel([20.0, 100.0]);
        let [u, v] = sensor.undistorted_pixel([20.0, 100.0], &motion, 0.5);
        assert!((f64::from(x) - u).hypot(f64::from(y) - v) < 1e-3);
    }

    #[test]
    fn an_ideal_camera_s_image_stays_as_it_is() {
        let image =
            GrayImage::from_vec(160, 120, (0..160 * 120).map(|i| (i * 7 % 251) as u8).collect()).unwrap();
        let sensor = Sensor::ideal(CAMERA);
        let still =
            Rectification::new(&sensor, &Twist::zeros(), CoarseDepth::new(&CAMERA, std::iter::empty()));
        assert_eq!(still.image(&image), image);
        assert_eq!(still.pixel([17.0, 3.5]), [17.0, 3.5]);
    }

    #[test]
    fn depth_is_known_everywhere_from_some_of_it() {
        let some = [([10.0, 10.0], 0.5), ([20.0, 12.0], 0.7), ([150.0, 110.0], 0.1)];
        let depth = CoarseDepth::new(&CAMERA, some.into_iter());
        assert!((depth.at([0.0, 0.0]) - 0.6).abs() < 1e-6);
        assert!((depth.at([400.0, 400.0]) - 0.1).abs() < 1e-6);
        let between = depth.at([80.0, 60.0]);
        assert!((0.1..0.6).contains(&between), "{between}");
        assert_eq!(CoarseDepth::new(&CAMERA, std::iter::empty()).at([80.0, 60.0]), 0.0);
    }
}
