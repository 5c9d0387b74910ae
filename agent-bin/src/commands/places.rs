//! `loopbox places`: keyframes of two maps that may show the same place.

use super::features;
use anyhow::{Result, bail};
use clap::Args;
use map::{KeyframeId, Map, PlaceIndex};
use place_recog::features::Features;
use place_recog::{
    BowIndex, BowParams, DirectIndex, FabMap, FabMapParams, RankParams, SequenceParams, Vocabulary, WordBag,
    shared_features, supported,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{Write, stdout};
use std::path::PathBuf;
use std::sync::Arc;

/// Candidates of each keyframe before its neighbours have their say.
const CANDIDATES: usize = 10;

/// List the keyframes of two maps that may show the same place, best first
#[derive(Debug, Args)]
pub struct PlacesArgs {
    /// The map that is searched: a map.mcap, or the folder of a run
    a: PathBuf,
    /// The map whose keyframes are looked for
    b: PathBuf,
    /// Most pairs listed
    #[arg(long, value_name = "N", default_value_t = 20)]
    count: usize,
    /// Another vocabulary than the one that comes with loopbox, made by `loopbox vocab train`
    #[arg(long, value_name = "FILE")]
    vocabulary: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A pair of keyframes that may show the same place.
#[derive(Debug, Serialize)]
struct Pair {
    /// Keyframe of the first map, and its time, seconds.
    a: u32,
    a_time: f64,
    /// Keyframe of the second map, and its time, seconds.
    b: u32,
    b_time: f64,
    /// Likeness of the words, 0–1, with the support of the keyframes before and after.
    score: f32,
    /// FAB-MAP's probability that b shows the place of a rather than another or a new one.
    probability: f64,
    /// How many features they share; counted for the best by score.
    shared: Option<usize>,
}

/// A map's keyframes as words.
struct Words {
    times: BTreeMap<KeyframeId, f64>,
    bags: BTreeMap<KeyframeId, WordBag>,
    features: BTreeMap<KeyframeId, (DirectIndex, Features)>,
}

impl Words {
    fn of(map: &Map, vocabulary: &Vocabulary) -> Result<Self> {
        let features = features::of_keyframes(map)?;
        let times = map.keyframes.iter().map(|(&id, keyframe)| (id, keyframe.timestamp)).collect();
        let bags = map.keyframes.keys().copied().zip(features.iter().map(|f| vocabulary.words(f))).collect();
        let directed = features.into_iter().map(|f| (DirectIndex::new(&f, vocabulary), f));
        let features = map.keyframes.keys().copied().zip(directed).collect();
        Ok(Self { times, bags, features })
    }

    fn directed(&self, id: u32) -> Option<(&DirectIndex, &Features)> {
        self.features.get(&KeyframeId(id)).map(|(index, features)| (index, features))
    }
}

/// Runs `loopbox places`.
///
/// # Errors
/// When a map or the vocabulary cannot be read, or a map has no keyframes.
pub fn run(args: &PlacesArgs) -> Result<()> {
    let vocabulary = match &args.vocabulary {
        Some(path) => features::vocabulary(path)?,
        None => Vocabulary::shipped(),
    };
    let words = |path: &PathBuf| {
        let map = features::load(path)?;
        if map.keyframes.is_empty() {
            bail!("{}: the map has no keyframes", path.display());
        }
        Words::of(&map, &vocabulary)
    };
    let mut pairs = pairs(&words(&args.a)?, &words(&args.b)?, &vocabulary);
    pairs.truncate(args.count);
    if args.json {
        writeln!(stdout(), "{}", serde_json::to_string_pretty(&pairs)?)?;
    } else {
        write!(stdout(), "{}", table(&pairs))?;
    }
    Ok(())
}

/// All candidate pairs: those of highest score by the features they share, most first, then the others by their
/// score.
fn pairs(a: &Words, b: &Words, vocabulary: &Arc<Vocabulary>) -> Vec<Pair> {
    let mut bow = BowIndex::new(Arc::clone(vocabulary), BowParams::default());
    let mut fab_map = FabMap::new(Arc::clone(vocabulary), FabMapParams::default());
    for (&id, bag) in &a.bags {
        bow.add(id, bag);
        fab_map.add(id, bag);
    }
    let ids: Vec<KeyframeId> = a.bags.keys().copied().collect();
    let single: Vec<_> = b.bags.values().map(|bag| bow.query(bag, CANDIDATES)).collect();
    let mut pairs = Vec::new();
    for ((&id, bag), candidates) in b.bags.iter().zip(supported(&single, &ids, &SequenceParams::default())) {
        let located: BTreeMap<KeyframeId, f64> = fab_map.locate(bag, &|_| true).places.into_iter().collect();
        pairs.extend(candidates.into_iter().map(|candidate| Pair {
            a: candidate.keyframe.0,
            a_time: a.times[&candidate.keyframe],
            b: id.0,
            b_time: b.times[&id],
            score: candidate.score,
            probability: located.get(&candidate.keyframe).copied().unwrap_or(0.0),
            shared: None,
        }));
    }
    pairs.sort_by(|x, y| y.score.total_cmp(&x.score).then((x.b, x.a).cmp(&(y.b, y.a))));
    let params = RankParams::default();
    pairs.par_iter_mut().take(params.considered).for_each(|pair| {
        let both = a.directed(pair.a).zip(b.directed(pair.b));
        pair.shared = both.map(|(of_a, of_b)| shared_features(of_a, of_b, &params));
    });
    // Stable: of equals the higher score stays first, and what was not counted last.
    pairs.sort_by_key(|pair| std::cmp::Reverse(pair.shared));
    pairs
}

fn table(pairs: &[Pair]) -> String {
    if pairs.is_empty() {
        return "no keyframes of the two maps look alike\n".to_owned();
    }
    let mut out = format!(
        "{:>8} {:>14} {:>8} {:>14} {:>7} {:>7} {:>8}\n",
        "a", "time", "b", "time", "shared", "score", "FAB-MAP"
    );
    for p in pairs {
        let shared = p.shared.map_or("–".to_owned(), |count| count.to_string());
        out += &format!(
            "{:>8} {:>14.3} {:>8} {:>14.3} {shared:>7} {:>7.3} {:>8.3}\n",
            p.a, p.a_time, p.b, p.b_time, p.score, p.probability
        );
    }
    out
}
