//! Scan Context (Eq. 5–10): a scan seen from above, told apart by the heights in its rings and sectors.
//!
//! As the paper has it, with what it leaves open settled: heights count from the lowest points, so that they are
//! positive and an empty bin differs from a low one; columns that are empty in either scan are left out of the mean
//! of Eq. 6, where they would be 0/0; the ring key is the share of occupied bins (Eq. 9).

use std::f32::consts::TAU;

/// Rings, outwards.
pub const RINGS: usize = 20;
/// Sectors.
pub const SECTORS: usize = 60;

/// The descriptor of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanContext {
    /// Largest height of each bin, sector by sector; 0 where there is no point.
    columns: Vec<[f32; RINGS]>,
    norms: Vec<f32>,
    key: [f32; RINGS],
}

/// How similar two scans are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Distance (Eq. 7), 0 for the same scan, at most 1.
    pub distance: f32,
    /// Yaw of the second scan's sensor in the first's frame (Eq. 8), radians.
    pub yaw: f32,
}

impl ScanContext {
    /// Describes points in the sensor's frame out to `radius` metres: the matrix of Eq. 5 and the ring key K of Eq. 9.
    pub fn of(points: &[[f32; 3]], radius: f32) -> Self {
        let floor = lowest(points);
        let mut columns = vec![[0.0f32; RINGS]; SECTORS];
        for p in points {
            let range = p[0].hypot(p[1]);
            if range < radius {
                let ring = ((range / radius * RINGS as f32) as usize).min(RINGS - 1);
                let rotation = (p[1].atan2(p[0]) / TAU).rem_euclid(1.0);
                let sector = ((rotation * SECTORS as f32) as usize).min(SECTORS - 1);
                let bin = &mut columns[sector][ring];
                *bin = bin.max(p[2] - floor + LEAST_HEIGHT);
            }
        }
        let norms = columns.iter().map(|c| c.iter().map(|v| v * v).sum::<f32>().sqrt()).collect();
        let mut key = [0.0; RINGS];
        for (ring, share) in key.iter_mut().enumerate() {
            *share = columns.iter().filter(|c| c[ring] > 0.0).count() as f32 / SECTORS as f32;
        }
        Self { columns, norms, key }
    }

    /// Squared distance of the ring keys (Eq. 9), which does not change when the sensor turns. Eq. 10 takes its candidates by it.
    pub fn key_distance(&self, other: &Self) -> f32 {
        self.key.iter().zip(&other.key).map(|(a, b)| (a - b).powi(2)).sum()
    }

    /// Compares two scans under all turns (Eq. 6–8).
    pub fn similarity(&self, other: &Self) -> Similarity {
        self.similarity_within(other, |_| true).unwrap_or(Similarity { distance: 1.0, yaw: 0.0 })
    }

    /// The same under those turns, radians, that `may_be`; `None` where none may.
    pub fn similarity_within(&self, other: &Self, may_be: impl Fn(f32) -> bool) -> Option<Similarity> {
        let turns = (0..SECTORS).map(|shift| (shift, shift as f32 * TAU / SECTORS as f32));
        let compared = turns
            .filter(|(_, yaw)| may_be(*yaw))
            .map(|(shift, yaw)| Similarity { distance: self.distance_turned(other, shift), yaw });
        compared.reduce(|best, next| if next.distance < best.distance { next } else { best })
    }

    /// Eq. 6: the mean cosine distance of columns when the other sensor is turned by `shift` sectors.
    fn distance_turned(&self, other: &Self, shift: usize) -> f32 {
        let (mut sum, mut count) = (0.0, 0);
        for sector in 0..SECTORS {
            let theirs = (sector + SECTORS - shift) % SECTORS;
            let norms = self.norms[sector] * other.norms[theirs];
            if norms > 0.0 {
                let dot: f32 =
                    self.columns[sector].iter().zip(&other.columns[theirs]).map(|(a, b)| a * b).sum();
                sum += 1.0 - dot / norms;
                count += 1;
            }
        }
        if count == 0 { 1.0 } else { sum / count as f32 }
    }
}

/// What the lowest bin is high, metres: the ground differs from nothing.
const LEAST_HEIGHT: f32 = 0.5;

/// Height of the lowest points, a hundredth of them left out as strays.
fn lowest(points: &[[f32; 3]]) -> f32 {
    let mut heights: Vec<f32> = points.iter().map(|p| p[2]).collect();
    let rank = heights.len() / 100;
    if heights.is_empty() { 0.0 } else { *heights.select_nth_unstable_by(rank, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(rotation: f32) -> Vec<[f32; 3]> {
        let point = |i: u32| {
            let (azimuth, range) = (i as f32 * 0.37, 3.0 + (i * i % 31) as f32);
            let height = -1.0 + (i % 7) as f32 * 0.6 * (1.0 + azimuth.sin());
            ((azimuth - rotation).cos() * range, (azimuth - rotation).sin() * range, height).into()
        };
        (0..4000).map(point).collect()
    }

    #[test]
    fn a_rotated_sensor_sees_the_same_place_and_the_yaw_is_estimated() {
        let rotation = 7.0 * TAU / SECTORS as f32;
        let (still, turned) = (ScanContext::of(&scene(0.0), 40.0), ScanContext::of(&scene(rotation), 40.0));
        let similarity = still.similarity(&turned);
        assert!(similarity.distance < 0.05, "{similarity:?}");
        assert!((similarity.yaw - rotation).abs() < 1e-4, "{similarity:?}");
        assert!(still.key_distance(&turned) < 1e-2);
    }

    #[test]
    fn nothing_is_like_nothing() {
        let empty = ScanContext::of(&[], 40.0);
        assert_eq!(empty.similarity(&ScanContext::of(&scene(0.0), 40.0)).distance, 1.0);
    }
}
