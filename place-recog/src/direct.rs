//! The direct index: which features of an image lie under which node of the vocabulary's tree (Gálvez-López & Tardós,
//! "Bags of Binary Words for Fast Place Recognition in Image Sequences", T-RO 2012, §V).
//!
//! Two images' features are compared only where they share a node, which takes a hundredth of comparing all with all
//! and finds a good part of the matches. That ranks proposals better than the words alone: they count how much of two
//! images is of the same kind, this counts what is the same. Measured where two maps of a car park share 1.7 m in
//! opposite directions, the best place is 25th and 30th by words, and first in both by the features they share.

use crate::features::{Features, squared_distance};
use crate::{FeatureWords, KeyframeFeatures, Proposal, Vocabulary, WordBag, WordId};
use geometry::{Buffer, Swap};
use map::KeyframeId;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::sync::Arc;

/// How proposals are ranked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RankParams {
    /// How many proposals are ranked anew, the others stay behind them. Default 96; 0 for none. More find places that
    /// the words rank low, at 0.2 ms each.
    pub considered: usize,
    /// Largest ratio of the distances to the nearest and the second nearest feature under a node, not squared. Default
    /// 0.8; 0 to 1.
    pub max_ratio: f32,
    /// Largest distance of two descriptors of one thing; all have a length of about 256. Default 90; above 0. Many nodes
    /// have but one feature of an image, whose nearest has no second to be compared with.
    pub max_distance: f32,
}

impl Default for RankParams {
    fn default() -> Self {
        Self { considered: 96, max_ratio: 0.8, max_distance: 90.0 }
    }
}

/// The features of an image in order of their nodes: node and index of the feature.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DirectIndex(Buffer<Entry>);

/// A node and the index of a feature under it.
type Entry = [u32; 2];

impl DirectIndex {
    /// Sorts the features of an image, whose words these are, under the nodes of the vocabulary.
    pub fn new(words: &FeatureWords, vocabulary: &Vocabulary) -> Self {
        let node = |(&word, i): (&WordId, u32)| [vocabulary.node(word), i];
        let mut entries: Vec<Entry> = words.words().iter().zip(0..).map(node).collect();
        entries.sort_unstable();
        Self(entries.into())
    }

    /// The same for features that are looked up now, with the words of the image.
    pub fn with_words(features: &Features, vocabulary: &Vocabulary) -> (Self, WordBag) {
        let words = FeatureWords::of(features, vocabulary);
        (Self::new(&words, vocabulary), words.bag())
    }

    /// Keeps it where `swap` has room for it, and gives back its memory until it is looked at again.
    pub fn swap_out(&mut self, swap: &dyn Swap) {
        if let Some(kept) = self.0.swapped_out(swap) {
            self.0 = kept;
            self.rest();
        }
    }

    /// Gives back its memory, if it is swapped out, until it is looked at again.
    pub fn rest(&self) {
        self.0.rest();
    }

    fn by_node(&self) -> Vec<&[Entry]> {
        self.0.chunk_by(|a, b| a[0] == b[0]).collect()
    }
}

/// Words and direct index of every keyframe.
pub fn words(
    of_features: &BTreeMap<KeyframeId, FeatureWords>,
    vocabulary: &Vocabulary,
) -> (BTreeMap<KeyframeId, WordBag>, BTreeMap<KeyframeId, DirectIndex>) {
    let sorted = |(&id, words): (&KeyframeId, &FeatureWords)| {
        ((id, words.bag()), (id, DirectIndex::new(words, vocabulary)))
    };
    of_features.par_iter().map(sorted).collect::<Vec<_>>().into_iter().unzip()
}

/// Keyframes of a map as the direct index needs them.
#[derive(Clone, Copy)]
pub struct Directed<'a> {
    /// Their features.
    pub features: &'a KeyframeFeatures,
    /// Made of their features; one of others finds nothing.
    pub index: &'a BTreeMap<KeyframeId, DirectIndex>,
}

impl<'a> Directed<'a> {
    fn get(&self, id: KeyframeId) -> Option<(&'a DirectIndex, Arc<Features>)> {
        let (index, features) = (self.index.get(&id)?, self.features.get(id)?);
        // Words and features may come from a file that says something else of each.
        (index.0.len() == features.len()).then_some((index, features))
    }
}

/// Counts how many features the keyframes of the first proposals share, and puts those in order, most first; of equals
/// the one proposed first.
pub fn ranked(
    mut proposals: Vec<Proposal>,
    map: Directed,
    queries: Directed,
    params: &RankParams,
) -> Vec<Proposal> {
    let considered = params.considered.min(proposals.len());
    let count = |proposal: &Proposal| {
        let pair = (map.get(proposal.keyframe), queries.get(proposal.query));
        let (Some((map, of_map)), Some((query, of_query))) = pair else { return 0 };
        shared_features((map, &of_map), (query, &of_query), params)
    };
    let first = &mut proposals[..considered];
    first.par_iter_mut().for_each(|proposal| proposal.shared = Some(count(proposal)));
    // Stable, so that the better proposal stays first.
    first.sort_by_key(|proposal| std::cmp::Reverse(proposal.shared));
    proposals
}

/// How many features of two images are each other's nearest under a node they share, and clearly nearer than the second
/// nearest.
pub fn shared_features(
    (a, of_a): (&DirectIndex, &Features),
    (b, of_b): (&DirectIndex, &Features),
    params: &RankParams,
) -> usize {
    let (a, b) = (a.by_node(), b.by_node());
    let (mut i, mut j, mut shared) = (0, 0, 0);
    while i < a.len() && j < b.len() {
        let order = a[i][0][0].cmp(&b[j][0][0]);
        if order == Ordering::Equal {
            shared += shared_under_node((a[i], of_a), (b[j], of_b), params);
        }
        i += usize::from(order != Ordering::Greater);
        j += usize::from(order != Ordering::Less);
    }
    shared
}

fn shared_under_node(
    (a, of_a): (&[Entry], &Features),
    (b, of_b): (&[Entry], &Features),
    params: &RankParams,
) -> usize {
    let distance = |&[_, i]: &Entry, &[_, j]: &Entry| {
        squared_distance(&of_a.descriptors[i as usize], &of_b.descriptors[j as usize])
    };
    let distances: Vec<Vec<u32>> = a.iter().map(|x| b.iter().map(|y| distance(x, y)).collect()).collect();
    let nearest_to = |i: usize| clear_minimum(distances[i].iter().copied(), params);
    let nearest_back = |j: usize| clear_minimum(distances.iter().map(|row| row[j]), params);
    (0..a.len()).filter(|&i| nearest_to(i).is_some_and(|j| nearest_back(j) == Some(i))).count()
}

/// Where the smallest squared distance is, if it is small enough and clearly smaller than the next.
fn clear_minimum(distances: impl Iterator<Item = u32>, params: &RankParams) -> Option<usize> {
    let (mut at, mut first, mut second) = (0, u32::MAX, u32::MAX);
    for (i, distance) in distances.enumerate() {
        if distance < first {
            (at, first, second) = (i, distance, first);
        } else {
            second = second.min(distance);
        }
    }
    let near = first as f32 <= params.max_distance.powi(2);
    // Of equals neither is.
    let clearer = first < second && first as f32 <= params.max_ratio.powi(2) * second as f32;
    let clear = second == u32::MAX || clearer;
    (near && clear).then_some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three groups of features that fall under nodes of their own, from random descriptors.
    fn image(seed: u64, count: usize) -> Features {
        // Bytes of the size that RootSIFT descriptors have.
        let mut random = geometry::Random::new(seed);
        let mut byte = move || random.below(32) as u8;
        let keypoint = crate::features::Keypoint { pixel: [0.0; 2], size: 1.0, angle: 0.0 };
        Features {
            keypoints: vec![keypoint; count],
            descriptors: (0..count).map(|_| std::array::from_fn(|_| byte())).collect(),
        }
    }

    /// Another view of an image: every descriptor a little off, in another order.
    fn another_view(image: &Features) -> Features {
        let mut other = image.clone();
        other.descriptors.reverse();
        for (i, descriptor) in other.descriptors.iter_mut().enumerate() {
            descriptor[i % 128] = descriptor[i % 128].wrapping_add(3);
        }
        other
    }

    fn count(a: &Features, b: &Features) -> usize {
        let vocabulary = Vocabulary::shipped();
        let of = |features: &Features| DirectIndex::with_words(features, &vocabulary).0;
        shared_features((&of(a), a), (&of(b), b), &RankParams::default())
    }

    #[test]
    fn features_are_shared_with_another_view_and_not_with_another_image() {
        let (one, two) = (image(1, 300), image(2, 300));
        let same = count(&one, &another_view(&one));
        assert!((250..=300).contains(&same), "{same}");
        assert!(count(&one, &two) < 30, "{}", count(&one, &two));
        assert_eq!(count(&one, &Features::default()), 0);
    }

    #[test]
    fn equal_features_are_not_clear() {
        let mut twice = image(3, 50);
        twice.descriptors.extend(twice.descriptors.clone());
        twice.keypoints.extend(twice.keypoints.clone());
        assert_eq!(count(&twice, &twice), 0);
    }

    #[test]
    fn what_shares_most_comes_first_and_what_is_not_considered_stays() {
        let images: Vec<Features> = (0..4).map(|seed| image(seed, 100)).collect();
        let queries: KeyframeFeatures =
            (0..4).map(|i| (KeyframeId(i), another_view(&images[i as usize]))).collect();
        let map: KeyframeFeatures = (0..4).map(|i| (KeyframeId(i), images[i as usize].clone())).collect();
        let vocabulary = Vocabulary::shipped();
        let index = |all: &KeyframeFeatures| -> BTreeMap<_, _> {
            let index = |id| (id, DirectIndex::with_words(&all.get(id).unwrap(), &vocabulary).0);
            all.keyframes().map(index).collect()
        };
        let (of_map, of_queries) = (index(&map), index(&queries));
        let proposals: Vec<Proposal> = [(0, 1), (1, 2), (2, 2), (3, 9), (3, 3)]
            .map(|(map, query)| Proposal {
                keyframe: KeyframeId(map),
                query: KeyframeId(query),
                score: 0.5,
                shared: None,
            })
            .to_vec();
        let rank = |considered| {
            ranked(
                proposals.clone(),
                Directed { features: &map, index: &of_map },
                Directed { features: &queries, index: &of_queries },
                &RankParams { considered, ..RankParams::default() },
            )
        };
        // Whether they are the same pairs, whatever was counted of them.
        let pair = |p: &Proposal| (p.keyframe, p.query);
        let rank = |considered| rank(considered).iter().map(pair).collect::<Vec<_>>();
        let proposals: Vec<_> = proposals.iter().map(pair).collect();
        let all = rank(96);
        assert!(all[..2].contains(&proposals[2]) && all[..2].contains(&proposals[4]), "{all:?}");
        assert_eq!(all[2..], [proposals[0], proposals[1], proposals[3]]);
        assert_eq!(rank(4)[4], proposals[4]);
        assert_eq!(rank(4)[0], proposals[2]);
        assert_eq!(rank(0), proposals);
    }
}
