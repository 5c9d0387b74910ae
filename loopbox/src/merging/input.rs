//! A map to be merged, with the features and words of its keyframes.

use crate::common_map::names::{name_of, untaken};
use crate::describing::described::{Described, decoded};
use crate::open::open_map_swapped;
use anyhow::{Context, Result, bail};
use features::{Features, SiftParams, sift};
use geometry::Swap;
use map::{Keyframe, KeyframeId, Map};
use place_recog::{DirectIndex, Directed, KeyframeFeatures, Vocabulary, WordBag, words};
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
    pub features: Arc<KeyframeFeatures>,
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
    /// Reads a map, a `map.mcap` or the folder that holds it, and finds the features of its keyframes. `swap` keeps images,
    /// depths, features and words, as far as it has room.
    ///
    /// # Errors
    /// When it cannot be read, or holds nothing that could be merged: no keyframes, or none with depth.
    pub fn load(path: &Path, vocabulary: &Vocabulary, swap: &dyn Swap) -> Result<Self> {
        let start = Instant::now();
        let opened = open_map_swapped(path, swap)?;
        let reading = start.elapsed().as_secs_f64();
        let mut input =
            Self::described(opened.map, path, vocabulary, Some(swap)).map_err(|refused| refused.why)?;
        input.rest();
        input.warnings = opened.warnings;
        input.seconds.reading = reading;
        Ok(input)
    }

    /// A map with the features of its keyframes; `path` says where it came from.
    ///
    /// # Errors
    /// When it holds nothing that could be merged, with the map.
    pub fn of(map: Map, path: &Path, vocabulary: &Vocabulary) -> Result<Self, Refused> {
        Self::described(map, path, vocabulary, None)
    }

    /// [`of`](Self::of) a map of which `swap` keeps the direct index, and the features and words that are found now, as far as
    /// it has room.
    fn described(
        mut map: Map,
        path: &Path,
        vocabulary: &Vocabulary,
        swap: Option<&dyn Swap>,
    ) -> Result<Self, Refused> {
        let start = Instant::now();
        if let Err(why) = can_be_merged(&map, path) {
            return Err(Refused { map: Box::new(map), why });
        }
        let Described { features, words: of_features, found } = Described::of(&mut map, vocabulary, swap);
        let (words, mut direct) = words(&of_features, vocabulary);
        swap.into_iter().for_each(|swap| direct.values_mut().for_each(|index| index.swap_out(swap)));
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

    /// Gives back the memory of what is swapped out, until it is looked at again.
    pub fn rest(&self) {
        self.map.rest();
        self.direct.values().for_each(DirectIndex::rest);
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

/// Whether a map can be merged with cameras' maps.
fn can_be_merged(map: &Map, path: &Path) -> Result<()> {
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
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Sim3};
    use loopbox_tests::Texture;
    use map::{AgentInfo, SemiDense};

    /// Two keyframes that show parts of a texture, with depth.
    fn map() -> Map {
        let camera = Pinhole { width: 160, height: 120, fx: 100.0, fy: 100.0, cx: 79.5, cy: 59.5 };
        let mut map = Map::new(camera);
        map.agents.values_mut().for_each(|agent: &mut AgentInfo| agent.name = "one".into());
        let texture = Texture::procedural(3);
        for i in 0..2 {
            let pixel = |p: usize| texture.sample((p % 160 + 40 * i) as f32, (p / 160) as f32, 1.0) as u8;
            let image = GrayImage::from_vec(160, 120, (0..160 * 120).map(pixel).collect()).unwrap();
            let id = KeyframeId(i as u32);
            let mut keyframe = Keyframe::of_image(id, i as f64, i as u64, Sim3::identity(), image.into());
            let depth = SemiDense {
                pixel: vec![500].into(),
                inverse_depth: vec![1.0].into(),
                variance: vec![0.1].into(),
            };
            keyframe.semi_dense = depth.into();
            map.keyframes.insert(id, keyframe);
        }
        map
    }

    fn input(map: Map) -> Input {
        Input::of(map, Path::new("map.mcap"), &Vocabulary::shipped())
            .unwrap_or_else(|e| panic!("{:#}", e.why))
    }

    #[test]
    fn what_was_looked_up_stays_with_the_map_and_comes_to_the_same() {
        let first = input(map());
        assert_eq!(first.found, 2);
        assert!(first.map.keyframes.values().all(|keyframe| keyframe.words.is_some()));
        let mut without = (*first.map).clone();
        without.keyframes.values_mut().for_each(|keyframe| keyframe.words = None);
        let mut damaged = (*first.map).clone();
        damaged.keyframes.values_mut().for_each(|keyframe| keyframe.words = Some(vec![1, 2, 3].into()));
        for again in [(*first.map).clone(), without, damaged].map(input) {
            assert_eq!((again.found, &again.words, &again.direct), (0, &first.words, &first.direct));
            assert_eq!(again.map, first.map);
            assert!(again.features.keyframes().all(|id| again.features.get(id) == first.features.get(id)));
        }
    }

    #[test]
    fn features_that_cannot_be_read_are_found_anew() {
        let first = input(map());
        let mut damaged = (*first.map).clone();
        for keyframe in damaged.keyframes.values_mut() {
            (keyframe.features, keyframe.words) = (Some(vec![77].into()), None);
        }
        let again = input(damaged);
        assert_eq!((again.found, &again.map), (2, &first.map));
    }
}
