//! k-means of descriptors: seeded by k-means++ (Arthur & Vassilvitskii 2007), refined by Lloyd's iteration.
//! All sums are of integers, so the result does not depend on how the work was divided.

use crate::features::{Descriptor, squared_distance};
use geometry::Random;
use rayon::prelude::*;

/// Descriptors that one task handles.
const CHUNK: usize = 2048;

/// Divides descriptors into at most `count` clusters: their centres, each with at least one member, and each
/// descriptor's cluster. Fewer clusters come out where fewer descriptors differ.
pub fn cluster(
    descriptors: &[Descriptor],
    count: usize,
    iterations: usize,
    random: &mut Random,
) -> (Vec<Descriptor>, Vec<u8>) {
    let mut centres = seeds(descriptors, count, random);
    let mut members = assign(descriptors, &centres);
    for _ in 0..iterations {
        centres = means(descriptors, &members, centres.len());
        let next = assign(descriptors, &centres);
        if next == members {
            break;
        }
        members = next;
    }
    without_empty(&centres, members)
}

/// The nearest of `centres`; of equally near ones the first.
#[inline]
pub fn nearest(descriptor: &Descriptor, centres: &[Descriptor]) -> usize {
    let mut best = (u32::MAX, 0);
    for (i, centre) in centres.iter().enumerate() {
        let distance = squared_distance(descriptor, centre);
        if distance < best.0 {
            best = (distance, i);
        }
    }
    best.1
}

/// Descriptors far from each other: each next one drawn with probability in proportion to its squared distance
/// from those before.
fn seeds(descriptors: &[Descriptor], count: usize, random: &mut Random) -> Vec<Descriptor> {
    let Some(first) = descriptors.get(random.below(descriptors.len() as u64) as usize) else {
        return Vec::new();
    };
    let mut centres = vec![*first];
    let mut distances = vec![u32::MAX; descriptors.len()];
    while centres.len() < count {
        let last = centres[centres.len() - 1];
        distances.par_iter_mut().zip(descriptors).with_min_len(CHUNK).for_each(|(distance, descriptor)| {
            *distance = (*distance).min(squared_distance(descriptor, &last))
        });
        let total: u64 = distances.iter().map(|&d| u64::from(d)).sum();
        if total == 0 {
            break;
        }
        let mut left = random.below(total);
        let drawn = distances.iter().position(|&d| {
            let here = left < u64::from(d);
            left = left.saturating_sub(u64::from(d));
            here
        });
        let Some(drawn) = drawn else { break };
        centres.push(descriptors[drawn]);
    }
    centres
}

fn assign(descriptors: &[Descriptor], centres: &[Descriptor]) -> Vec<u8> {
    descriptors.par_iter().with_min_len(CHUNK).map(|d| nearest(d, centres) as u8).collect()
}

/// The rounded mean of each cluster; zero for one without members.
fn means(descriptors: &[Descriptor], members: &[u8], count: usize) -> Vec<Descriptor> {
    let empty = || vec![([0u64; 128], 0u64); count];
    let add = |mut sums: Vec<([u64; 128], u64)>, (descriptor, &member): (&Descriptor, &u8)| {
        let (sum, number) = &mut sums[usize::from(member)];
        for (s, &v) in sum.iter_mut().zip(descriptor) {
            *s += u64::from(v);
        }
        *number += 1;
        sums
    };
    let join = |mut a: Vec<([u64; 128], u64)>, b: Vec<([u64; 128], u64)>| {
        for ((sum, number), (other, more)) in a.iter_mut().zip(b) {
            for (s, v) in sum.iter_mut().zip(other) {
                *s += v;
            }
            *number += more;
        }
        a
    };
    let sums = descriptors.par_iter().zip(members).with_min_len(CHUNK).fold(empty, add).reduce(empty, join);
    let mean = |(sum, number): ([u64; 128], u64)| sum.map(|s| ((s + number / 2) / number.max(1)) as u8);
    sums.into_iter().map(mean).collect()
}

fn without_empty(centres: &[Descriptor], mut members: Vec<u8>) -> (Vec<Descriptor>, Vec<u8>) {
    let mut used = vec![false; centres.len()];
    members.iter().for_each(|&m| used[usize::from(m)] = true);
    let mut renamed = vec![0u8; centres.len()];
    let mut kept = Vec::new();
    for (i, centre) in centres.iter().enumerate().filter(|&(i, _)| used[i]) {
        renamed[i] = kept.len() as u8;
        kept.push(*centre);
    }
    members.iter_mut().for_each(|m| *m = renamed[usize::from(*m)]);
    (kept, members)
}
