//! Random numbers that are the same each time.

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// SplitMix64 (Steele, Lea, Flood, OOPSLA 2014). The same seed gives the same numbers everywhere;
/// they are no secrets.
#[derive(Clone, Debug)]
pub struct Random(SplitMix64);

impl Random {
    /// A series of its own for each seed.
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in `0..end`; 0 when `end` is 0.
    pub fn below(&mut self, end: u64) -> u64 {
        ((u128::from(self.bits()) * u128::from(end)) >> 64) as u64
    }

    /// A place in a list of `length`, which must not be 0.
    pub fn index(&mut self, length: usize) -> usize {
        self.below(length as u64) as usize
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `[low, high)`.
    pub fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * (self.bits() >> 40) as f32 / (1u32 << 24) as f32
    }

    /// A normally distributed number of mean 0 and variance 1 (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_is_that_of_the_publication() {
        // The first outputs of the reference implementation for seed 1234567.
        let mut random = Random::new(1_234_567);
        assert_eq!(
            [(); 3].map(|()| random.bits()),
            [6457827717110365317, 3203168211198807973, 9817491932198370423]
        );
    }

    #[test]
    fn numbers_are_spread_and_repeat() {
        let draw = |seed| -> Vec<usize> {
            let mut random = Random::new(seed);
            (0..1000).map(|_| random.index(10)).collect()
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
        for digit in 0..10 {
            let count = draw(3).into_iter().filter(|&d| d == digit).count();
            assert!((60..140).contains(&count), "{digit}: {count}");
        }
        assert_eq!(Random::new(1).below(0), 0);
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(4);
        let mut mean = |draw: &mut dyn FnMut(&mut Random) -> f64| {
            (0..10_000).map(|_| draw(&mut random)).sum::<f64>() / 1e4
        };
        assert!((mean(&mut Random::unit) - 0.5).abs() < 0.01);
        assert!((mean(&mut |random| random.uniform(-1.0, 3.0).into()) - 1.0).abs() < 0.04);
        assert!(mean(&mut Random::normal).abs() < 0.03);
        assert!((mean(&mut |random| random.normal().powi(2)) - 1.0).abs() < 0.05);
    }
}
