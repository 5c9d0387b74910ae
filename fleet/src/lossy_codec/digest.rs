//! A keyframe in a kilobyte: its words, with which others it hangs together, and a few of its depths.
//!
//! No small image is among it: by the features of the few keyframes whose words are alike, which are asked for next,
//! places are told apart better than by images of 40×30 pixels, which find views from nearly the same spot and
//! direction only and would double the digest.

use super::{is_usable, of_steps, spread, steps};
use crate::bytes::{Malformed, Reader, Writer};
use map::{Keyframe, KeyframeId};
use place_recog::{Vocabulary, WordBag, WordId};

/// The version written; others are refused.
const VERSION: u8 = 1;
/// Depths in a digest: as many as merging takes to see which keyframes overlap.
pub const SAMPLES: usize = 64;
/// Keyframes that one hangs together with, at the most.
const LINKED: usize = 64;
/// Words of an image, at the most: as many as it may have features.
const WORDS: u32 = u16::MAX as u32;

/// A keyframe in few words.
#[derive(Clone, Debug, PartialEq)]
pub struct Digest {
    /// Time stamp of the image, seconds.
    pub timestamp: f64,
    /// Index of the image in the recording.
    pub frame_index: u64,
    /// Earlier keyframes that it shares an edge with.
    pub linked: Vec<KeyframeId>,
    /// The words of its features.
    pub words: WordBag,
    /// Pixels spread over its depth map, ascending, each with its inverse depth, 1/keyframe unit.
    pub samples: Vec<(u32, f32)>,
}

impl Digest {
    /// Of a keyframe with these words and edges to these earlier keyframes.
    pub fn of(keyframe: &Keyframe, words: WordBag, linked: &[KeyframeId]) -> Self {
        let mut linked: Vec<KeyframeId> = linked.iter().copied().filter(|id| *id < keyframe.id).collect();
        // The nearest in time where there are too many: they hold the map together.
        linked.sort_unstable_by(|a, b| b.cmp(a));
        linked.dedup();
        linked.truncate(LINKED);
        let samples =
            spread(&keyframe.semi_dense, SAMPLES).map(|(pixel, inverse_depth, _)| (pixel, inverse_depth));
        let (timestamp, frame_index) = (keyframe.timestamp, keyframe.frame_index);
        Self { timestamp, frame_index, linked, words, samples: samples.collect() }
    }

    /// As bytes, of the keyframe `id`; inverse depths are rounded.
    pub fn to_bytes(&self, id: KeyframeId) -> Vec<u8> {
        let mut out = Writer::default();
        out.u8(VERSION);
        out.u64(self.timestamp.to_bits());
        out.u64(self.frame_index);
        out.u8(self.linked.len() as u8);
        self.linked.iter().for_each(|other| out.varint(id.0.saturating_sub(other.0)));
        let counts = self.words.counts();
        out.varint(counts.len() as u32);
        let mut before = 0;
        for (word, count) in counts {
            // A word that occurs once, as most do, takes no more than its distance from the one before.
            out.varint((word.0 - before) << 1 | u32::from(*count > 1));
            if *count > 1 {
                out.varint(*count);
            }
            before = word.0;
        }
        out.u8(self.samples.len() as u8);
        let mut before = 0;
        for (pixel, inverse_depth) in &self.samples {
            out.varint(pixel - before);
            out.u16(steps(*inverse_depth) as i16 as u16);
            before = *pixel;
        }
        out.0
    }

    /// The inverse of [`to_bytes`](Self::to_bytes), of the keyframe `id` with words of `vocabulary`.
    ///
    /// # Errors
    /// When the bytes are no digest.
    pub fn from_bytes(bytes: &[u8], id: KeyframeId, vocabulary: &Vocabulary) -> Result<Self, Malformed> {
        let mut from = Reader::new(bytes);
        let version = from.u8()?;
        if version != VERSION {
            return Err(Malformed::Range("the version of a digest", version.into()));
        }
        let (timestamp, frame_index) = (f64::from_bits(from.u64()?), from.u64()?);
        if !timestamp.is_finite() {
            return Err(Malformed::Range("a time", timestamp.to_bits()));
        }
        let count = usize::from(from.u8()?);
        if count > LINKED {
            return Err(Malformed::Range("the number of edges", count as u64));
        }
        let linked = |_| {
            let apart = from.varint()?;
            let earlier = id.0.checked_sub(apart).filter(|_| apart > 0);
            earlier.map(KeyframeId).ok_or(Malformed::Range("a keyframe's distance", apart.into()))
        };
        let linked = (0..count).map(linked).collect::<Result<Vec<_>, _>>()?;
        let count = from.varint()?;
        if count > WORDS {
            return Err(Malformed::Range("the number of words", count.into()));
        }
        let (mut words, mut total, mut word) = (Vec::new(), 0, 0u32);
        for _ in 0..count {
            let step = from.varint()?;
            word = word.saturating_add(step >> 1);
            let times = if step & 1 == 1 { from.varint()? } else { 1 };
            total += u64::from(times);
            if word as usize >= vocabulary.len() || total > WORDS.into() {
                return Err(Malformed::Range("a word", word.into()));
            }
            words.extend((0..times).map(|_| WordId(word)));
        }
        let count = usize::from(from.u8()?);
        if count > SAMPLES {
            return Err(Malformed::Range("the number of depths", count as u64));
        }
        let (mut samples, mut pixel) = (Vec::new(), 0u32);
        for _ in 0..count {
            pixel = pixel.saturating_add(from.varint()?);
            let inverse_depth = of_steps(i32::from(from.u16()? as i16));
            if !is_usable(&(pixel, inverse_depth, 0.0)) {
                return Err(Malformed::Range("an inverse depth", inverse_depth.to_bits().into()));
            }
            samples.push((pixel, inverse_depth));
        }
        from.end()?;
        Ok(Self { timestamp, frame_index, linked, words: WordBag::new(words), samples })
    }
}
