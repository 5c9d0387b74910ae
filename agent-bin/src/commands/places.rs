//! `loopbox places`: keyframes of two maps that may show the same place.

use super::features;
use super::info_map::load_at;
use crate::console;
use anyhow::{Result, bail};
use clap::Args;
use loopbox::merging::features_of_keyframes;
use map::{KeyframeId, Map, PlaceIndex};
use place_recog::{
    DirectIndex, Directed, FabMap, FabMapParams, FeatureWords, KeyframeFeatures, Proposal, ProposeParams,
    RankParams, Vocabulary, WordBag, propose, ranked, words,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

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
    features: KeyframeFeatures,
    direct: BTreeMap<KeyframeId, DirectIndex>,
}

impl Words {
    fn of(map: &Map, vocabulary: &Vocabulary) -> Result<Self> {
        let times = map.keyframes.iter().map(|(&id, keyframe)| (id, keyframe.timestamp)).collect();
        let (ids, found) = (|| map.keyframes.keys().copied(), features_of_keyframes(map)?);
        let looked_up: Vec<_> = found.par_iter().map(|f| FeatureWords::of(f, vocabulary)).collect();
        let (bags, direct) = words(&ids().zip(looked_up).collect(), vocabulary);
        let features = ids().zip(found).collect();
        Ok(Self { times, bags, features, direct })
    }

    fn directed(&self) -> Directed<'_> {
        Directed { features: &self.features, index: &self.direct }
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
    let words_of = |path: &PathBuf| {
        let map = load_at(path)?;
        map.of_cameras()?;
        if map.keyframes.is_empty() {
            bail!("{}: the map has no keyframes", path.display());
        }
        Words::of(&map, &vocabulary)
    };
    let mut pairs = pairs(&words_of(&args.a)?, &words_of(&args.b)?, &vocabulary);
    pairs.truncate(args.count);
    if args.json {
        console::print(&(serde_json::to_string_pretty(&pairs)? + "\n"))?;
    } else {
        console::print(&table(&pairs))?;
    }
    Ok(())
}

/// All candidate pairs: those of highest score by the features they share, most first, then the others by their
/// score.
fn pairs(a: &Words, b: &Words, vocabulary: &Arc<Vocabulary>) -> Vec<Pair> {
    let all = ProposeParams { apart: 0, ..ProposeParams::default() };
    let proposals = propose(&a.bags, &b.bags, vocabulary, &all);
    let proposals = ranked(proposals, a.directed(), b.directed(), &RankParams::default());
    let mut fab_map = FabMap::new(Arc::clone(vocabulary), FabMapParams::default());
    a.bags.iter().for_each(|(&id, bag)| fab_map.add(id, bag));
    let located: BTreeMap<KeyframeId, BTreeMap<KeyframeId, f64>> = b
        .bags
        .iter()
        .map(|(&id, bag)| (id, fab_map.locate(bag, &|_| true).places.into_iter().collect()))
        .collect();
    let pair = |proposal: Proposal| Pair {
        a: proposal.keyframe.0,
        a_time: a.times[&proposal.keyframe],
        b: proposal.query.0,
        b_time: b.times[&proposal.query],
        score: proposal.score,
        probability: located[&proposal.query].get(&proposal.keyframe).copied().unwrap_or(0.0),
        shared: proposal.shared,
    };
    proposals.into_iter().map(pair).collect()
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
