//! The visual vocabulary: descriptors become words, an image a bag of words.
//!
//! Words are the leaves of a tree of k-means clusters of RootSIFT descriptors ([`tree`]); with them go what
//! the training images tell of them: how many show a word (its weight), and which words occur together (the
//! Chow–Liu tree of [`crate::FabMap`]).
//!
//! **Why SIFT words.** Measured against binary words (ORB, 1500 an image, k-majority tree) with vocabularies from
//! the same rendered rooms; recall at full precision of the best candidate by bag of words, keyframes of
//! `loopbox run`, features of the whole images (they are found in halved ones now, which costs words a good part of
//! their recall and is made good by [`crate::ranked`]):
//!
//! | keyframes looked for | 10,000 ORB words | 10,000 SIFT words | 28,561 SIFT words |
//! |---|---|---|---|
//! | parking_b in parking_a | 84.6 % | 84.6 % | 84.6 % |
//! | parking_c in parking_a, opposite direction | 70.0 % | 40.0 % | 56.7 % |
//! | parking_c in parking_b | 6.7 % | 20.0 % | 66.7 % |
//! | tum_fr1_desk in tum_fr1_xyz | 43.7 % | 80.3 % | 81.7 % |
//! | highest score between maps that share nothing | 0.184 | 0.173 | 0.089 |
//! | highest score between maps that do | 0.272 | 0.415 | 0.318 |
//!
//! SIFT words keep strangers furthest away from friends, and merging maps matches SIFT features anyway.

mod chow_liu;
mod cluster;
mod file;
#[cfg(test)]
mod tests;
mod tree;

use crate::features::{Descriptor, Features};
use chow_liu::{Occurrence, Tie};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};
use tree::Tree;

/// Levels below the root of the nodes by which features are sorted ([`crate::DirectIndex`]). One less than the words of the
/// shipped vocabulary: with one more, too many matches are missed from another view; with one less, counting takes four
/// times as long.
const NODE_LEVEL: usize = 3;

/// Names a word of a vocabulary: 0 to one less than their number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WordId(pub u32);

/// How a vocabulary is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainParams {
    /// Children of a node. Default 13; 2 to 255. More cost time in a look-up and divide better.
    pub branching: usize,
    /// Levels of the tree; at most `branching` to this power words. Default 4; 1 to 8. More words tell more
    /// places apart, need more training images, and are found again less often from another view.
    pub levels: usize,
    /// Most rounds of k-means in a node. Default 12; at least 1.
    pub iterations: usize,
    /// A node with fewer descriptors than this for each child stays a word. Default 4; at least 1.
    pub min_per_word: usize,
    /// Seed of the random numbers. Default 1. The same seed and images give the same vocabulary.
    pub seed: u64,
}

impl Default for TrainParams {
    fn default() -> Self {
        Self { branching: 13, levels: 4, iterations: 12, min_per_word: 4, seed: 1 }
    }
}

/// Why there is no vocabulary.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VocabularyError {
    /// The file is something else.
    #[error("not a vocabulary: it does not begin with LBVOCAB, compressed or not")]
    NotAVocabulary,
    /// Written by another loopbox.
    #[error("the vocabulary has version {found}, this loopbox reads version {expected}; train it again")]
    OtherVersion {
        /// What the file says.
        found: u32,
        /// What can be read.
        expected: u32,
    },
    /// The file ends too early.
    #[error("the vocabulary is cut short, {missing} bytes are missing; copy or train it again")]
    Truncated {
        /// At least so many are missing.
        missing: usize,
    },
    /// The file was changed.
    #[error("the vocabulary is damaged: its contents do not match its checksum; copy or train it again")]
    Damaged,
    /// Nothing to learn from.
    #[error(
        "{images} images with {descriptors} features are too few to train a vocabulary: \
         give at least 2 images and {needed} features"
    )]
    TooFew {
        /// Images given that have features.
        images: usize,
        /// Features of all images.
        descriptors: usize,
        /// Fewest features.
        needed: usize,
    },
}

/// A vocabulary: a tree of words and what is known of each word.
#[derive(Clone, Debug, PartialEq)]
pub struct Vocabulary {
    tree: Tree,
    /// Training images.
    images: u32,
    /// Of each word the training images that show it.
    counts: Vec<u32>,
    ties: Vec<Tie>,
    weights: Vec<f32>,
    /// Of each word the node of the direct index.
    nodes: Vec<u32>,
    /// Of the tree.
    checksum: u32,
}

/// The words of an image with how often each occurs, in order of the words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WordBag(Vec<(WordId, u32)>);

impl WordBag {
    /// Counts words given in any order, any number of times.
    pub fn new(words: impl IntoIterator<Item = WordId>) -> Self {
        let mut words: Vec<WordId> = words.into_iter().collect();
        words.sort_unstable();
        Self(words.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32)).collect())
    }

    /// How many features the image has.
    pub fn features(&self) -> usize {
        self.0.iter().map(|&(_, count)| count as usize).sum()
    }

    /// Each word once, ascending, with its count.
    pub fn counts(&self) -> &[(WordId, u32)] {
        &self.0
    }
}

impl Vocabulary {
    /// The vocabulary that comes with loopbox.
    pub fn shipped() -> Arc<Self> {
        static SHIPPED: OnceLock<Arc<Vocabulary>> = OnceLock::new();
        let read = || Self::from_bytes(include_bytes!("shipped.vocabulary"));
        let shipped = || Arc::new(read().expect("the vocabulary was built in; a test reads it"));
        Arc::clone(SHIPPED.get_or_init(shipped))
    }

    /// Learns words from the features of images.
    ///
    /// Images should show different places: those that show one place count it several times.
    ///
    /// # Errors
    /// When there are too few images or features.
    pub fn train(images: &[Features], params: &TrainParams) -> Result<Self, VocabularyError> {
        let with_features = images.iter().filter(|i| !i.is_empty()).count();
        let descriptors: Vec<Descriptor> =
            images.iter().flat_map(|image| image.descriptors.iter().copied()).collect();
        let needed = params.branching.max(2) * params.min_per_word.max(1);
        if with_features < 2 || descriptors.len() < needed {
            let (images, descriptors) = (with_features, descriptors.len());
            return Err(VocabularyError::TooFew { images, descriptors, needed });
        }
        let tree = Tree::grow(descriptors, params);
        let words_of = |image: &Features| {
            let mut words: Vec<u32> = image.descriptors.iter().map(|d| tree.lookup(d)).collect();
            words.sort_unstable();
            words.dedup();
            words
        };
        let words: Vec<Vec<u32>> =
            images.par_iter().filter(|image| !image.is_empty()).map(words_of).collect();
        let occurrence = Occurrence::new(tree.words(), &words);
        let ties = occurrence.tree();
        Ok(Self::assembled(tree, words.len() as u32, occurrence.counts().to_vec(), ties))
    }

    fn assembled(tree: Tree, images: u32, counts: Vec<u32>, ties: Vec<Tie>) -> Self {
        let weight = |&count: &u32| (images.max(1) as f32 / count.max(1) as f32).ln();
        let weights = counts.iter().map(weight).collect();
        let nodes = tree.nodes_above(NODE_LEVEL);
        let checksum = tree.checksum();
        Self { tree, images, counts, ties, weights, nodes, checksum }
    }

    /// How many words there are.
    pub fn len(&self) -> usize {
        self.tree.words()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The word of a descriptor: down the tree to the nearest centre at each level.
    pub fn lookup(&self, descriptor: &Descriptor) -> WordId {
        WordId(self.tree.lookup(descriptor))
    }

    /// The node of the direct index that a word is under.
    pub(crate) fn node(&self, word: WordId) -> u32 {
        self.nodes[word.0 as usize]
    }

    /// Tells the words of this vocabulary from those of others: CRC-32 of the tree's shape and centres.
    pub fn checksum(&self) -> u32 {
        self.checksum
    }

    /// The words of an image.
    pub fn words(&self, features: &Features) -> WordBag {
        WordBag::new(features.descriptors.iter().map(|d| self.lookup(d)))
    }

    /// The weight of a word, its inverse document frequency `ln(images / images with the word)` in the
    /// training images (Sivic & Zisserman 2003); 0 for a word that it does not have.
    pub fn weight(&self, word: WordId) -> f32 {
        self.weights.get(word.0 as usize).copied().unwrap_or(0.0)
    }

    /// How probable it is that an image shows a word, as in training; inside 0 to 1.
    pub(crate) fn probability(&self, word: WordId) -> f64 {
        share(self.counts[word.0 as usize], self.images)
    }

    /// The word on which another depends most in the training images; the root of the tree has none.
    pub(crate) fn parent(&self, word: WordId) -> Option<WordId> {
        self.ties[word.0 as usize].parent.map(WordId)
    }

    /// How probable it is that an image shows a word when it shows, or does not, the word's parent.
    pub(crate) fn probability_given_parent(&self, word: WordId, parent_seen: bool) -> f64 {
        let tie = self.ties[word.0 as usize];
        let Some(parent) = tie.parent else { return self.probability(word) };
        let (count, of_parent) = (self.counts[word.0 as usize], self.counts[parent as usize]);
        if parent_seen {
            share(tie.together, of_parent)
        } else {
            share(count - tie.together, self.images - of_parent)
        }
    }
}

/// `count` of `total`, kept off 0 and 1 by half a count on either side (Krichevsky & Trofimov 1981).
fn share(count: u32, total: u32) -> f64 {
    (f64::from(count) + 0.5) / (f64::from(total) + 1.0)
}
