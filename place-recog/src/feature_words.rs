//! The words of an image's features, one by one, and the bytes they are kept as: with them an image is found and its
//! features are sorted ([`DirectIndex`](crate::DirectIndex)) without a look at the descriptors.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | checksum of the vocabulary's tree: words of another one say nothing |
//! | 2 each, or 4 where the vocabulary has more than 65,536 words | the word of each feature, in the order of the features |
//!
//! Little-endian.

use crate::features::Features;
use crate::{Vocabulary, WordBag, WordId};

/// The word of each feature of an image, in the order of the features.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FeatureWords(Vec<WordId>);

impl FeatureWords {
    /// Looks up the features of an image.
    pub fn of(features: &Features, vocabulary: &Vocabulary) -> Self {
        Self(features.descriptors.iter().map(|descriptor| vocabulary.lookup(descriptor)).collect())
    }

    /// The words, in the order of the features.
    pub fn words(&self) -> &[WordId] {
        &self.0
    }

    /// The words of the image.
    pub fn bag(&self) -> WordBag {
        WordBag::new(self.0.iter().copied())
    }

    /// To be kept with the features.
    pub fn to_bytes(&self, vocabulary: &Vocabulary) -> Vec<u8> {
        let mut bytes = vocabulary.checksum().to_le_bytes().to_vec();
        let size = size(vocabulary);
        self.0.iter().for_each(|word| bytes.extend_from_slice(&word.0.to_le_bytes()[..size]));
        bytes
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote; `None` where the words are not this vocabulary's.
    pub fn from_bytes(bytes: &[u8], vocabulary: &Vocabulary) -> Option<Self> {
        let words = bytes.strip_prefix(&vocabulary.checksum().to_le_bytes())?.chunks(size(vocabulary));
        let word = |bytes: &[u8]| bytes.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
        let known = |word: u32| ((word as usize) < vocabulary.len()).then_some(WordId(word));
        let whole = |bytes: &[u8]| (bytes.len() == size(vocabulary)).then(|| word(bytes));
        words.map(|bytes| whole(bytes).and_then(known)).collect::<Option<_>>().map(Self)
    }
}

/// Bytes of a word.
fn size(vocabulary: &Vocabulary) -> usize {
    if vocabulary.len() <= 1 << 16 { 2 } else { 4 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TrainParams;

    fn image(seed: u64) -> Features {
        let mut random = geometry::Random::new(seed);
        let mut byte = move || random.below(32) as u8;
        let descriptors = (0..200).map(|_| std::array::from_fn(|_| byte())).collect();
        let keypoint = crate::features::Keypoint { pixel: [0.0; 2], size: 1.0, angle: 0.0 };
        Features { keypoints: vec![keypoint; 200], descriptors }
    }

    #[test]
    fn words_come_back_for_the_vocabulary_they_are_of() {
        let (shipped, image) = (Vocabulary::shipped(), image(1));
        let words = FeatureWords::of(&image, &shipped);
        assert_eq!(words.bag(), shipped.words(&image));
        let bytes = words.to_bytes(&shipped);
        assert_eq!(bytes.len(), 4 + 2 * 200);
        assert_eq!(FeatureWords::from_bytes(&bytes, &shipped), Some(words));
        let other = Vocabulary::train(&[image, self::image(2)], &TrainParams::default()).unwrap();
        assert_eq!(FeatureWords::from_bytes(&bytes, &other), None);
    }

    #[test]
    fn bytes_that_are_no_words_are_none() {
        let shipped = Vocabulary::shipped();
        let mut bytes = FeatureWords::of(&image(1), &shipped).to_bytes(&shipped);
        assert_eq!(FeatureWords::from_bytes(&bytes[..3], &shipped), None);
        assert_eq!(FeatureWords::from_bytes(&bytes[..bytes.len() - 1], &shipped), None);
        bytes.extend([255, 255]);
        assert_eq!(FeatureWords::from_bytes(&bytes, &shipped), None);
    }
}
