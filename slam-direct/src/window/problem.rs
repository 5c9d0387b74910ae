//! The joint optimisation as values: poses, points, observations.

use super::calibration::Calibration;
use geometry::sensor::UNKNOWNS;
use geometry::{Pinhole, Se3};
use nalgebra::{Matrix2, Vector3};
use std::ops::Range;

/// A point on a host frame's ray.
#[derive(Clone, Debug)]
pub(crate) struct WindowPoint {
    /// Index of the host in `Problem::frames`.
    pub host: usize,
    /// Ray through the host pixel, z = 1.
    pub ray: Vector3<f64>,
    /// Inverse depth along it, 1/map unit.
    pub inverse_depth: f64,
    /// Its observations in `Problem::observations`.
    pub observations: Range<usize>,
    /// Information of the inverse depth at the solution given the poses; set by the solver.
    pub information: f64,
}

/// Where a frame sees a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindowObservation {
    /// Index of the observing frame in `Problem::frames`.
    pub frame: usize,
    /// Measured pixel.
    pub pixel: [f64; 2],
    /// Its information `[xx, xy, yy]`, 1/px².
    pub information: [f64; 3],
}

/// Poses, points and observations to be made consistent.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    /// The camera of all frames.
    pub camera: Pinhole,
    /// `camera_from_world` of each frame.
    pub frames: Vec<Se3>,
    /// Frames that must not move.
    pub fixed: Vec<bool>,
    /// The points; observations of one point are contiguous.
    pub points: Vec<WindowPoint>,
    /// All observations.
    pub observations: Vec<WindowObservation>,
    /// The lens, where it is solved for too; rays, pixels and information above are as it stands.
    pub calibration: Option<Calibration>,
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
