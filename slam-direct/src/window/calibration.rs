//! The sensor as unknowns of the joint optimisation: its lens, and how long it takes to be read.

use super::pairs::Relative;
use super::problem::{Problem, WindowPoint};
use geometry::sensor::{Sensor, UNKNOWNS};
use nalgebra::{Matrix2, SMatrix, Vector2};

/// What readout times err by besides, as a share of themselves: a camera that turns and shakes does not move evenly from frame to
/// frame, as is assumed. Three quarters of the hand-held recordings that the example `nees` renders err by less.
const UNMODELLED: f64 = 0.03;

/// A problem's sensor and what the images show; [`Problem::set_sensor`] derives rays and pixels from it.
#[derive(Clone, Debug)]
pub(crate) struct Calibration {
    /// The sensor as it stands.
    pub sensor: Sensor,
    /// Standard deviations of its unknowns before anything is seen; one of zero is no unknown but known.
    pub sigma: [f64; UNKNOWNS],
    /// Their variances once it is solved, of the joint optimisation's own matrix; zero of what is known.
    pub variance: [f64; UNKNOWNS],
    /// Each point in its host's image.
    pub hosts: Vec<DistortedPixel>,
    /// Each observation in its image, and its information there.
    pub seen: Vec<(DistortedPixel, [f64; 3])>,
}

/// Where an image shows a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DistortedPixel {
    pub pixel: [f64; 2],
    /// How fast it moves there, pixels a second (see [`Sensor::velocity`]).
    pub velocity: Vector2<f64>,
}

impl DistortedPixel {
    /// The pixel had all of the image been read at once.
    fn still(&self, sensor: &Sensor) -> [f64; 2] {
        (Vector2::from(self.pixel) - self.velocity * sensor.delay(self.pixel)).into()
    }

    /// Derivatives by the unknowns of where an ideal camera sees it, pixels.
    fn by_unknowns(&self, sensor: &Sensor) -> [Vector2<f64>; UNKNOWNS] {
        let still = self.still(sensor);
        let [radial] = sensor.lens.by_terms(still);
        let moved = -(sensor.lens.magnification(still) * self.velocity);
        let [columns, rows] = sensor.order(self.pixel).map(|order| moved * order);
        [radial, columns, rows]
    }
}

/// Derivative of a residual by the unknowns of the sensor, a column each.
pub(super) type ByUnknowns = SMatrix<f64, 2, UNKNOWNS>;

impl Calibration {
    /// Information about the unknowns before anything is seen.
    pub fn prior(&self) -> [f64; UNKNOWNS] {
        // What is known is coupled with nothing, and any number does.
        self.sigma.map(|sigma| if sigma > 0.0 { 1.0 / (sigma * sigma) } else { 1.0 })
    }

    /// The sensor as it stands, with how well its readout time is known, where that was an unknown.
    pub fn solved(&self) -> Sensor {
        let [columns, rows] = self.sensor.readout;
        let (unknown, time) = if columns != 0.0 { (1, columns) } else { (2, rows) };
        if self.sigma[unknown] == 0.0 {
            return self.sensor;
        }
        let readout_deviation = self.variance[unknown].sqrt().hypot(UNMODELLED * time);
        Sensor { readout_deviation, ..self.sensor }
    }

    /// What the unknowns cost: they are a priori zero.
    pub fn prior_cost(&self) -> f64 {
        let free = self.sensor.unknowns().into_iter().zip(&self.sigma).filter(|(_, sigma)| **sigma > 0.0);
        free.map(|(value, sigma)| (value / sigma).powi(2)).sum()
    }

    /// Derivatives by the unknowns of where an ideal camera in its host's place sees a point, pixels.
    pub fn host_by_unknowns(&self, point: usize) -> [Vector2<f64>; UNKNOWNS] {
        self.hosts[point].by_unknowns(&self.sensor)
    }

    /// Derivative by the unknowns of an observation's residual, brought back to pixels of the image: a lens that makes the
    /// image smaller does not make its errors smaller. `host` is [what its point's host says](Self::host_by_unknowns).
    pub fn by_unknowns(
        &self,
        problem: &Problem,
        relative: &Relative,
        (point, host): (&WindowPoint, &[Vector2<f64>; UNKNOWNS]),
        observation: usize,
        residual: &[f64; 2],
    ) -> ByUnknowns {
        let camera = &problem.camera;
        let x = relative.transform(&point.ray, point.inverse_depth);
        let iz = 1.0 / x.z;
        let (px, py) = (x.x * iz, x.y * iz);
        let distorted = &self.seen[observation].0;
        let seen = distorted.by_unknowns(&self.sensor);
        let [by_radial] = self.sensor.lens.magnification_by_terms(distorted.still(&self.sensor));
        // By the readout times it changes by next to nothing.
        let magnification = [by_radial, Matrix2::zeros(), Matrix2::zeros()];
        let residual = Vector2::from(*residual);
        let columns: [Vector2<f64>; UNKNOWNS] = std::array::from_fn(|k| {
            let ray = relative.rotation.column(0) * (host[k].x / camera.fx)
                + relative.rotation.column(1) * (host[k].y / camera.fy);
            let predicted =
                Vector2::new(camera.fx * iz * (ray.x - px * ray.z), camera.fy * iz * (ray.y - py * ray.z));
            // What is known stays as it is, to the last bit.
            let is_free = f64::from(u8::from(self.sigma[k] > 0.0));
            (predicted - seen[k] - magnification[k] * residual) * is_free
        });
        ByUnknowns::from_columns(&columns)
    }
}

impl Problem {
    /// Derives rays, pixels and information from a sensor with these values; nothing without a calibration.
    pub fn set_sensor(&mut self, unknowns: [f64; UNKNOWNS]) {
        let Some(calibration) = &mut self.calibration else { return };
        calibration.sensor = calibration.sensor.with(unknowns);
        let sensor = &calibration.sensor;
        for (point, distorted) in self.points.iter_mut().zip(&calibration.hosts) {
            point.ray = sensor.lens.ray(distorted.still(sensor));
        }
        for (observation, (distorted, [a, b, c])) in self.observations.iter_mut().zip(&calibration.seen) {
            let (distorted, [a, b, c]) = (distorted.still(sensor), [*a, *b, *c]);
            observation.pixel = sensor.lens.undistort(distorted);
            let Some(back) = sensor.lens.magnification(distorted).try_inverse() else { continue };
            let information = back.transpose() * Matrix2::new(a, b, b, c) * back;
            observation.information = [information[(0, 0)], information[(0, 1)], information[(1, 1)]];
        }
    }
}
