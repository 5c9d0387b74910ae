//! Random samples that are the same each time, for RANSAC.

/// Samples that are drawn for each that should suffice: one free of outliers may still be poor, by noise, and the others
/// pay for a second and third.
const SPARE: f64 = 3.0;

/// How many samples of `size` RANSAC draws so that, with this `confidence`, at least one is free of outliers
/// (Fischler & Bolles 1981). `inlier_share` is the share of inliers among all; without any the number is infinite.
pub fn samples_needed(inlier_share: f64, size: i32, confidence: f64) -> f64 {
    SPARE * ((1.0 - confidence).ln() / (-inlier_share.powi(size)).ln_1p())
}

/// Draws samples; the same seed draws the same ones (xorshift64*).
#[derive(Clone, Debug)]
pub struct Sampler(u64);

impl Sampler {
    /// A series of its own for each seed.
    pub fn new(seed: u64) -> Self {
        // No state but zero is forbidden; the multiplication spreads small seeds.
        Self(seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// A number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let high = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32;
        ((high * count as u64) >> 32) as usize
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
