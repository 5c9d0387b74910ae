//! The shift between the pixels of a real and of an ideal camera, for many pixels at a time.

use super::{Sensor, Twist};
use crate::Pinhole;

/// The shift between the pixels of one image and those of an ideal pinhole camera that reads all rows at once. It
/// combines a [`Sensor`] with the camera's motion, in single precision and free of branches. All shifts of an ideal
/// sensor are exactly zero.
#[derive(Clone, Copy, Debug)]
pub struct Shift {
    centre: [f32; 2],
    focal: [f32; 2],
    per_focal: [f32; 2],
    /// Share of its distance from the middle by which a point at distance one of the image plane moves.
    bend: f32,
    /// Translation and turn a second.
    speed: [f32; 3],
    rotation_speed: [f32; 3],
    /// Reading time a column and a row, seconds, and that of the pixel (0, 0) after the middle.
    delay: [f32; 3],
}

impl Shift {
    /// For an image of a camera that has this `motion`; υ is in the units of which inverse depths are the inverse.
    pub fn new(sensor: &Sensor, motion: &Twist) -> Self {
        let camera = &sensor.lens.camera;
        let [columns, rows] = sensor.readout;
        let delay = [columns / camera.width as f64, rows / camera.height as f64, sensor.delay([0.0, 0.0])];
        let part = |start: usize| [0, 1, 2].map(|i| motion[start + i] as f32);
        Self {
            centre: [camera.cx as f32, camera.cy as f32],
            focal: [camera.fx as f32, camera.fy as f32],
            per_focal: [camera.fx.recip() as f32, camera.fy.recip() as f32],
            bend: sensor.lens.bend() as f32,
            speed: part(0),
            rotation_speed: part(3),
            delay: delay.map(|seconds| seconds as f32),
        }
    }

    /// For an ideal camera.
    pub fn none(camera: Pinhole) -> Self {
        Self::new(&Sensor::ideal(camera), &Twist::zeros())
    }

    /// Whether the lens shifts anything.
    pub fn is_bent(&self) -> bool {
        self.bend != 0.0
    }

    /// Whether not all of the image was read at once.
    pub fn is_rolling(&self) -> bool {
        self.delay != [0.0; 3]
    }

    #[inline(always)]
    fn plane(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        [(u - self.centre[0]) * self.per_focal[0], (v - self.centre[1]) * self.per_focal[1]]
    }

    /// How far what the image shows at `pixel` moves until its pixel is read (see [`Sensor::velocity`]).
    #[inline(always)]
    fn moved(&self, pixel: [f32; 2], inverse_depth: f32) -> [f32; 2] {
        let ([x, y], [vx, vy, vz], [wx, wy, wz]) = (self.plane(pixel), self.speed, self.rotation_speed);
        let [column, row, first] = self.delay;
        let delay = pixel[0] * column + pixel[1] * row + first;
        let along_x = inverse_depth * (vx - x * vz) - x * y * wx + (1.0 + x * x) * wy - y * wz;
        let along_y = inverse_depth * (vy - y * vz) - (1.0 + y * y) * wx + x * y * wy + x * wz;
        [self.focal[0] * along_x * delay, self.focal[1] * along_y * delay]
    }

    /// From where the image shows a point to where the ideal camera sees it, pixels, by the lens alone.
    #[inline(always)]
    pub fn lens_to_undistorted(&self, distorted: [f32; 2]) -> [f32; 2] {
        let [x, y] = self.plane(distorted);
        let out = self.bend * (x * x + y * y);
        [self.focal[0] * x * out, self.focal[1] * y * out]
    }

    /// From where the ideal camera sees a point to where the image shows it, pixels, by the lens alone.
    #[inline(always)]
    pub fn lens_to_distorted(&self, undistorted: [f32; 2]) -> [f32; 2] {
        let [x, y] = self.plane(undistorted);
        // The root of f (1 + e f²) = 1 near one, as a series.
        let e = self.bend * (x * x + y * y);
        let less = e * (1.0 - e * (3.0 - e * (12.0 - 55.0 * e)));
        [-self.focal[0] * x * less, -self.focal[1] * y * less]
    }

    /// From where the image shows a point of this inverse depth to where the ideal camera sees it, pixels.
    #[inline(always)]
    pub fn to_undistorted(&self, distorted: [f32; 2], inverse_depth: f32) -> [f32; 2] {
        let moved = self.moved(distorted, inverse_depth);
        let bent = self.lens_to_undistorted([distorted[0] - moved[0], distorted[1] - moved[1]]);
        [bent[0] - moved[0], bent[1] - moved[1]]
    }

    /// From where the ideal camera sees a point of this inverse depth to where the image shows it, pixels.
    #[inline(always)]
    pub fn to_distorted(&self, undistorted: [f32; 2], inverse_depth: f32) -> [f32; 2] {
        let bent = self.lens_to_distorted(undistorted);
        let still = [undistorted[0] + bent[0], undistorted[1] + bent[1]];
        let moved = self.moved(still, inverse_depth);
        let moved = self.moved([still[0] + moved[0], still[1] + moved[1]], inverse_depth);
        [bent[0] + moved[0], bent[1] + moved[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 410.0, cx: 310.0, cy: 250.0 };

    #[test]
    fn pixels_move_as_the_sensor_says() {
        let motion = Twist::new(0.4, -0.3, 0.5, 0.6, -0.9, 0.4);
        for unknowns in [[-0.02, 0.0, 0.025], [0.03, -0.02, 0.0], [0.01, 0.0, 0.0]] {
            let sensor = Sensor::ideal(CAMERA).with(unknowns);
            let shift = Shift::new(&sensor, &motion);
            for (pixel, inverse_depth) in [([20.0, 30.0], 0.5), ([600.0, 440.0], 1.5), ([310.0, 9.0], 0.0)] {
                let single = pixel.map(|v| v as f32);
                let agree = |by: [f32; 2], to: [f64; 2]| {
                    let off =
                        (f64::from(by[0]) - (to[0] - pixel[0])).hypot(f64::from(by[1]) - (to[1] - pixel[1]));
                    assert!(off < 2e-3, "{unknowns:?} {pixel:?}: {off}");
                };
                agree(
                    shift.to_undistorted(single, inverse_depth as f32),
                    sensor.undistorted_pixel(pixel, &motion, inverse_depth),
                );
                agree(
                    shift.to_distorted(single, inverse_depth as f32),
                    sensor.distorted_pixel(pixel, &motion, inverse_depth),
                );
            }
        }
    }

    #[test]
    fn an_ideal_sensor_shifts_nothing() {
        let shift = Shift::new(&Sensor::ideal(CAMERA), &Twist::new(0.4, -0.3, 0.5, 0.6, -0.9, 0.4));
        for pixel in [[0.0, 0.0], [123.4, 456.7], [9000.0, -20.0]] {
            assert_eq!(shift.to_undistorted(pixel, 0.7), [0.0; 2]);
            assert_eq!(shift.to_distorted(pixel, 0.7), [0.0; 2]);
        }
    }
}
