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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FeatureMatch {
    /// Index among the source's features.
    pub source: u32,
    /// Index among the target's features.
    pub target: u32,
    /// Squared Euclidean distance of the descriptors.
    pub squared_distance: u32,
}

/// The nearest and second nearest of the other side.
#[derive(Clone, Copy)]
struct Nearest {
    index: u32,
    first: f32,
    second: f32,
}

impl Nearest {
    const NONE: Self = Self { index: u32::MAX, first: f32::INFINITY, second: f32::INFINITY };

    /// Of the candidates of both. Of equals the earlier one.
    fn or(self, other: Self) -> Self {
        let (near, far) =
            if (other.first, other.index) < (self.first, self.index) { (other, self) } else { (self, other) };
        Self { second: near.second.min(far.first), ..near }
    }

    /// Whether the nearest is clearly nearer than the second. Equals never are, and one alone is.
    fn is_distinct(&self, squared_ratio: f64) -> bool {
        let clear = self.first < self.second || squared_ratio >= 1.0;
        clear
            && (self.second == f32::INFINITY
                || f64::from(self.first) <= squared_ratio * f64::from(self.second))
    }
}

/// The nearest of each of many, number by number, so that several are compared at a time.
struct NearestOfEach {
    index: Vec<u32>,
    first: Vec<f32>,
    second: Vec<f32>,
}

impl NearestOfEach {
    fn new(count: usize) -> Self {
        let Nearest { index, first, second } = Nearest::NONE;
        Self { index: vec![index; count], first: vec![first; count], second: vec![second; count] }
    }

    fn get(&self, i: usize) -> Option<Nearest> {
        let (index, first, second) = (*self.index.get(i)?, *self.first.get(i)?, *self.second.get(i)?);
        Some(Nearest { index, first, second })
    }
}

/// Offers each of `distances` to those who stand at its place, candidate `index(place)`. Of equals the one that was there stays.
#[inline(always)]
fn offer(
    distances: &[f32],
    candidate: impl Fn(usize) -> u32,
    indices: &mut [u32],
    firsts: &mut [f32],
    seconds: &mut [f32],
) {
    let places = distances.iter().zip(indices).zip(firsts).zip(seconds).enumerate();
    for (place, (((&distance, index), first), second)) in places {
        let nearer = distance < *first;
        *second = if nearer { *first } else { second.min(distance) };
        *first = if nearer { distance } else { *first };
        *index = if nearer { candidate(place) } else { *index };
    }
}

/// Targets compared at a time.
const LANES: usize = 16;

geometry::multiversion! {
    /// The nearest target of a source, by the products of their descriptors and the squares of their lengths; and the source
    /// offered to each of the targets.
    fn nearest_of(
        dots: &[f32],
        target_norms: &[f32],
        source: u32,
        source_norm: f32,
        of_targets: &mut NearestOfEach,
    ) -> Nearest {
        let NearestOfEach { index, first, second } = of_targets;
        let Nearest { index: none, first: far, .. } = Nearest::NONE;
        let (mut indices, mut firsts, mut seconds) = ([none; LANES], [far; LANES], [far; LANES]);
        let dots = dots.chunks(LANES).zip(target_norms.chunks(LANES));
        let of_targets = index.chunks_mut(LANES).zip(first.chunks_mut(LANES)).zip(second.chunks_mut(LANES));
        for (block, ((dots, norms), ((index, first), second))) in dots.zip(of_targets).enumerate() {
            // Those beyond the last target are farther than all.
            let mut distances = [far; LANES];
            for ((distance, dot), norm) in distances.iter_mut().zip(dots).zip(norms) {
                *distance = source_norm + norm - 2.0 * dot;
            }
            offer(&distances, |place| (block * LANES + place) as u32, &mut indices, &mut firsts, &mut seconds);
            offer(&distances, |_| source, index, first, second);
        }
        let lane = |k: usize| Nearest { index: indices[k], first: firsts[k], second: seconds[k] };
        (0..LANES).map(lane).fold(Nearest::NONE, Nearest::or)
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
            matches.push(FeatureMatch { source, target, squared_distance: near.first as u32 });
        }
    }
    matches
}

/// The nearest of the other side for each descriptor of both sides, from one pass over all pairs.
fn nearest(source: &[Descriptor], target: &[Descriptor]) -> (Vec<Nearest>, NearestOfEach) {
    let (of_targets, target_norms) = columns(target);
    let mut of_source = Vec::with_capacity(source.len());
    let mut of_target = NearestOfEach::new(target.len());
    let mut dots = Mat::zeros(target.len(), BLOCK);
    for descriptors in source.chunks(BLOCK) {
        let (of_sources, source_norms) = columns(descriptors);
        let mut dots = dots.subcols_mut(0, descriptors.len());
        matmul(&mut dots, Accum::Replace, of_targets.transpose(), &of_sources, 1.0f32, Par::Seq);
        for (column, &source_norm) in source_norms.iter().enumerate() {
            let others = dots.as_ref().col(column);
            let Some(others) = others.try_as_col_major() else { continue };
            let i = of_source.len() as u32;
            of_source.push(nearest_of(others.as_slice(), &target_norms, i, source_norm, &mut of_target));
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
