//! Numbers and scenes for the tests of this crate.

pub(crate) mod point_scene;

use nalgebra::{UnitQuaternion, Vector3};

/// Numbers that look random and are always the same: xorshift.
pub(crate) struct Numbers(u64);

impl Numbers {
    /// A series; another seed gives another one.
    pub(crate) fn new(seed: u64) -> Self {
        let mut numbers = Self((seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        // The first few still show the seed.
        for _ in 0..8 {
            numbers.uniform(0.0, 1.0);
        }
        numbers
    }

    /// The next number of a uniform distribution over [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        low + (high - low) * ((self.0 >> 11) as f64 / (1u64 << 53) as f64)
    }

    /// The next number of a standard normal distribution (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(0.0, 1.0)).ln()).sqrt();
        radius * self.uniform(0.0, std::f64::consts::TAU).cos()
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
