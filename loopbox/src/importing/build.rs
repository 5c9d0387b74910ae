//! Keyframes of posed images.

use anyhow::{Result, bail};
use geometry::{Camera, Crop, GrayImage, Image, Pinhole, Se3, Sim3, Undistorter};
use map::{Color, Edge, FramePose, Keyframe, KeyframeId, SemiDense};
use slam_direct::{DepthParams, candidate_pixels};
use std::collections::BTreeMap;
use std::path::Path;

/// What a map is made of.
pub(super) struct Built {
    pub camera: Pinhole,
    pub keyframes: BTreeMap<KeyframeId, Keyframe>,
    pub edges: Vec<Edge>,
    pub warnings: Vec<String>,
}

/// An image with its pose, before it is read.
pub(super) struct Posed<'a> {
    /// Its place among the keyframes.
    pub index: usize,
    /// Seconds.
    pub timestamp: f64,
    /// Which image of the folder it is, from 0.
    pub frame_index: u64,
    pub image: &'a Path,
    pub world_from_camera: Se3,
}

/// How far the poses of successive keyframes may be off: translation in parts of the median depth, rotation in radians,
/// scale in parts; what merging allows neighbouring keyframes of our own maps.
const DEVIATIONS: [f64; 3] = [0.01, 0.005, 0.01];

/// A grey image that has the camera's size and the lens taken out, and its colours if it has some.
pub(super) fn undistorted(path: &Path, undistorter: &Undistorter) -> Result<(GrayImage, Option<Color>)> {
    let picture = sources::pictures::Picture::File(path.to_owned());
    let (image, color) = picture.into_grey_and_color().map_err(anyhow::Error::msg)?;
    let color = color.and_then(|color| {
        let (luma, planes) = color.planes()?;
        let [blue, red] = planes.map(|plane| undistorter.undistort(&plane).ok());
        Color::of_planes(luma, [&blue?, &red?])
    });
    match undistorter.undistort(&image) {
        Ok(image) => Ok((image, color)),
        Err(problem) => bail!("{}: {problem}", path.display()),
    }
}

/// The pinhole and the way to it for a camera; `pinhole` is the one to make where it is given.
pub(super) fn undistorter(camera: &Camera, pinhole: Option<Pinhole>) -> Result<Undistorter> {
    Ok(Undistorter::new(camera, pinhole.map_or(Crop::Valid, Crop::Explicit))?)
}

/// A keyframe without depth.
pub(super) fn keyframe(posed: &Posed, (image, color): (GrayImage, Option<Color>)) -> Keyframe {
    let (id, pose) = (KeyframeId(posed.index as u32), Sim3::from(posed.world_from_camera));
    Keyframe { color, ..Keyframe::of_image(id, posed.timestamp, posed.frame_index, pose, image.into()) }
}

/// The depths of a depth image where the image has contrast, as a map has them. `distance` is that along the optical axis
/// of a pixel of the undistorted image, `None` where there is none; `deviation` the standard deviation of such an inverse
/// depth.
pub(crate) fn semi_dense(
    image: &GrayImage,
    valid: &Image<bool>,
    distance: impl Fn(usize, usize) -> Option<f64>,
    deviation: impl Fn(f64) -> f64,
) -> SemiDense {
    let mut depths = SemiDense::default();
    for pixel in candidate_pixels(image, &DepthParams::default()) {
        let (x, y) = (pixel as usize % image.width(), pixel as usize / image.width());
        if let Some(distance) = distance(x, y).filter(|_| valid.get(x, y)) {
            let inverse_depth = distance.recip();
            depths.pixel.push(pixel);
            depths.inverse_depth.push(inverse_depth as f32);
            depths.variance.push(deviation(inverse_depth).powi(2) as f32);
        }
    }
    depths
}

/// Edges from each keyframe to the next, as their poses have it.
pub(super) fn chain(keyframes: &BTreeMap<KeyframeId, Keyframe>) -> Vec<Edge> {
    let mut median = 1.0;
    keyframes
        .values()
        .zip(keyframes.values().skip(1))
        .map(|(from, to)| {
            // Without depth of its own a keyframe is as far from what it sees as the one before.
            median = from.semi_dense.median_depth().unwrap_or(median);
            let [translation, rotation, scale] = DEVIATIONS;
            Edge::odometry(from, to, [translation * median, rotation, scale])
        })
        .collect()
}

/// The frame of a keyframe.
pub(super) fn frame(keyframe: &Keyframe) -> FramePose {
    FramePose {
        timestamp: keyframe.timestamp,
        frame_index: keyframe.frame_index,
        reference: keyframe.id,
        keyframe_from_frame: Se3::identity(),
    }
}
