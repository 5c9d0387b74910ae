//! `loopbox places`: keyframes of two maps that may show the same place.

use super::features;
use anyhow::{Result, bail};
use clap::Args;
use map::{KeyframeId, Map, PlaceIndex};
use place_recog::{
    BowIndex, BowParams, FabMap, FabMapParams, SequenceParams, Vocabulary, WordBag, supported,
};
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
}

/// A map's keyframes as words.
struct Words {
    times: BTreeMap<KeyframeId, f64>,
    bags: BTreeMap<KeyframeId, WordBag>,
}

impl Words {
    fn of(map: &Map, vocabulary: &Vocabulary) -> Result<Self> {
        let features = features::of_keyframes(map)?;
        let times = map.keyframes.iter().map(|(&id, keyframe)| (id, keyframe.timestamp)).collect();
        let bags = map.keyframes.keys().copied().zip(features.iter().map(|f| vocabulary.words(f))).collect();
        Ok(Self { times, bags })
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

/// All candidate pairs, best first.
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
        }));
    }
    pairs.sort_by(|x, y| y.score.total_cmp(&x.score).then((x.b, x.a).cmp(&(y.b, y.a))));
    pairs
}

fn table(pairs: &[Pair]) -> String {
    if pairs.is_empty() {
        return "no keyframes of the two maps look alike\n".to_owned();
    }
    let mut out =
        format!("{:>8} {:>14} {:>8} {:>14} {:>7} {:>8}\n", "a", "time", "b", "time", "score", "FAB-MAP");
    for p in pairs {
        out += &format!(
            "{:>8} {:>14.3} {:>8} {:>14.3} {:>7.3} {:>8.3}\n",
            p.a, p.a_time, p.b, p.b_time, p.score, p.probability
        );
    }
    out
}
