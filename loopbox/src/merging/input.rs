//! A map to be merged, with the features and words of its keyframes.

use crate::open::open_map;
use anyhow::{Context, Result, bail};
use geometry::GrayImage;
use map::{KeyframeId, Map};
use place_recog::features::{Features, SiftParams, sift};
use place_recog::{DirectIndex, Directed, Vocabulary, WordBag, words};
use rayon::prelude::*;
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
        let opened = open_map(path)?;
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
    pub fn of(map: Map, path: &Path, vocabulary: &Vocabulary) -> Result<Self, Refused> {
        let start = Instant::now();
        let features = match features_of(&map, path) {
            Ok(features) => features,
            Err(why) => return Err(Refused { map: Box::new(map), why }),
        };
        let (words, direct) = words(&features, vocabulary);
        let name = map.agents.values().map(|agent| &*agent.name).collect::<Vec<_>>().join("+");
        let seconds = InputSeconds { reading: 0.0, features: start.elapsed().as_secs_f64() };
        Ok(Self { path: path.to_owned(), name, map, features, words, direct, warnings: Vec::new(), seconds })
    }

    /// The keyframes as the direct index needs them.
    pub fn directed(&self) -> Directed<'_> {
        Directed { features: &self.features, index: &self.direct }
    }
}

/// A map that cannot be merged.
pub struct Refused {
    /// The map.
    pub map: Box<Map>,
    /// Why not.
    pub why: anyhow::Error,
}

/// The features of every keyframe of a map, in order of the keyframes.
///
/// # Errors
/// When features cannot be found in an image.
pub fn features_of_keyframes(map: &Map) -> Result<Vec<Features>> {
    let images: Vec<&GrayImage> = map.keyframes.values().map(|keyframe| &*keyframe.image).collect();
    let params = SiftParams::default();
    images.into_par_iter().map(|image| Ok(sift(image, &params)?)).collect()
}

/// The features of a map's keyframes with depth.
fn features_of(map: &Map, path: &Path) -> Result<BTreeMap<KeyframeId, Features>> {
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
    let found = features_of_keyframes(map)?;
    // Keyframes without depth could be recognised, but nothing could come of it.
    let with_depth =
        map.keyframes.values().zip(found).filter(|(keyframe, _)| !keyframe.semi_dense.is_empty());
    Ok(with_depth.map(|(keyframe, features)| (keyframe.id, features)).collect())
}
