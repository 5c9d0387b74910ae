//! What a query costs in a large map, with made-up keyframes of real words.

use geometry::Random;
use map::{KeyframeId, PlaceIndex};
use place_recog::{BowIndex, BowParams, Vocabulary, WordBag, WordId};
use std::fmt::Write;
use std::sync::Arc;

/// Queries that are timed at each size.
const QUERIES: usize = 200;
/// Those of them that are compared with all keyframes as well.
const COMPARED: usize = 16;
/// Candidates asked for, as merging asks.
const CANDIDATES: usize = 10;
/// Share of a made-up keyframe's features that are those of one real keyframe: thousands are of its kind.
const OF_ITS_KIND: f64 = 0.3;

/// Words of real keyframes, of which others are made.
struct Pool<'a> {
    keyframes: &'a [&'a WordBag],
    /// Every feature's word.
    words: Vec<WordId>,
}

/// A table of time, memory and what is found over the number of keyframes, up to `most`; made of the words of real ones.
pub fn report(vocabulary: &Arc<Vocabulary>, real: &[&WordBag], most: usize) -> String {
    let pool = Pool::new(real);
    let mut out = format!(
        "Made-up keyframes: each has as many features as one of {} real ones (of {} on average) and {:.0} % of its words, so that \
         thousands are of its kind; the others are words of all real keyframes, as often as there. A query is a keyframe of the map \
         of which so many features became other words. Means of {QUERIES} queries for {CANDIDATES} keyframes, processor time of one core; *as \
         by all* is how many of {COMPARED} queries have the best candidate that comparing with every keyframe has, *found* how many \
         of {QUERIES} have the keyframe asked for first.\n\n\
         | keyframes | query | comparing with all | as by all, 2 of 3 features other | found | as by all, 4 of 5 other | \
         found | adding one | memory a keyframe |\n|---|---|---|---|---|---|---|---|---|\n",
        real.len(),
        pool.words.len() / real.len().max(1),
        100.0 * OF_ITS_KIND
    );
    let mut index = BowIndex::new(Arc::clone(vocabulary), BowParams::default());
    let mut added = 0;
    for count in [1000, 10_000, 100_000, 1_000_000].into_iter().filter(|&n| n <= most) {
        let (mut adding, before) = (0.0, added);
        while added < count {
            let words = pool.keyframe(added as u64, None);
            let start = processor_ms();
            index.add(KeyframeId(added as u32), &words);
            adding += processor_ms() - start;
            added += 1;
        }
        let adding = adding / (count - before).max(1) as f64;
        let few = asked(&index, &pool, count, 1.0 / 3.0);
        let hard = asked(&index, &pool, count, 0.2);
        let _ = writeln!(
            out,
            "| {count} | {:.2} ms | {:.1} ms | {} of {COMPARED} | {} of {QUERIES} | {} of {COMPARED} | {} of {QUERIES} | \
             {adding:.3} ms | {:.2} kB |",
            few.mean,
            few.all,
            few.as_by_all,
            few.found,
            hard.as_by_all,
            hard.found,
            index.bytes() as f64 / count as f64 / 1e3
        );
        eprintln!("{}", out.lines().last().unwrap_or_default());
    }
    out
}

/// What came of the queries of a map.
struct Asked {
    /// Milliseconds, and of comparing with all.
    mean: f64,
    all: f64,
    as_by_all: usize,
    found: usize,
}

/// Asks for keyframes of which a share of the features stayed.
fn asked(index: &BowIndex, pool: &Pool, count: usize, stays: f64) -> Asked {
    let mut random = Random::new(7);
    let (mut took, mut all, mut as_by_all, mut right) = (Vec::new(), Vec::new(), 0, 0);
    for query in 0..QUERIES {
        let keyframe = random.index(count) as u64;
        let words = pool.keyframe(keyframe, Some(stays));
        let start = processor_ms();
        let found = index.query(&words, CANDIDATES);
        took.push(processor_ms() - start);
        let best = found.first().map(|candidate| candidate.keyframe);
        right += usize::from(best == Some(KeyframeId(keyframe as u32)));
        if query < COMPARED {
            let start = processor_ms();
            let exact = index.query_all(&words, CANDIDATES);
            all.push(processor_ms() - start);
            as_by_all += usize::from(best == exact.first().map(|candidate| candidate.keyframe));
        }
    }
    let mean = |times: Vec<f64>| times.iter().sum::<f64>() / times.len().max(1) as f64;
    Asked { mean: mean(took), all: mean(all), as_by_all, found: right }
}

impl<'a> Pool<'a> {
    fn new(keyframes: &'a [&'a WordBag]) -> Self {
        let of = |bag: &&'a WordBag| every(bag);
        Self { keyframes, words: keyframes.iter().flat_map(of).collect() }
    }

    /// The words of keyframe `id`; or another look at it, of which a share of the words stayed.
    fn keyframe(&self, id: u64, stays: Option<f64>) -> WordBag {
        let mut random = Random::new(id.wrapping_mul(0x9e37_79b9).wrapping_add(1));
        let kind: Vec<WordId> = every(self.keyframes[random.index(self.keyframes.len())]).collect();
        let any = |random: &mut Random| self.words[random.index(self.words.len())];
        let mut other = Random::new(id ^ 0x5eed_0000);
        let word = |own: &WordId| {
            // Drawn whether it is used or not, so that what comes after does not depend on it.
            let (unit, drawn) = (random.unit(), any(&mut random));
            let word = if unit < OF_ITS_KIND { *own } else { drawn };
            match stays {
                Some(stays) if other.unit() >= stays => any(&mut other),
                _ => word,
            }
        };
        WordBag::new(kind.iter().map(word).collect::<Vec<_>>())
    }
}

/// The words of a bag, each as often as it occurs.
fn every(bag: &WordBag) -> impl Iterator<Item = WordId> + '_ {
    bag.counts().iter().flat_map(|&(word, count)| std::iter::repeat_n(word, count as usize))
}

/// Milliseconds that this thread has run for: others on the machine do not count.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds: Option<f64> = text.split_whitespace().next().and_then(|word| word.parse().ok());
    nanoseconds.map_or(f64::NAN, |nanoseconds| nanoseconds / 1e6)
}
