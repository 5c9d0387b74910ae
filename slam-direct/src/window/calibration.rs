//! The sensor as unknowns of the joint optimisation: its lens, and how long it takes to be read.

use geometry::sensor::{Sensor, UNKNOWNS};
use nalgebra::Vector2;

/// What readout times err by besides, as a share of themselves: a camera that turns and shakes does not move evenly from frame to
/// frame, as is assumed. Three quarters of the hand-held recordings that the example `nees` renders err by less.
const UNMODELLED: f64 = 0.03;

/// Share of its cost that a solution keeps, at most, if a camera that is read otherwise explains much more. Of 207 starts of
/// recordings that expose all rows at once it is at least 0.98, of hand-held ones with a rolling shutter down to 0.77.
pub(crate) const OTHER_SHUTTER: f64 = 0.95;

/// A problem's sensor and what the images show; [`Problem::set_sensor`](super::Problem::set_sensor) derives rays and pixels from it.
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
    pub(super) fn still(&self, sensor: &Sensor) -> [f64; 2] {
        (Vector2::from(self.pixel) - self.velocity * sensor.delay(self.pixel)).into()
    }

    /// Derivatives by the unknowns of where an ideal camera sees it, pixels.
    pub(super) fn by_unknowns(&self, sensor: &Sensor) -> [Vector2<f64>; UNKNOWNS] {
        let still = self.still(sensor);
        let [radial] = sensor.lens.by_terms(still);
        let moved = -(sensor.lens.magnification(still) * self.velocity);
        let [columns, rows] = sensor.order(self.pixel).map(|order| moved * order);
        [radial, columns, rows]
    }
}

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
}
