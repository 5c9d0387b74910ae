//! Accuracy of a map's depths against depth images: part of `loopbox eval`.

use anyhow::{Context, Result, bail};
use eval::{DepthAccuracy, InverseDepthPair, Trajectory, depth_accuracy, warp_inverse_depth};
use geometry::{Image, Pinhole, Sim3};
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Keyframe, Map, load_map};
use serde::Serialize;
use sources::pictures::read_depth_image;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// Metres per step of a depth image.
const DEPTH_UNIT: f32 = 0.001;
/// A keyframe is compared when the depth image nearest to it is at most so many frames away.
const MAX_FRAME_GAP: u64 = 5;

/// How good and how dense the depths of a map are.
#[derive(Clone, Debug, Serialize)]
pub struct MapDepth {
    /// Keyframes of the map.
    pub keyframes: usize,
    /// Keyframes compared.
    pub keyframes_compared: usize,
    /// Those of them that have a depth image of their own; the others take theirs from the nearest one.
    pub keyframes_with_depth_image: usize,
    /// Pixels with a depth as a share of all, median over the keyframes.
    pub density: f64,
    /// The same for points that are exported: those with a certain enough depth.
    pub exported_density: f64,
    /// Errors of the exported points' inverse depths, one scale for the whole map.
    #[serde(flatten)]
    pub accuracy: DepthAccuracy,
}

impl fmt::Display for MapDepth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let a = &self.accuracy;
        writeln!(
            f,
            "depth       {} points of {} of {} keyframes ({} with a depth image of their own)",
            a.count, self.keyframes_compared, self.keyframes, self.keyframes_with_depth_image
        )?;
        writeln!(f, "  median relative error of inverse depth  {:.3} %", 100.0 * a.median_relative_error)?;
        writeln!(f, "  outliers (> {} %)  {:.2} %", 100.0 * eval::OUTLIER_BOUND, 100.0 * a.outlier_share)?;
        let within = 100.0 * a.within_two_deviations;
        writeln!(
            f,
            "  within two stated standard deviations  {within:.1} % (95.4 % where these are true), NEES: mean {:.2} (1), median {:.2} (0.45)",
            a.mean_nees, a.median_nees
        )?;
        let (all, exported) = (100.0 * self.density, 100.0 * self.exported_density);
        writeln!(f, "  pixels of a keyframe with a depth  {all:.1} %, exported {exported:.1} %")
    }
}

/// Compares the exported points of the map in `path` with the depth images in `folder`. `frames` are the
/// times of the recording's frames, by which depth images and ground truth find each other.
pub fn measure(
    path: &Path,
    folder: &Path,
    frames: &[f64],
    truth: &Trajectory,
    max_diff: f64,
) -> Result<MapDepth> {
    let map = load_map(path)?.map;
    map.of_cameras()?;
    if map.agents.len() > 1 {
        bail!(
            "{}: holds {} agents, and depth images are of one recording; give the map of its run",
            path.display(),
            map.agents.len()
        );
    }
    let images = depth_images(folder)?;
    let mut pairs = Vec::new();
    let (mut compared, mut own) = (0, 0);
    for keyframe in map.keyframes.values() {
        let Some((index, image)) = nearest_image(&images, keyframe.frame_index) else { continue };
        let camera = map.camera(keyframe);
        let mut inverse_depth = read_inverse_depth(image, camera)?;
        if index == keyframe.frame_index {
            own += 1;
        } else {
            let time = frames.get(index as usize).with_context(|| {
                format!("{}: the list of frame times ends before frame {index}", image.display())
            })?;
            let source = truth.pose_at(*time, max_diff);
            let target = truth.pose_at(keyframe.timestamp, max_diff);
            let Some((source, target)) = source.zip(target) else { continue };
            let target_from_source = target.rigid().inverse() * source.rigid();
            inverse_depth = warp_inverse_depth(&inverse_depth, camera, &target_from_source);
        }
        compared += 1;
        pairs.extend(exported(keyframe).filter_map(|(pixel, estimate, deviation)| {
            let truth = *inverse_depth.data().get(pixel as usize)?;
            (truth > 0.0).then_some(InverseDepthPair { estimate, deviation, truth })
        }));
    }
    let Some(accuracy) = depth_accuracy(&pairs) else {
        bail!(
            "{}: of the {} depths of {compared} keyframes near a depth image of {}, none is certain enough to \
             be exported and has a true depth; are both from one recording?",
            path.display(),
            map.keyframes.values().map(|keyframe| keyframe.semi_dense.len()).sum::<usize>(),
            folder.display()
        );
    };
    Ok(MapDepth {
        keyframes: map.keyframes.len(),
        keyframes_compared: compared,
        keyframes_with_depth_image: own,
        density: median_share(&map, |keyframe| keyframe.semi_dense.len()),
        exported_density: median_share(&map, |keyframe| exported(keyframe).count()),
        accuracy,
    })
}

/// `(pixel index, inverse depth, its standard deviation)`, the last two in 1/map unit, of the points that a cloud of the map contains by
/// default.
fn exported(keyframe: &Keyframe) -> impl Iterator<Item = (u32, f32, f32)> + '_ {
    let Sim3 { scale, .. } = keyframe.world_from_keyframe;
    keyframe.semi_dense.iter().filter_map(move |(pixel, inverse_depth, variance)| {
        let certain = variance <= DEFAULT_MAX_RELATIVE_VARIANCE * inverse_depth * inverse_depth;
        let in_map = |value: f32| (f64::from(value) / scale) as f32;
        certain.then_some((pixel, in_map(inverse_depth), in_map(variance.sqrt())))
    })
}

/// The depth images of a folder by frame index.
fn depth_images(folder: &Path) -> Result<BTreeMap<u64, PathBuf>> {
    let unreadable = || format!("{}: the folder of depth images cannot be read", folder.display());
    let mut images = BTreeMap::new();
    for entry in std::fs::read_dir(folder).with_context(unreadable)? {
        let path = entry.with_context(unreadable)?.path();
        let index = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| stem.parse().ok());
        if let (Some(index), Some("png")) = (index, path.extension().and_then(|e| e.to_str())) {
            images.insert(index, path);
        }
    }
    if images.is_empty() {
        bail!("{}: holds no depth image; they are named by frame, as in 000010.png", folder.display());
    }
    Ok(images)
}

/// The depth image nearest to a frame, the earlier of two, if one is near enough.
fn nearest_image(images: &BTreeMap<u64, PathBuf>, frame: u64) -> Option<(u64, &Path)> {
    let before = images.range(..=frame).next_back();
    let after = images.range(frame..).next();
    let (&index, path) = before.into_iter().chain(after).min_by_key(|(index, _)| index.abs_diff(frame))?;
    (index.abs_diff(frame) <= MAX_FRAME_GAP).then_some((index, path.as_path()))
}

/// A depth image as inverse depth, 1/m; 0 where there is none.
fn read_inverse_depth(path: &Path, camera: &Pinhole) -> Result<Image<f32>> {
    let image = read_depth_image(path).map_err(anyhow::Error::msg)?;
    let (width, height) = (image.width(), image.height());
    if (width, height) != (camera.width, camera.height) {
        bail!(
            "{}: is {width}×{height}, the map's keyframes are {}×{}",
            path.display(),
            camera.width,
            camera.height
        );
    }
    let invert = |&depth: &u16| if depth == 0 { 0.0 } else { 1.0 / (f32::from(depth) * DEPTH_UNIT) };
    Image::from_vec(width, height, image.data().iter().map(invert).collect())
        .with_context(|| format!("{}: is cut short", path.display()))
}

/// Median over the keyframes of `count` as a share of the pixels.
fn median_share(map: &Map, count: impl Fn(&Keyframe) -> usize) -> f64 {
    let share = |keyframe: &Keyframe| count(keyframe) as f64 / keyframe.image.data().len() as f64;
    let mut shares: Vec<f64> = map.keyframes.values().map(share).collect();
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use eval::Pose;
    use geometry::{GrayImage, Se3};
    use map::{AgentId, KeyframeId, SemiDense, save_map};
    use std::sync::Arc;

    const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 50.0, fy: 50.0, cx: 31.5, cy: 23.5 };

    /// A keyframe on the optical axis at `z`, before a wall at 4 m, in a unit of `scale` metres; every
    /// tenth depth is 20 % off, every eleventh too uncertain to be exported.
    fn keyframe(frame_index: u64, z: f64, scale: f64) -> Keyframe {
        let pixels = 0..(CAMERA.width * CAMERA.height) as u32;
        let inverse_depth = (scale / (4.0 - z)) as f32;
        Keyframe {
            id: KeyframeId(frame_index as u32),
            agent: AgentId::default(),
            timestamp: frame_index as f64,
            frame_index,
            world_from_keyframe: Sim3::new(Default::default(), [0.0, 0.0, z].into(), scale),
            image: Arc::new(GrayImage::filled(CAMERA.width, CAMERA.height, 0)),
            color: None,
            scan: None,
            semi_dense: SemiDense {
                inverse_depth: pixels
                    .clone()
                    .map(|i| inverse_depth * if i % 10 == 0 { 1.2 } else { 1.0 })
                    .collect(),
                variance: pixels.clone().map(|i| if i % 11 == 0 { 1.0 } else { 1e-6 }).collect(),
                pixel: pixels.collect(),
            }
            .into(),
            points: Vec::new(),
            features: None,
            words: None,
        }
    }

    #[test]
    fn depths_of_a_wall_are_measured_in_own_and_moved_views() {
        let folder = tempfile::tempdir().unwrap();
        let wall = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(64, 48, image::Luma([4000]));
        wall.save(folder.path().join("000000.png")).unwrap();
        let mut map = Map::new(CAMERA);
        for keyframe in [keyframe(0, 0.0, 2.0), keyframe(2, 1.0, 0.5), keyframe(20, 1.0, 1.0)] {
            map.keyframes.insert(keyframe.id, keyframe);
        }
        let path = folder.path().join("map.mcap");
        save_map(&path, &map).unwrap();
        let times: Vec<f64> = (0..21).map(f64::from).collect();
        let pose = |&t: &f64| Pose::from(Se3::new(Default::default(), [0.0, 0.0, 0.5 * t].into()));
        let world_from_camera = times.iter().map(pose).collect();
        let truth = Trajectory { timestamps: Some(times.clone()), world_from_camera };
        let found = measure(&path, folder.path(), &times, &truth, 0.1).unwrap();
        assert_eq!((found.keyframes, found.keyframes_compared, found.keyframes_with_depth_image), (3, 2, 1));
        assert_eq!(found.density, 1.0);
        assert!((found.exported_density - 10.0 / 11.0).abs() < 1e-3);
        assert!((found.accuracy.scale - 1.0).abs() < 1e-5, "{:?}", found.accuracy);
        assert!(found.accuracy.median_relative_error < 1e-5);
        // Moving closer leaves pixels empty, in a pattern that meets the wrong ones a little more often.
        assert!((found.accuracy.outlier_share - 0.1).abs() < 0.02, "{:?}", found.accuracy);
    }

    #[test]
    fn the_nearest_depth_image_is_near() {
        let images: BTreeMap<u64, PathBuf> = [0, 10, 30].map(|i| (i, PathBuf::from(i.to_string()))).into();
        let nearest = |frame| nearest_image(&images, frame).map(|(index, _)| index);
        assert_eq!(nearest(0), Some(0));
        assert_eq!(nearest(5), Some(0));
        assert_eq!(nearest(6), Some(10));
        assert_eq!(nearest(15), Some(10));
        assert_eq!(nearest(20), None);
        assert_eq!(nearest(31), Some(30));
    }
}
