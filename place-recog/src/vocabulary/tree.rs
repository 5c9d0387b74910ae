//! The tree of cluster centres (Nistér & Stewénius, "Scalable Recognition with a Vocabulary Tree", CVPR 2006).

use super::TrainParams;
use super::cluster::{cluster, nearest};
use crate::features::Descriptor;
use geometry::Random;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Cluster centres, breadth first; node 0 is the root, a node's children follow each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    /// Of each node; the root's means nothing.
    pub centres: Vec<Descriptor>,
    /// Of each node; a leaf has none.
    pub child_counts: Vec<u8>,
    /// Of each node its first child, or, of a leaf, its word.
    next: Vec<u32>,
    words: usize,
}

/// A part of the tree while it grows.
struct Branch {
    centre: Descriptor,
    children: Vec<Branch>,
}

impl Tree {
    /// Puts nodes given breadth first in order; `None` when the counts are not those of a tree.
    pub fn new(centres: Vec<Descriptor>, child_counts: Vec<u8>) -> Option<Self> {
        let (next, words) = number(&child_counts)?;
        (centres.len() == child_counts.len()).then_some(Self { centres, child_counts, next, words })
    }

    /// Clusters descriptors level by level.
    pub fn grow(descriptors: Vec<Descriptor>, params: &TrainParams) -> Self {
        let root = branch([0; 128], descriptors, 0, params.seed, params);
        let (mut centres, mut child_counts) = (Vec::new(), Vec::new());
        let mut waiting = VecDeque::from([&root]);
        while let Some(node) = waiting.pop_front() {
            centres.push(node.centre);
            child_counts.push(node.children.len() as u8);
            waiting.extend(&node.children);
        }
        let (next, words) = number(&child_counts).unwrap_or_default();
        Self { centres, child_counts, next, words }
    }

    /// CRC-32 of its shape and centres.
    pub fn checksum(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&self.child_counts);
        hasher.update(self.centres.as_flattened());
        hasher.finalize()
    }

    /// The number of leaves.
    pub fn words(&self) -> usize {
        self.words
    }

    /// The leaf that a descriptor falls into.
    pub fn lookup(&self, descriptor: &Descriptor) -> u32 {
        let mut node = 0;
        loop {
            let (count, next) = (usize::from(self.child_counts[node]), self.next[node]);
            if count == 0 {
                return next;
            }
            let first = next as usize;
            node = first + nearest(descriptor, &self.centres[first..first + count]);
        }
    }

    /// Of each word the node above it so many levels below the root, or its leaf where that is higher.
    pub fn nodes_above(&self, level: usize) -> Vec<u32> {
        let mut nodes = vec![0; self.words];
        // Of each node its depth, and the node above it; a parent comes before its children.
        let mut above = vec![(0usize, 0u32); self.child_counts.len()];
        for (node, (&count, &next)) in self.child_counts.iter().zip(&self.next).enumerate() {
            let (depth, passed) = above[node];
            let passed = if depth <= level { node as u32 } else { passed };
            if count == 0 {
                nodes[next as usize] = passed;
            }
            for child in (next as usize..).take(usize::from(count)) {
                above[child] = (depth + 1, passed);
            }
        }
        nodes
    }
}

/// Of each node its first child or its word, and the number of words; `None` when the counts are not a tree's.
fn number(child_counts: &[u8]) -> Option<(Vec<u32>, usize)> {
    let mut next = Vec::with_capacity(child_counts.len());
    let (mut first_child, mut words) = (1usize, 0usize);
    for (node, &count) in child_counts.iter().enumerate() {
        // A node must be somebody's child before it has its own.
        if node >= first_child {
            return None;
        }
        next.push(if count == 0 { words } else { first_child } as u32);
        first_child += usize::from(count);
        words += usize::from(count == 0);
    }
    (first_child == child_counts.len()).then_some((next, words))
}

fn branch(
    centre: Descriptor,
    members: Vec<Descriptor>,
    level: usize,
    seed: u64,
    params: &TrainParams,
) -> Branch {
    let branching = params.branching.clamp(2, 255);
    if level >= params.levels || members.len() < branching * params.min_per_word.max(1) {
        return Branch { centre, children: Vec::new() };
    }
    let mut random = Random::new(seed);
    let (centres, assigned) = cluster(&members, branching, params.iterations, &mut random);
    if centres.len() < 2 {
        return Branch { centre, children: Vec::new() };
    }
    let mut parts = vec![Vec::new(); centres.len()];
    for (descriptor, part) in members.into_iter().zip(assigned) {
        parts[usize::from(part)].push(descriptor);
    }
    // Each child has a seed of its own, so that the order in which they are grown does not matter.
    let children: Vec<(Descriptor, Vec<Descriptor>, u64)> =
        centres.into_iter().zip(parts).map(|(centre, part)| (centre, part, random.bits())).collect();
    let children =
        children.into_par_iter().map(|(c, part, seed)| branch(c, part, level + 1, seed, params)).collect();
    Branch { centre, children }
}
