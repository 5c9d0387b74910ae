//! Matching the features of two keyframes: mutual nearest neighbours with ratio test (Loop-box, §IV-C1).
//!
//! Every descriptor is compared with every other. The squared distance is `|a|² + |b|² − 2 a·b`: the lengths are
//! known beforehand, which leaves a product of matrices. It is taken in `f32`, where it is exact: a sum of 128
//! products of bytes stays below 2²⁴, whatever the order of its terms.

#[cfg(test)]
mod tests;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
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

/// Source descriptors compared at a time, so that their distances stay in cache.
const BLOCK: usize = 64;

/// Numbers in a descriptor.
const DIMENSIONS: usize = size_of::<Descriptor>();

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
    let (of_targets, target_norms) = columns(target);
    let mut of_source = vec![Nearest::NONE; source.len()];
    let mut of_target = vec![Nearest::NONE; target.len()];
    let mut dots = Mat::zeros(target.len(), BLOCK);
    for (block, descriptors) in source.chunks(BLOCK).enumerate() {
        let (of_sources, source_norms) = columns(descriptors);
        let mut dots = dots.subcols_mut(0, descriptors.len());
        matmul(&mut dots, Accum::Replace, of_targets.transpose(), &of_sources, 1.0f32, Par::Seq);
        for (column, source_norm) in source_norms.iter().enumerate() {
            let i = block * BLOCK + column;
            let others = dots.as_ref().col(column);
            for (j, (dot, target_norm)) in others.iter().zip(&target_norms).enumerate() {
                let distance = (source_norm + target_norm - 2.0 * dot) as u32;
                of_source[i].offer(j as u32, distance);
                of_target[j].offer(i as u32, distance);
            }
        }
    }
    (of_source, of_target)
}

/// Descriptors as the columns of a matrix, and the square of each one's length.
fn columns(descriptors: &[Descriptor]) -> (Mat<f32>, Vec<f32>) {
    let matrix =
        Mat::from_fn(DIMENSIONS, descriptors.len(), |row, column| f32::from(descriptors[column][row]));
    let norm = |d: &Descriptor| d.iter().map(|&v| f32::from(v) * f32::from(v)).sum();
    (matrix, descriptors.iter().map(norm).collect())
}
