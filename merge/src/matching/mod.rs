//! Matching the features of two keyframes: mutual nearest neighbours with ratio test (Loop-box, §IV-C1).
//!
//! Every descriptor is compared with every other. The squared distance is `|a|² + |b|² − 2 a·b`: the lengths are
//! known beforehand, which leaves one dot product of bytes, in a form that compilers turn into vector instructions.

#[cfg(test)]
mod tests;

use place_recog::features::{Descriptor, Features};
use serde::{Deserialize, Serialize};

/// How features are matched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MatchParams {
    /// Largest ratio of the distances to the nearest and the second nearest neighbour, not squared. Default 0.8 (Lowe
    /// 2004); 0 to 1. Higher finds more matches, and more wrong ones. 1 switches the test off.
    pub max_ratio: f32,
}

impl Default for MatchParams {
    fn default() -> Self {
        Self { max_ratio: 0.8 }
    }
}

/// Two features that are each other's nearest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureMatch {
    /// Index among the source's features.
    pub source: u32,
    /// Index among the target's features.
    pub target: u32,
    /// Squared Euclidean distance of the descriptors.
    pub squared_distance: u32,
}

/// The nearest and second nearest so far.
#[derive(Clone, Copy)]
struct Nearest {
    index: u32,
    first: u32,
    second: u32,
}

impl Nearest {
    const NONE: Self = Self { index: u32::MAX, first: u32::MAX, second: u32::MAX };

    /// Of equals the earlier stays.
    #[inline]
    fn offer(&mut self, index: u32, distance: u32) {
        if distance < self.first {
            *self = Self { index, first: distance, second: self.first };
        } else if distance < self.second {
            self.second = distance;
        }
    }

    /// Whether the nearest is clearly nearer than the second. Equals never are, and one alone is.
    fn is_distinct(&self, squared_ratio: f64) -> bool {
        let clear = self.first < self.second || squared_ratio >= 1.0;
        clear && (self.second == u32::MAX || f64::from(self.first) <= squared_ratio * f64::from(self.second))
    }
}

/// Source descriptors compared with one target descriptor in a row, so that it stays in registers and cache.
const BLOCK: usize = 32;

/// Finds the features that are each other's nearest, and clearly nearer than the second nearest on both sides.
///
/// In order of the source's features. Features without descriptors match nothing.
pub fn match_features(source: &Features, target: &Features, params: &MatchParams) -> Vec<FeatureMatch> {
    let (of_source, of_target) = nearest(&source.descriptors, &target.descriptors);
    let squared_ratio = f64::from(params.max_ratio).powi(2);
    let mut matches = Vec::new();
    for (index, near) in of_source.iter().enumerate() {
        let Some(back) = of_target.get(near.index as usize) else {
            continue;
        };
        let mutual = back.index as usize == index;
        if mutual && near.is_distinct(squared_ratio) && back.is_distinct(squared_ratio) {
            let (source, target) = (index as u32, near.index);
            matches.push(FeatureMatch { source, target, squared_distance: near.first });
        }
    }
    matches
}

/// The nearest of the other side for each descriptor of both sides, from one pass over all pairs.
fn nearest(source: &[Descriptor], target: &[Descriptor]) -> (Vec<Nearest>, Vec<Nearest>) {
    let wide = |descriptors: &[Descriptor]| -> Vec<[i16; 128]> {
        descriptors.iter().map(|d| d.map(i16::from)).collect()
    };
    let (wide_source, wide_target) = (wide(source), wide(target));
    let norms = |wide: &[[i16; 128]]| -> Vec<i32> { wide.iter().map(|d| dot(d, d)).collect() };
    let (source_norms, target_norms) = (norms(&wide_source), norms(&wide_target));
    let mut of_source = vec![Nearest::NONE; source.len()];
    let mut of_target = vec![Nearest::NONE; target.len()];
    for start in (0..source.len()).step_by(BLOCK) {
        let end = (start + BLOCK).min(source.len());
        for (j, b) in wide_target.iter().enumerate() {
            for i in start..end {
                let distance = (source_norms[i] + target_norms[j] - 2 * dot(&wide_source[i], b)) as u32;
                of_source[i].offer(j as u32, distance);
                of_target[j].offer(i as u32, distance);
            }
        }
    }
    (of_source, of_target)
}

/// Dot product. At most 128 · 255², so it fits; 16-bit factors with 32-bit sums are one instruction on most machines.
#[inline]
fn dot(a: &[i16; 128], b: &[i16; 128]) -> i32 {
    a.iter().zip(b).map(|(&a, &b)| i32::from(a) * i32::from(b)).sum()
}
