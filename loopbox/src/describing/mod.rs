//! Finds the features of keyframes beside tracking, once for good, in a thread that gives way to all others.
//!
//! What is found of an image depends on the image alone, and at the end of a run all keyframes with depth have theirs:
//! so the map is the same however far the thread came.

pub(crate) mod described;

use features::{SiftParams, codec, sift};
use geometry::{GrayImage, Swap};
use map::{Keyframe, KeyframeId, Map, SharedBytes};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// The priority of the thread as Unix counts it; 0 is that of others, 19 the lowest.
const NICENESS: i32 = 15;

/// The features found of a keyframe. Keyframes of fragments may be called alike: the image, one in all copies of a map,
/// says which it is.
pub struct DescribedKeyframe {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// Its image.
    pub image: Arc<GrayImage>,
    /// Its features as maps keep them.
    pub features: SharedBytes,
}

/// Finds features of keyframes as these come.
pub struct Describer {
    images: Option<Sender<(KeyframeId, Arc<GrayImage>)>>,
    described: Receiver<DescribedKeyframe>,
    /// Nobody waits for the thread any more.
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Describer {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system refuses a thread.
    pub fn start() -> std::io::Result<Self> {
        let (images, waiting) = channel::<(KeyframeId, Arc<GrayImage>)>();
        let (sender, results) = channel();
        let ends = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ends);
        let work = move || {
            lower_priority();
            for (keyframe, image) in waiting {
                if ended.load(Ordering::Relaxed) {
                    return;
                }
                let features = described(&image);
                if sender.send(DescribedKeyframe { keyframe, image, features }).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("features".into()).spawn(work)?;
        Ok(Self { images: Some(images), described: results, ends, thread: Some(thread) })
    }

    /// Asks for the features of a keyframe with depth; later only.
    pub fn ask(&self, keyframe: &Keyframe) {
        if !keyframe.semi_dense.is_empty()
            && let Some(images) = &self.images
        {
            // A thread that broke down leaves its work for the end.
            let _ = images.send((keyframe.id, Arc::clone(&keyframe.image)));
        }
    }

    /// What was found since the last call.
    pub fn described(&self) -> impl Iterator<Item = DescribedKeyframe> + '_ {
        self.described.try_iter()
    }

    /// Ends the thread, and gives all keyframes with depth their features.
    pub fn complete(&mut self, maps: &mut [Map]) {
        self.ends.store(true, Ordering::Relaxed);
        self.images = None;
        if let Some(thread) = self.thread.take() {
            // What it did not find is found now.
            let _ = thread.join();
        }
        for DescribedKeyframe { keyframe, image, features } in self.described.try_iter() {
            let keyframes = maps.iter_mut().filter_map(|map| map.keyframes.get_mut(&keyframe));
            keyframes
                .filter(|keyframe| Arc::ptr_eq(&keyframe.image, &image))
                .for_each(|keyframe| keyframe.features = Some(features.clone()));
        }
        for map in maps {
            complete(map, None);
        }
    }
}

impl Drop for Describer {
    fn drop(&mut self) {
        self.complete(&mut []);
    }
}

/// Finds the features that keyframes with depth do not have yet, which `swap` keeps as far as it has room; says how many
/// keyframes these were.
pub fn complete(map: &mut Map, swap: Option<&dyn Swap>) -> usize {
    let lacks = |keyframe: &&mut Keyframe| keyframe.features.is_none() && !keyframe.semi_dense.is_empty();
    let lacking: Vec<&mut Keyframe> = map.keyframes.values_mut().filter(lacks).collect();
    let count = lacking.len();
    lacking.into_par_iter().for_each(|keyframe| {
        let mut features = described(&keyframe.image);
        swap.into_iter().for_each(|swap| features.swap_out(swap));
        keyframe.features = Some(features);
        keyframe.image.rest();
    });
    count
}

/// Finds the features of an image. Images of maps have pixels; one without would have no features.
pub(crate) fn described(image: &GrayImage) -> SharedBytes {
    codec::encode(&sift(image, &SiftParams::default()).unwrap_or_default()).into()
}

/// Lets all other threads go first. Where the system does not know priorities of threads, they are equal.
pub(crate) fn lower_priority() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::setpriority_process(None, NICENESS);
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pinhole;
    use loopbox_tests::Texture;
    use map::{KeyframeId, SemiDense};

    /// A map of keyframes that see different parts of a texture; every third has no depth.
    fn map(count: u32) -> Map {
        let (width, height) = (160, 120);
        let texture = Texture::procedural(5);
        let keyframe = |id: u32| {
            let pixel = |i: usize| {
                texture.sample((i % width + 90 * id as usize) as f32, (i / width) as f32, 1.0) as u8
            };
            let image = GrayImage::from_vec(width, height, (0..width * height).map(pixel).collect());
            let depth = SemiDense {
                pixel: vec![5].into(),
                inverse_depth: vec![1.0].into(),
                variance: vec![0.1].into(),
            };
            let (image, pose) = (Arc::new(image.expect("so many pixels")), geometry::Sim3::identity());
            Keyframe {
                semi_dense: if id % 3 == 2 { SemiDense::default() } else { depth }.into(),
                ..Keyframe::of_image(KeyframeId(id), f64::from(id), u64::from(id), pose, image)
            }
        };
        let mut map = Map::new(Pinhole { width, height, fx: 100.0, fy: 100.0, cx: 79.5, cy: 59.5 });
        map.keyframes = (0..count).map(|id| (KeyframeId(id), keyframe(id))).collect();
        map
    }

    #[test]
    fn all_keyframes_with_depth_have_the_same_features_in_whatever_thread() {
        let (mut at_once, mut in_background) = (map(6), map(6));
        assert_eq!((complete(&mut at_once, None), complete(&mut at_once, None)), (4, 0));
        let mut describer = Describer::start().expect("a thread");
        [0, 1, 2].iter().for_each(|id| describer.ask(&in_background.keyframes[&KeyframeId(*id)]));
        let first = loop {
            match describer.described().next() {
                Some(found) => break found,
                None => std::thread::yield_now(),
            }
        };
        assert_eq!(first.keyframe, KeyframeId(0));
        assert!(Arc::ptr_eq(&first.image, &in_background.keyframes[&first.keyframe].image));
        in_background
            .keyframes
            .entry(first.keyframe)
            .and_modify(|keyframe| keyframe.features = Some(first.features));
        assert_eq!(in_background.keyframes[&KeyframeId(0)], at_once.keyframes[&KeyframeId(0)]);
        describer.complete(std::slice::from_mut(&mut in_background));
        assert!(in_background == at_once);
        let found = at_once.keyframes.values().filter_map(|keyframe| keyframe.features.as_deref());
        assert!(found.clone().count() == 4);
        found.for_each(|bytes| assert!(codec::decode(bytes).expect("features").len() > 20));
    }
}
