//! Recognising a lost camera by features: the words of its image propose keyframes, the features that it shares with them
//! rank these, and points at the features of the best give its pose.

use crate::describing::described;
use features::{Features, codec};
use geometry::{GrayImage, Pinhole, Sim3};
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use merge::frame_pose::{FramePose, FramePoseParams, SeenBy, frame_pose};
use merge::key_points::{DepthGrid, KeyPointParams, measure};
use merge::scale_filter::MeasuredPoint;
use place_recog::{BowIndex, BowParams, DirectIndex, RankParams, Vocabulary, WordBag, shared_features};
use slam_direct::{Hypothesis, KnownView, Recognise};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes of a fragment that words propose.
const PROPOSED: usize = 24;
/// Those of them with most shared features, whose matches make a pose together.
const MATCHED: usize = 6;
/// Fewest features of an image that is worth seeking; what is covered or blurred has less.
const LEAST_FEATURES: usize = 30;

/// Keyframes that are made ready for an image that does not wait: at 10 ms where their features were found before, and 40 where
/// not.
const IN_TIME: usize = 8;
/// The same for one that waits: some seconds' work. A map of thousands is made ready with as many images.
const WAITED_FOR: usize = 256;

/// Recognises images among the keyframes of a run. What it made of a keyframe is kept.
pub struct Recogniser {
    vocabulary: Arc<Vocabulary>,
    fragments: BTreeMap<usize, Fragment>,
    /// Keyframes that are made ready for one image at most.
    most: usize,
}

/// The keyframes of a fragment.
struct Fragment {
    index: BowIndex,
    keyframes: BTreeMap<KeyframeId, Prepared>,
}

/// A keyframe made ready.
struct Prepared {
    /// By which a keyframe of another map is told that is called alike.
    image: Arc<GrayImage>,
    features: Features,
    words: DirectIndex,
    points: Vec<Option<MeasuredPoint>>,
}

impl Recogniser {
    /// For images that do not wait: fewer keyframes are made ready for each. Of those that are not ready yet, the newest are
    /// sought first, and others with the next images.
    pub fn in_time() -> Self {
        Self { most: IN_TIME, ..Self::default() }
    }

    /// Makes ready what is new among the views; forgets fragments of which there is none.
    fn prepare(&mut self, camera: &Pinhole, views: &[KnownView]) {
        self.fragments.retain(|fragment, _| views.iter().any(|view| view.fragment == *fragment));
        let mut left = self.most;
        for view in views.iter().rev() {
            let fragment = self.fragments.entry(view.fragment).or_insert_with(|| Fragment {
                index: BowIndex::new(Arc::clone(&self.vocabulary), BowParams::default()),
                keyframes: BTreeMap::new(),
            });
            let known = fragment.keyframes.get(&view.keyframe);
            if known.is_some_and(|known| Arc::ptr_eq(&known.image, &view.image)) {
                continue;
            }
            if left == 0 {
                break;
            }
            left -= 1;
            let (prepared, words) = Prepared::new(view, camera, &self.vocabulary);
            fragment.index.add(view.keyframe, &words);
            fragment.keyframes.insert(view.keyframe, prepared);
        }
    }
}

impl Default for Recogniser {
    fn default() -> Self {
        Self { vocabulary: Vocabulary::shipped(), fragments: BTreeMap::new(), most: WAITED_FOR }
    }
}

impl Recognise for Recogniser {
    fn recognise(&mut self, image: &GrayImage, camera: &Pinhole, views: &[KnownView]) -> Vec<Hypothesis> {
        // Whatever this image shows: a covered camera leaves time for it.
        self.prepare(camera, views);
        // As those of keyframes are: written and read.
        let features = codec::decode(&described(image)).unwrap_or_default();
        if features.len() < LEAST_FEATURES {
            return Vec::new();
        }
        let (index, words) = DirectIndex::with_words(&features, &self.vocabulary);
        let seen = DescribedImage { features: &features, index: &index, words: &words };
        let mut found: Vec<(usize, Hypothesis)> = Vec::new();
        for (&number, fragment) in &self.fragments {
            let poses = views.iter().filter(|view| view.fragment == number);
            let poses = poses.map(|view| (view.keyframe, view.world_from_keyframe)).collect();
            found.extend(fragment.hypothesis(number, &seen, camera, &poses));
        }
        found.sort_by_key(|(inliers, _)| std::cmp::Reverse(*inliers));
        found.into_iter().map(|(_, hypothesis)| hypothesis).collect()
    }
}

/// The features and words of an image.
struct DescribedImage<'a> {
    features: &'a Features,
    index: &'a DirectIndex,
    words: &'a WordBag,
}

impl Fragment {
    /// Where in the fragment an image may have been taken, and how many features say so.
    fn hypothesis(
        &self,
        fragment: usize,
        image: &DescribedImage,
        camera: &Pinhole,
        poses: &BTreeMap<KeyframeId, Sim3>,
    ) -> Option<(usize, Hypothesis)> {
        let is_there = |keyframe: KeyframeId| poses.contains_key(&keyframe);
        let proposed = self.index.query_among(image.words, PROPOSED, &is_there);
        let shared = |place: PlaceCandidate| {
            let keyframe = self.keyframes.get(&place.keyframe)?;
            let of_keyframe = (&keyframe.words, &keyframe.features);
            let of_image = (image.index, image.features);
            Some((shared_features(of_keyframe, of_image, &RankParams::default()), place.keyframe))
        };
        let mut ranked: Vec<(usize, KeyframeId)> = proposed.into_iter().filter_map(shared).collect();
        // Stable: of equals the one with more words in common stays first.
        ranked.sort_by_key(|(shared, _)| std::cmp::Reverse(*shared));
        ranked.truncate(MATCHED);
        let seen_by = |id: &KeyframeId| {
            let Prepared { features, points, .. } = self.keyframes.get(id)?;
            Some(SeenBy { features, points, world_from_keyframe: *poses.get(id)? })
        };
        let ids: Vec<KeyframeId> = ranked.into_iter().map(|(_, id)| id).collect();
        let keyframes: Vec<SeenBy> = ids.iter().filter_map(seen_by).collect();
        let FramePose { camera_from_world, inliers, by_keyframe } =
            frame_pose(image.features, camera, &keyframes, &FramePoseParams::default())?;
        let best = (0..ids.len()).rev().max_by_key(|&i| by_keyframe[i])?;
        let keyframe_from_world = poses.get(&ids[best])?.inverse();
        let relative = keyframe_from_world * Sim3::from(camera_from_world.inverse());
        let keyframe_from_frame = geometry::Se3::new(relative.rotation, relative.translation);
        Some((inliers, Hypothesis { fragment, keyframe: ids[best], keyframe_from_frame }))
    }
}

impl Prepared {
    fn new(view: &KnownView, camera: &Pinhole, vocabulary: &Vocabulary) -> (Self, WordBag) {
        let bytes = view.features.clone().unwrap_or_else(|| described(&view.image));
        let features = codec::decode(&bytes).unwrap_or_default();
        let (words, bag) = DirectIndex::with_words(&features, vocabulary);
        let (depth, params) = (DepthGrid::new(&view.semi_dense, camera), KeyPointParams::default());
        let point = |keypoint: &features::Keypoint| measure(keypoint.pixel, &depth, camera, &params);
        let points = features.keypoints.iter().map(point).collect();
        (Self { image: Arc::clone(&view.image), features, words, points }, bag)
    }
}
