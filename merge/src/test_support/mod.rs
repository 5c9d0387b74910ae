//! Numbers and scenes for the tests of this crate.

pub(crate) mod point_scene;

use geometry::Random;
use nalgebra::{UnitQuaternion, Vector3};

/// Random numbers, vectors and rotations.
pub(crate) struct Numbers(Random);

impl Numbers {
    /// A series; another seed gives another one.
    pub(crate) fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    /// The next number of a uniform distribution over [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }

    /// The next number of a standard normal distribution.
    pub(crate) fn normal(&mut self) -> f64 {
        self.0.normal()
    }

    /// A vector with entries in [−size, size).
    pub(crate) fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.uniform(-size, size))
    }

    /// A rotation by at most `size`·√3 rad.
    pub(crate) fn rotation(&mut self, size: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(self.vector(size))
    }
}
