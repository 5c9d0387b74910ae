//! A map to be merged, with the features and words of its keyframes.

use crate::commands::features;
use crate::commands::info_map::load_at;
use anyhow::{Result, bail};
use map::{KeyframeId, Map};
use place_recog::features::Features;
use place_recog::{DirectIndex, Directed, Vocabulary, WordBag, words};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A map to be merged.
pub struct Input {
    /// The file or folder it was given as.
    pub path: PathBuf,
    /// What to call it: its agents' names.
    pub name: String,
    /// The map.
    pub map: Map,
    /// The features of its keyframes that have depth.
    pub features: BTreeMap<KeyframeId, Features>,
    /// Their words.
    pub words: BTreeMap<KeyframeId, WordBag>,
    /// Their features by nodes of the vocabulary's tree.
    pub direct: BTreeMap<KeyframeId, DirectIndex>,
    /// How long it took to get all this.
    pub seconds: InputSeconds,
}

/// Wall-clock seconds to get an input ready.
#[derive(Clone, Copy, Debug, Default)]
pub struct InputSeconds {
    /// Reading the file.
    pub reading: f64,
    /// Features and words of all keyframes.
    pub features: f64,
}

impl Input {
    /// Reads a map, a `map.mcap` or the folder that holds it, and finds the features of its keyframes.
    ///
    /// # Errors
    /// When it cannot be read, or holds nothing that could be merged: no keyframes, or none with depth.
    pub fn load(path: &Path, vocabulary: &Vocabulary) -> Result<Self> {
        let start = Instant::now();
        let map = load_at(path)?;
        let reading = start.elapsed().as_secs_f64();
        if map.keyframes.is_empty() {
            bail!("{}: the map has no keyframes: there is nothing to merge", path.display());
        }
        if map.keyframes.values().all(|keyframe| keyframe.semi_dense.is_empty()) {
            bail!(
                "{}: no keyframe of the map has depth, so nothing tells its scale\nhint: the run may have ended \
                 before it could map; run it again on a longer recording",
                path.display()
            );
        }
        let found = features::of_keyframes(&map)?;
        // Keyframes without depth could be recognised, but nothing could come of it.
        let features: BTreeMap<KeyframeId, Features> = map
            .keyframes
            .values()
            .zip(found)
            .filter(|(keyframe, _)| !keyframe.semi_dense.is_empty())
            .map(|(keyframe, features)| (keyframe.id, features))
            .collect();
        let (words, direct) = words(&features, vocabulary);
        let names: Vec<&str> = map.agents.values().map(|agent| &*agent.name).collect();
        let seconds = InputSeconds { reading, features: start.elapsed().as_secs_f64() - reading };
        Ok(Self { path: path.to_owned(), name: names.join("+"), map, features, words, direct, seconds })
    }

    /// The keyframes as the direct index needs them.
    pub fn directed(&self) -> Directed<'_> {
        Directed { features: &self.features, index: &self.direct }
    }
}
