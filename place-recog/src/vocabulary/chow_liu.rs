//! The Chow–Liu tree of words (Chow & Liu 1968; Cummins & Newman 2008, §4.2): of all trees the one whose
//! distribution is nearest to that of the words in the training images, the maximum spanning tree of their mutual
//! information.

use rayon::prelude::*;

/// Which images show a word, one bit each.
pub struct Occurrence {
    bits: Vec<u64>,
    stride: usize,
    images: u32,
    counts: Vec<u32>,
}

/// The tie of a word to its parent in the tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tie {
    /// The parent word; `None` for the root.
    pub parent: Option<u32>,
    /// In how many images both occur.
    pub together: u32,
}

impl Occurrence {
    /// Of `words` words, from the words of each image.
    pub fn new(words: usize, images: &[Vec<u32>]) -> Self {
        let stride = images.len().div_ceil(64);
        let mut bits = vec![0u64; words * stride];
        for (i, image) in images.iter().enumerate() {
            for &word in image {
                bits[word as usize * stride + i / 64] |= 1 << (i % 64);
            }
        }
        let count = |w: usize| bits[w * stride..(w + 1) * stride].iter().map(|b| b.count_ones()).sum();
        let counts = (0..words).map(count).collect();
        Self { bits, stride, images: images.len() as u32, counts }
    }

    /// In how many images each word occurs.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    fn row(&self, word: usize) -> &[u64] {
        &self.bits[word * self.stride..(word + 1) * self.stride]
    }

    fn together(&self, a: usize, b: usize) -> u32 {
        self.row(a).iter().zip(self.row(b)).map(|(x, y)| (x & y).count_ones()).sum()
    }

    /// The tree with word 0 as its root, by Prim's algorithm: the word most tied to the tree joins it next; of
    /// equally tied ones the first.
    pub fn tree(&self) -> Vec<Tie> {
        let words = self.counts.len();
        let n_log_n: Vec<f64> = (0..=self.images).map(|n| f64::from(n) * f64::from(n.max(1)).ln()).collect();
        let mut ties = vec![Tie::default(); words];
        // Mutual information with the nearest word of the tree; words of the tree are out at −1.
        let mut strength = vec![f64::NEG_INFINITY; words];
        let mut last = 0;
        for _ in 1..words {
            strength[last] = -1.0;
            (&mut ties, &mut strength).into_par_iter().enumerate().with_min_len(512).for_each(
                |(w, (tie, best))| {
                    if *best == -1.0 {
                        return;
                    }
                    let together = self.together(w, last);
                    let information = self.information(w, last, together, &n_log_n);
                    if information > *best {
                        *best = information;
                        *tie = Tie { parent: Some(last as u32), together };
                    }
                },
            );
            last = (0..words).rev().max_by(|&a, &b| strength[a].total_cmp(&strength[b])).unwrap_or(0);
        }
        ties
    }

    /// Mutual information of two words' occurrence times the number of images, nats; ≥ 0.
    fn information(&self, a: usize, b: usize, together: u32, n_log_n: &[f64]) -> f64 {
        let (n, n_a, n_b) = (self.images, self.counts[a], self.counts[b]);
        let h = |count: u32| n_log_n[count as usize];
        let joint = h(together) + h(n_a - together) + h(n_b - together) + h(n + together - n_a - n_b);
        (joint - h(n_a) - h(n - n_a) - h(n_b) - h(n - n_b) + h(n)).max(0.0)
    }
}
