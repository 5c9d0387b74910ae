//! Random samples that are the same each time, for RANSAC.

use crate::Random;

/// Samples that are drawn for each that should suffice: one free of outliers may still be poor, by noise, and the others
/// pay for a second and third.
const SPARE: f64 = 3.0;

/// How many samples of `size` must be drawn so that with this `confidence` a good one is free of outliers, when a share of
/// all are inliers (Fischler & Bolles 1981); infinite for none.
pub fn samples_needed(inlier_share: f64, size: i32, confidence: f64) -> f64 {
    SPARE * ((1.0 - confidence).ln() / (-inlier_share.powi(size)).ln_1p())
}

/// Draws samples; the same seed draws the same ones.
#[derive(Clone, Debug)]
pub struct Sampler(Random);

impl Sampler {
    /// A series of its own for each seed.
    pub fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    /// A number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.index(count)
    }

    /// `N` different numbers below `count`, which must be at least `N`.
    pub fn sample<const N: usize>(&mut self, count: usize) -> [usize; N] {
        let mut sample = [usize::MAX; N];
        for i in 0..N {
            sample[i] = loop {
                let candidate = self.below(count);
                if !sample[..i].contains(&candidate) {
                    break candidate;
                }
            };
        }
        sample
    }
}
