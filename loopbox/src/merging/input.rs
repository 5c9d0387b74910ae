//! A map to be merged, with the features and words of its keyframes.

use super::names::untaken;
use crate::open::open_map_swapped;
use crate::run::find_features;
use anyhow::{Context, Result, bail};
use features::{Features, SiftParams, codec, sift};
use geometry::Swap;
use map::{Keyframe, KeyframeId, Map};
use place_recog::{DirectIndex, Directed, Vocabulary, WordBag, words};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// A map to be merged. Copies share all that is large.
#[derive(Clone)]
pub struct Input {
    /// The file or folder it was given as.
    pub path: PathBuf,
    /// What to call it: its agents' names.
    pub name: String,
    /// The map.
    pub map: Arc<Map>,
    /// The features of its keyframes that have depth.
    pub features: Arc<BTreeMap<KeyframeId, Features>>,
    /// Of how many keyframes they were found now; those of the others were in the map.
    pub found: usize,
    /// Their words.
    pub words: Arc<BTreeMap<KeyframeId, WordBag>>,
    /// Their features by nodes of the vocabulary's tree.
    pub direct: Arc<BTreeMap<KeyframeId, DirectIndex>>,
    /// What is missing from it, for people.
    pub warnings: Vec<String>,
    /// How long it took to get all this.
    pub seconds: InputSeconds,
}

/// Wall-clock seconds to get an input ready.
#[derive(Clone, Copy, Debug, Default)]
pub struct InputSeconds {
    /// Reading the file.
    pub reading: f64,
    /// Features, read or found, and words of all keyframes.
    pub features: f64,
}

impl Input {
    /// Reads a map, a `map.mcap` or the folder that holds it, and finds the features of its keyframes, whose images and
    /// depths `swap` keeps, as far as it has room.
    ///
    /// # Errors
    /// When it cannot be read, or holds nothing that could be merged: no keyframes, or none with depth.
    pub fn load(path: &Path, vocabulary: &Vocabulary, swap: &dyn Swap) -> Result<Self> {
        let start = Instant::now();
        let opened = open_map_swapped(path, swap)?;
        let reading = start.elapsed().as_secs_f64();
        let mut input = Self::of(opened.map, path, vocabulary).map_err(|refused| refused.why)?;
        input.warnings = opened.warnings;
        input.seconds.reading = reading;
        Ok(input)
    }

    /// A map with the features of its keyframes; `path` says where it came from.
    ///
    /// # Errors
    /// When it holds nothing that could be merged, with the map.
    pub fn of(mut map: Map, path: &Path, vocabulary: &Vocabulary) -> Result<Self, Refused> {
        let start = Instant::now();
        let (features, found) = match features_of(&mut map, path) {
            Ok(features) => features,
            Err(why) => return Err(Refused { map: Box::new(map), why }),
        };
        let (words, direct) = words(&features, vocabulary);
        let name = name_of(&map);
        let seconds = InputSeconds { reading: 0.0, features: start.elapsed().as_secs_f64() };
        let (path, warnings) = (path.to_owned(), Vec::new());
        let (map, features) = (Arc::new(map), Arc::new(features));
        let (words, direct) = (Arc::new(words), Arc::new(direct));
        Ok(Self { path, name, map, features, found, words, direct, warnings, seconds })
    }

    /// Calls it by its agents' names, told apart from the inputs before it.
    pub fn name_apart_from(&mut self, before: &[Self]) {
        self.name = untaken(&name_of(&self.map), |name| before.iter().any(|other| other.name == name));
    }

    /// The keyframes as the direct index needs them.
    pub fn directed(&self) -> Directed<'_> {
        Directed { features: &self.features, index: &self.direct }
    }
}

/// What to call a map: its agents' names.
pub(crate) fn name_of(map: &Map) -> String {
    map.agents.values().map(|agent| &*agent.name).collect::<Vec<_>>().join("+")
}

/// A map that cannot be merged.
pub struct Refused {
    /// The map.
    pub map: Box<Map>,
    /// Why not.
    pub why: anyhow::Error,
}

/// The features of every keyframe of a map, in order of the keyframes: those kept in the map, or found now.
///
/// # Errors
/// When features cannot be found in an image.
pub fn features_of_keyframes(map: &Map) -> Result<Vec<Features>> {
    let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
    let features = |keyframe: &&Keyframe| match decoded(keyframe) {
        Some(features) => Ok(features),
        None => Ok(sift(&keyframe.image, &SiftParams::default())?),
    };
    keyframes.par_iter().map(features).collect()
}

/// The features that are kept with a keyframe; nothing where there are none, or none that can be read.
fn decoded(keyframe: &Keyframe) -> Option<Features> {
    codec::decode(keyframe.features.as_deref()?).ok()
}

/// The features of a map's keyframes with depth: those kept in it, and where it has none, or none that can be read, those
/// found now, which it keeps from now on. Says of how many keyframes they were found.
fn kept_features(map: &mut Map) -> (BTreeMap<KeyframeId, Features>, usize) {
    let mut features: BTreeMap<KeyframeId, Features> = map
        .keyframes
        .par_iter_mut()
        .filter(|(_, keyframe)| !keyframe.semi_dense.is_empty())
        .filter_map(|(id, keyframe)| {
            let features = decoded(keyframe);
            if features.is_none() {
                keyframe.features = None;
            }
            Some((*id, features?))
        })
        .collect();
    let found = find_features(map);
    if found > 0 {
        // As they come back from the map, so that it makes no difference when they were found.
        let lacking = map.keyframes.par_iter().filter(|(id, _)| !features.contains_key(id));
        let late: Vec<_> = lacking.filter_map(|(id, keyframe)| Some((*id, decoded(keyframe)?))).collect();
        features.extend(late);
    }
    (features, found)
}

/// The features of a map's keyframes with depth, and of how many they were found.
fn features_of(map: &mut Map, path: &Path) -> Result<(BTreeMap<KeyframeId, Features>, usize)> {
    map.of_cameras().with_context(|| format!("{}: cannot be merged with cameras' maps", path.display()))?;
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
    // Keyframes without depth could be recognised, but nothing could come of it.
    Ok(kept_features(map))
}
