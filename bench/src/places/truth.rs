//! The keyframes of sequences, with their words and what they see by the true poses.

use anyhow::{Context, Result};
use eval::{DEFAULT_MAX_DIFF, read_trajectory};
use map::{Keyframe, KeyframeId, load_map};
use measuring::views::{View, metres_per_unit};
use place_recog::features::{Features, SiftParams, sift};
use place_recog::{DirectIndex, RankParams, Vocabulary, WordBag, shared_features};
use rayon::prelude::*;
use std::path::Path;

/// A keyframe with its words, features and true view.
pub struct TrueKeyframe {
    pub id: KeyframeId,
    pub words: WordBag,
    features: Features,
    direct: DirectIndex,
    view: View,
}

impl TrueKeyframe {
    /// The share, 0–1, of the features of the keyframe that has fewer, that both share.
    pub fn shared(&self, other: &Self) -> f32 {
        let params = RankParams::default();
        let count =
            shared_features((&self.direct, &self.features), (&other.direct, &other.features), &params);
        count as f32 / self.features.len().min(other.features.len()).max(1) as f32
    }
}

/// The keyframes of one map.
pub struct Sequence {
    pub name: String,
    /// In order of time; those without a true pose are left out.
    pub keyframes: Vec<TrueKeyframe>,
}

impl Sequence {
    /// Reads the file `map` of a run, and the true poses of the sequence in `data`.
    pub fn read(name: &str, data: &Path, map: &Path, vocabulary: &Vocabulary) -> Result<Self> {
        let map = load_map(map)?.map;
        let truth = read_trajectory(&data.join("groundtruth.txt"))?;
        let metres =
            metres_per_unit(&map, &truth).with_context(|| format!("{name}: the map has no scale"))?;
        let seen = |keyframe: &Keyframe| {
            let Some(pose) = truth.pose_at(keyframe.timestamp, DEFAULT_MAX_DIFF) else { return Ok(None) };
            let features = sift(&keyframe.image, &SiftParams::default())?;
            let (direct, words) = DirectIndex::with_words(&features, vocabulary);
            let view = View::new(keyframe, map.camera(keyframe), pose.rigid(), metres);
            Ok(Some(TrueKeyframe { id: keyframe.id, words, features, direct, view }))
        };
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let seen: Result<Vec<Option<TrueKeyframe>>> = keyframes.into_par_iter().map(seen).collect();
        Ok(Self { name: name.to_owned(), keyframes: seen?.into_iter().flatten().collect() })
    }

    /// Whether two sequences were recorded in one world.
    pub fn shares_world(&self, other: &Self) -> bool {
        measuring::share_world(&self.name, &other.name)
    }

    /// The share of points, 0–1, that a keyframe of this sequence and one of another have in common.
    pub fn overlap(&self, keyframe: usize, other: &Self, other_keyframe: usize) -> f64 {
        if !self.shares_world(other) {
            return 0.0;
        }
        self.keyframes[keyframe].view.overlap(&other.keyframes[other_keyframe].view)
    }
}
