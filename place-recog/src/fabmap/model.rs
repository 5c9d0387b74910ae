//! The probabilities of words given a place.

use super::FabMapParams;
use crate::vocabulary::{Vocabulary, WordId};

/// Numbers of words that the average place is worked out for, relative to the mean of the training images.
const RICHNESS: [f64; 7] = [1.0 / 32.0, 1.0 / 16.0, 1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0, 1.0, 2.0];

/// `ln p(z | z_parent, place)` of a word in a place, by `2 · parent seen + word seen`.
type Table = [f32; 4];

/// What the training images and the detector say of each word.
#[derive(Debug)]
pub struct Model {
    /// Of each word in a place that showed it.
    visible: Vec<Table>,
    /// Of each word in a place that did not.
    hidden: Vec<Table>,
    /// Of each word in an average place of each [`RICHNESS`].
    average: Vec<Vec<Table>>,
    children: Vec<Vec<u32>>,
    /// Mean number of words of a training image.
    mean_words: f64,
}

/// A word's probabilities in training.
struct Word {
    marginal: f64,
    /// By whether the parent is seen.
    given_parent: [f64; 2],
}

impl Model {
    pub fn new(vocabulary: &Vocabulary, params: &FabMapParams) -> Self {
        let mut children = vec![Vec::new(); vocabulary.len()];
        let mut words = Vec::with_capacity(vocabulary.len());
        for word in (0..vocabulary.len() as u32).map(WordId) {
            if let Some(parent) = vocabulary.parent(word) {
                children[parent.0 as usize].push(word.0);
            }
            let given_parent = [false, true].map(|seen| vocabulary.probability_given_parent(word, seen));
            words.push(Word { marginal: vocabulary.probability(word), given_parent });
        }
        let tables = |exists: &dyn Fn(&Word) -> f64| -> Vec<Table> {
            words.iter().map(|word| word.table(exists(word), params)).collect()
        };
        let (visible, hidden) =
            (tables(&|word| word.exists(true, params)), tables(&|word| word.exists(false, params)));
        let average = RICHNESS.map(|richness| {
            tables(&|word| {
                let share = (richness * word.marginal).min(1.0);
                share * word.exists(true, params) + (1.0 - share) * word.exists(false, params)
            })
        });
        let mean_words = words.iter().map(|word| word.marginal).sum();
        Self { visible, hidden, average: average.into(), children, mean_words }
    }
}

impl Word {
    /// `p(e = 1 | one look at the place)`, the word seen or not, by Bayes with the prior `p(e = 1)` of training.
    fn exists(&self, seen: bool, params: &FabMapParams) -> f64 {
        let of = |detected: f64| if seen { detected } else { 1.0 - detected };
        let there = of(params.detection) * self.marginal;
        there / (there + of(params.false_detection) * (1.0 - self.marginal))
    }

    /// `ln p(z | z_parent, place)` where the thing exists with the given probability.
    fn table(&self, exists: f64, params: &FabMapParams) -> Table {
        let mut table = Table::default();
        for (parent_seen, given_parent) in self.given_parent.into_iter().enumerate() {
            // p(z = 1 | e, z_parent): detector and tree joined (2008, §4.3).
            let seen = |detected: f64| {
                let alpha = self.marginal * (1.0 - detected) * (1.0 - given_parent);
                let beta = (1.0 - self.marginal) * detected * given_parent;
                beta / (alpha + beta)
            };
            let p = exists * seen(params.detection) + (1.0 - exists) * seen(params.false_detection);
            table[2 * parent_seen] = (1.0 - p).max(1e-9).ln() as f32;
            table[2 * parent_seen + 1] = p.max(1e-9).ln() as f32;
        }
        table
    }
}

/// A query's words, ready to be compared with places.
pub struct Observed {
    /// Of each word `2 · parent seen + word seen`.
    states: Vec<u8>,
    /// `ln p(query | place)` of a place that showed no word.
    hidden: f64,
    /// The same of an average place of each [`RICHNESS`].
    average: Vec<f64>,
}

impl Observed {
    pub fn new(model: &Model, seen: &[WordId]) -> Self {
        let mut states = vec![0u8; model.children.len()];
        for word in seen {
            states[word.0 as usize] |= 1;
            for &child in &model.children[word.0 as usize] {
                states[child as usize] |= 2;
            }
        }
        let sum = |tables: &Vec<Table>| {
            states.iter().zip(tables).map(|(&state, table)| f64::from(table[usize::from(state)])).sum()
        };
        let (hidden, average) = (sum(&model.hidden), model.average.iter().map(sum).collect());
        Self { states, hidden, average }
    }

    /// `ln p(query | place) − ln p(query | average place with as many words)`, nats, of a place that showed
    /// `words`.
    pub fn log_ratio(&self, model: &Model, words: &[WordId]) -> f64 {
        let change = |word: &WordId| {
            let (at, state) = (word.0 as usize, usize::from(self.states[word.0 as usize]));
            f64::from(model.visible[at][state] - model.hidden[at][state])
        };
        let place = self.hidden + words.iter().map(change).sum::<f64>();
        place - self.of_average(words.len() as f64 / model.mean_words)
    }

    /// `ln p(query | average place)`, linear between the logarithms of [`RICHNESS`].
    fn of_average(&self, richness: f64) -> f64 {
        let at = (richness.max(RICHNESS[0]) / RICHNESS[0]).log2().min((RICHNESS.len() - 1) as f64);
        let low = (at as usize).min(RICHNESS.len() - 2);
        self.average[low] + (at - low as f64) * (self.average[low + 1] - self.average[low])
    }
}
