//! The camera beyond its calibration: the remaining distortion of its lens, and its readout time, in which a rolling
//! shutter reads the rows of an image one after the other.
//!
//! A camera that moves while its sensor is read bends its images: the upper rows show an earlier instant than the
//! lower ones (rolling shutter; Meingast et al., OMNIVIS 2005). A frame's pose is that of its middle row. A pixel is
//! moved to where the instant of that row would show it, by the motion from frame to frame (constant velocity;
//! Hedborg et al., CVPR 2012). The recording itself gives the readout time: like the lens, it is an unknown of the
//! joint optimisation. A telephone that records upright reads the columns of its video one after the other.

mod lens;
mod rectify;
mod shift;

pub use lens::Lens;
pub use rectify::{CoarseDepth, Rectification};
pub use shift::Shift;

use crate::{Pinhole, Se3};
use nalgebra::{Vector2, Vector3, Vector6};

/// Unknowns of a sensor: those of its lens, and the readout times.
pub const UNKNOWNS: usize = lens::TERMS + 2;

/// Shortest readout time of a rolling shutter, seconds: sensors take 5 to 35 milliseconds. Recordings of cameras that expose
/// all rows at once come out within 1.5.
const LEAST_READOUT: f64 = 0.003;

/// Largest shift of pixels that is not worth to be undone, pixels: images are aligned to about twice that.
const LEAST_SHIFT: f64 = 0.05;

/// Share of a readout time by which another one differs from it much: as much of what moves is left.
const MUCH_READOUT: f64 = 0.25;
/// Share of its distance from the middle by which an image's corner lies elsewhere if two lenses differ much: about a pixel of
/// an image of 640 × 480.
const MUCH_LENS: f64 = 2e-3;

/// Longest time between frames over which a camera is taken to move evenly, seconds: hands turn back within a few tenths.
const EVEN: f64 = 0.2;

/// Motion of a camera: left-multiplicative twist (υ, ω) of `camera_from_world` a second; υ in map units.
pub type Twist = Vector6<f64>;

/// The motion between two poses `camera_from_world` that are `seconds` apart, negative if the second is earlier. Zero
/// where they are too far apart in time, or too close, to give a velocity.
pub fn motion(from: &Se3, to: &Se3, seconds: f64) -> Twist {
    // Below a tenth of a millisecond, stamps tell nothing of velocities.
    if !(1e-4..EVEN).contains(&seconds.abs()) {
        return Twist::zeros();
    }
    (*to * from.inverse()).log() / seconds
}

/// A lens and a shutter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// The remaining distortion of the lens.
    pub lens: Lens,
    /// Time from reading the first column to reading the last, and from the first row to the last, seconds; negative where
    /// the last comes first. One of them is zero.
    pub readout: [f64; 2],
    /// Standard deviation of the readout time that is not zero, seconds; 0 where nobody found it.
    pub readout_deviation: f64,
}

impl Sensor {
    /// A lens without remaining distortion, and all rows read at once.
    pub fn ideal(camera: Pinhole) -> Self {
        Self { lens: Lens::ideal(camera), readout: [0.0; 2], readout_deviation: 0.0 }
    }

    /// The values of the unknowns.
    pub fn unknowns(&self) -> [f64; UNKNOWNS] {
        let ([radial], [columns, rows]) = (self.lens.terms, self.readout);
        [radial, columns, rows]
    }

    /// The sensor with these values of the unknowns.
    pub fn with(mut self, [radial, columns, rows]: [f64; UNKNOWNS]) -> Self {
        (self.lens.terms, self.readout) = ([radial], [columns, rows]);
        self
    }

    /// The sensor with other readout times, of which no deviation is known.
    pub fn with_readout(self, readout: [f64; 2]) -> Self {
        Self { readout, readout_deviation: 0.0, ..self }
    }

    /// Whether not all of an image is read at once.
    #[inline(always)]
    pub fn is_rolling(&self) -> bool {
        let [columns, rows] = self.readout;
        columns != 0.0 || rows != 0.0
    }

    /// Whether its images differ from those of an ideal camera by less than matters.
    pub fn is_ideal(&self) -> bool {
        !self.is_rolling() && self.lens.corner_shift().abs() < LEAST_SHIFT
    }

    /// The distance from the middle, as a share of the corner's, beyond which depths that were found with `other` are
    /// off by more than their other errors. `None` where they are off nowhere.
    pub fn differs_beyond(&self, other: &Self) -> Option<f64> {
        let longest = |times: [f64; 2]| times.iter().map(|time| time.abs()).fold(0.0, f64::max);
        let change = longest([0, 1].map(|i| self.readout[i] - other.readout[i]));
        if change > MUCH_READOUT * longest(self.readout).max(longest(other.readout)) {
            return Some(0.0);
        }
        // What a lens moves its pixels by grows with the third power of the distance.
        let corner = (self.lens.terms[0] - other.lens.terms[0]).abs();
        (corner > MUCH_LENS).then(|| (MUCH_LENS / corner).cbrt())
    }

    /// The readout times if they can be those of a rolling shutter: the longer of the two if it is long enough, and 0
    /// otherwise.
    pub fn plausible_readout(&self) -> [f64; 2] {
        let [columns, rows] = self.readout;
        let longest = columns.abs().max(rows.abs());
        [columns, rows].map(|time| if time.abs() == longest && longest >= LEAST_READOUT { time } else { 0.0 })
    }

    /// The velocity at which a point moves through `pixel`, pixels a second. `inverse_depth` is the point's inverse
    /// depth in the moving camera.
    #[inline(always)]
    pub fn velocity(&self, pixel: [f64; 2], motion: &Twist, inverse_depth: f64) -> Vector2<f64> {
        let Pinhole { fx, fy, .. } = self.lens.camera;
        let ray = self.lens.camera.unproject(pixel[0], pixel[1]);
        let (x, y, rho) = (ray.x, ray.y, inverse_depth);
        let along =
            |by: [f64; 6]| by.iter().zip(motion.as_slice()).map(|(by, motion)| by * motion).sum::<f64>();
        Vector2::new(
            along([fx * rho, 0.0, -fx * x * rho, -fx * x * y, fx * (1.0 + x * x), -fx * y]),
            along([0.0, fy * rho, -fy * y * rho, -fy * (1.0 + y * y), fy * x * y, fy * x]),
        )
    }

    /// The position of a pixel between the first and the last column, and row: −½ to ½.
    #[inline(always)]
    pub fn order(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let camera = &self.lens.camera;
        [(x + 0.5) / camera.width as f64 - 0.5, (y + 0.5) / camera.height as f64 - 0.5]
    }

    /// When a pixel is read, seconds after the middle of the image.
    #[inline(always)]
    pub fn delay(&self, pixel: [f64; 2]) -> f64 {
        let ([x, y], [columns, rows]) = (self.order(pixel), self.readout);
        x * columns + y * rows
    }

    /// Where an ideal pinhole camera that reads all rows at once sees what the image shows at `pixel`.
    #[inline(always)]
    pub fn undistorted_pixel(&self, pixel: [f64; 2], motion: &Twist, inverse_depth: f64) -> [f64; 2] {
        if !self.is_rolling() {
            return self.lens.undistort(pixel);
        }
        let still = Vector2::from(pixel) - self.velocity(pixel, motion, inverse_depth) * self.delay(pixel);
        self.lens.undistort(still.into())
    }

    /// Where the image shows what that camera sees at `pixel`; exact but for how the point's velocity changes over the shift.
    #[inline(always)]
    pub fn distorted_pixel(&self, pixel: [f64; 2], motion: &Twist, inverse_depth: f64) -> [f64; 2] {
        let still = self.lens.distort(pixel);
        if !self.is_rolling() {
            return still;
        }
        let mut distorted = still;
        for _ in 0..2 {
            let moved = self.velocity(distorted, motion, inverse_depth) * self.delay(distorted);
            distorted = (Vector2::from(still) + moved).into();
        }
        distorted
    }

    /// The ray through what the image shows at `pixel`, z = 1.
    pub fn ray(&self, pixel: [f64; 2], motion: &Twist, inverse_depth: f64) -> Vector3<f64> {
        let [x, y] = self.undistorted_pixel(pixel, motion, inverse_depth);
        self.lens.camera.unproject(x, y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 410.0, cx: 310.0, cy: 250.0 };

    fn twist() -> Twist {
        Twist::new(0.4, -0.3, 0.5, 0.6, -0.9, 0.4)
    }

    /// A point before a moving camera is shown where it is when its pixel is read, and brought back to where it was in the
    /// middle of the image.
    #[test]
    fn what_moves_while_it_is_read_is_put_back() {
        for readout in [[0.0, 0.025], [0.02, 0.0], [0.0, -0.02]] {
            let sensor = Sensor { readout, ..Sensor::ideal(CAMERA) };
            for (u, v, depth) in [(40.0, 30.0, 2.0), (600.0, 450.0, 1.0), (320.0, 100.0, 5.0)] {
                let point = CAMERA.unproject(u, v) * depth;
                let at = |seconds: f64| -> [f64; 2] {
                    CAMERA.project(&(Se3::exp(&(twist() * seconds)) * point)).into()
                };
                let mut distorted = [u, v];
                for _ in 0..20 {
                    distorted = at(sensor.delay(distorted));
                }
                let moved = (distorted[0] - u).hypot(distorted[1] - v);
                let back = sensor.undistorted_pixel(distorted, &twist(), 1.0 / depth);
                let off = (back[0] - u).hypot(back[1] - v);
                assert!(off < 0.03 * moved + 1e-6, "{readout:?} {u} {v}: {off} of {moved} pixels");
                let there = sensor.distorted_pixel([u, v], &twist(), 1.0 / depth);
                let off = (there[0] - distorted[0]).hypot(there[1] - distorted[1]);
                assert!(off < 0.03 * moved + 1e-6, "{readout:?} {u} {v}: {off} of {moved} pixels");
            }
        }
    }

    #[test]
    fn a_sensor_that_is_read_at_once_shows_what_its_lens_shows() {
        let sensor = Sensor::ideal(CAMERA).with([-0.02, 0.0, 0.0]);
        let pixel = [60.0, 400.0];
        assert_eq!(sensor.undistorted_pixel(pixel, &twist(), 0.5), sensor.lens.undistort(pixel));
        assert_eq!(sensor.distorted_pixel(pixel, &twist(), 0.5), sensor.lens.distort(pixel));
        assert_eq!(sensor.unknowns(), [-0.02, 0.0, 0.0]);
    }

    #[test]
    fn a_readout_time_that_no_sensor_has_is_none() {
        let plausible = |readout| Sensor { readout, ..Sensor::ideal(CAMERA) }.plausible_readout();
        assert_eq!(plausible([0.001, -0.0014]), [0.0, 0.0]);
        assert_eq!(plausible([0.001, 0.02]), [0.0, 0.02]);
        assert_eq!(plausible([-0.024, 0.004]), [-0.024, 0.0], "of one sensor, either rows or columns");
    }

    #[test]
    fn sensors_differ_by_what_their_images_show() {
        let sensor = |unknowns| Sensor::ideal(CAMERA).with(unknowns);
        let beyond = |a, b| sensor(a).differs_beyond(&sensor(b));
        assert_eq!(beyond([1e-3, 0.0, 0.024], [0.0, 0.0, 0.021]), None);
        assert_eq!(beyond([0.0, 0.0, 0.024], [0.0; 3]), Some(0.0));
        assert_eq!(beyond([0.0, 0.0, 0.024], [0.0, 0.0, 0.017]), Some(0.0));
        assert_eq!(beyond([9e-3, 0.0, 0.024], [0.0, 0.0, 0.0]), Some(0.0));
        // Where the two move a pixel by as much apart as the corner may be.
        let (new, old) = (sensor([-6e-3, 0.0, 0.0]), sensor([1e-3, 0.0, 0.0]));
        let share = new.differs_beyond(&old).expect("seven thousandths at the corner");
        let Pinhole { fx, fy, cx, cy, .. } = CAMERA;
        let corner = (0.5 * CAMERA.width as f64 / fx).hypot(0.5 * CAMERA.height as f64 / fy);
        let off = [0.6 * share * corner * fx, -0.8 * share * corner * fy];
        let pixel = [cx + off[0], cy + off[1]];
        let [a, b] = [new, old].map(|sensor| sensor.lens.undistort(pixel));
        let moved = (a[0] - b[0]).hypot(a[1] - b[1]) / off[0].hypot(off[1]);
        assert!((moved * share - MUCH_LENS).abs() < 1e-9, "{moved}");
        assert!((new.lens.share_of_corner(pixel) - share).abs() < 1e-9);
        assert!(sensor([1e-5, 0.0, 0.0]).is_ideal() && !sensor([1e-3, 0.0, 0.0]).is_ideal());
    }

    #[test]
    fn motion_is_a_second_s_and_none_over_long_gaps() {
        let (from, to) = (Se3::exp(&(twist() * 0.3)), Se3::exp(&(twist() * 0.4)));
        assert!((motion(&from, &to, 0.1) - twist()).norm() < 1e-9);
        assert!((motion(&to, &from, -0.1) - twist()).norm() < 1e-9, "backwards in time it is the same");
        assert_eq!(motion(&from, &to, 0.5), Twist::zeros());
        assert_eq!(motion(&from, &to, 0.0), Twist::zeros());
    }
}
