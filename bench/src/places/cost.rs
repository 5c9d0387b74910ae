//! What a query costs in a large map, with made-up words.

use map::{KeyframeId, PlaceIndex};
use measuring::median;
use measuring::random::mix;
use place_recog::{BowIndex, BowParams, FabMap, FabMapParams, Vocabulary, WordBag, WordId};
use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;

/// Words of a made-up keyframe, as many as SIFT finds with default parameters.
const WORDS: u64 = 1200;
/// Queries that are timed at each size.
const QUERIES: usize = 100;

/// A table of time and memory over the number of keyframes, up to `most`.
pub fn report(vocabulary: &Arc<Vocabulary>, most: usize) -> String {
    let mut out = format!(
        "Made-up keyframes of {WORDS} features, whose words are as uneven as those of images; a query is a keyframe \
         of the map of which two features in three became other words. Median of {QUERIES} queries on one core.\n\n\
         | keyframes | bag of words | found first | FAB-MAP | memory a keyframe |\n|---|---|---|---|---|\n"
    );
    let mut bow = BowIndex::new(Arc::clone(vocabulary), BowParams::default());
    let mut fab_map = FabMap::new(Arc::clone(vocabulary), FabMapParams::default());
    let mut added = 0;
    for count in [500, 1000, 2000, 5000, 10_000, 20_000, 50_000].into_iter().filter(|&n| n <= most) {
        while added < count {
            let words = keyframe(vocabulary, added as u64, None);
            bow.add(KeyframeId(added as u32), &words);
            fab_map.add(KeyframeId(added as u32), &words);
            added += 1;
        }
        let asked: Vec<u64> = (0..QUERIES as u64).map(|i| mix(i) % count as u64).collect();
        let queries: Vec<WordBag> = asked.iter().map(|&k| keyframe(vocabulary, k, Some(1))).collect();
        let (mut bow_ms, mut fab_ms, mut right) = (Vec::new(), Vec::new(), 0);
        for (query, keyframe) in queries.iter().zip(&asked) {
            let start = Instant::now();
            let found = bow.query(query, 5);
            bow_ms.push(1e3 * start.elapsed().as_secs_f64());
            right += usize::from(found.first().is_some_and(|c| u64::from(c.keyframe.0) == *keyframe));
            let start = Instant::now();
            fab_map.query(query, 5);
            fab_ms.push(1e3 * start.elapsed().as_secs_f64());
        }
        let [bow_ms, fab_ms] = [bow_ms, fab_ms].map(|ms| median(ms).unwrap_or(f64::NAN));
        let bytes = bow.bytes() / count;
        let _ = writeln!(
            out,
            "| {count} | {bow_ms:.2} ms | {right} of {QUERIES} | {fab_ms:.2} ms | {:.1} kB |",
            bytes as f64 / 1e3
        );
    }
    out
}

/// The words of keyframe `id`; with `look` another look at it, of which a third of the words stayed.
fn keyframe(vocabulary: &Vocabulary, id: u64, look: Option<u64>) -> WordBag {
    let words = vocabulary.len() as f64;
    // The square makes the first words common: the most common is in every other keyframe.
    let word = |bits: u64| {
        let uniform = (bits >> 11) as f64 / (1u64 << 53) as f64;
        WordId((uniform.powi(2) * words) as u32)
    };
    WordBag::new((0..WORDS).map(|i| {
        let stays = look.is_none_or(|look| mix(id ^ mix(i ^ mix(look))).is_multiple_of(3));
        word(if stays { mix(mix(id) ^ i) } else { mix(mix(id) ^ mix(i) ^ 0x5eed) })
    }))
}
