//! Semi-dense depth of a keyframe that has neighbours before and after it.

use crate::depth::{DepthFilter, DepthParams, SeedPoint, StereoFrame, choose_references};
use crate::local_map::{Companion, KeyframeState, LocalMap, median};
use geometry::{GrayImage, Se3};
use map::SemiDense;
use std::sync::Arc;

/// Baselines, over the median depth, at which frames are kept as companions.
const COMPANION_PARALLAX: std::ops::Range<f64> = 0.015..0.1;
/// How much longer the next companion's baseline must be.
const COMPANION_GROWTH: f64 = 1.8;

/// Keeps a frame as companion of a keyframe when its baseline continues the ladder.
pub(crate) fn keep_companion(
    state: &mut KeyframeState,
    image: Arc<GrayImage>,
    camera_from_world: &Se3,
    parallax: f64,
) {
    let least = state.companions.last().map_or(0.0, |c| COMPANION_GROWTH * c.parallax);
    if COMPANION_PARALLAX.contains(&parallax) && parallax >= least {
        let frame_from_keyframe = *camera_from_world * state.camera_from_world.inverse();
        state.companions.push(Companion { image, frame_from_keyframe, parallax });
    }
}

/// Neighbours considered as stereo references.
const NEIGHBOURS: usize = 16;
/// Uncertainty of the epipolar lines from the window's poses, pixels.
const POSE_SIGMA_PX: f32 = 0.2;

/// The semi-dense inverse depth of a keyframe from stereo with its covisible neighbours.
pub(crate) fn semi_dense(map: &LocalMap, keyframe: usize, params: &DepthParams) -> SemiDense {
    let state = &map.keyframes[keyframe];
    let points = map.reference_points(keyframe);
    let mut depths: Vec<f32> = points.iter().map(|p| p.inverse_depth).collect();
    let Some(mean) = median(&mut depths) else { return SemiDense::default() };
    let world_from_keyframe = state.camera_from_world.inverse();
    let neighbours = map.covisible(keyframe).into_iter().take(NEIGHBOURS).map(|(n, _)| {
        let neighbour = &map.keyframes[n];
        (neighbour.pyramid.base(), neighbour.camera_from_world * world_from_keyframe)
    });
    let companions = state.companions.iter().map(|c| (c.image.as_ref(), c.frame_from_keyframe));
    let (images, poses): (Vec<&GrayImage>, Vec<Se3>) = neighbours.chain(companions).unzip();
    let seeds: Vec<SeedPoint> = points
        .iter()
        .map(|p| SeedPoint { pixel: p.pixel, inverse_depth: p.inverse_depth, variance: p.variance })
        .collect();
    let mut filter = DepthFilter::new(state.pyramid.base(), &map.camera, params);
    filter.seed(&seeds);
    for index in choose_references(&poses, mean, &map.camera, params) {
        let image = images[index];
        let reference = StereoFrame {
            image,
            frame_from_keyframe: poses[index],
            brightness: brightness(map, keyframe, image, &poses[index], &seeds),
            pose_sigma_px: POSE_SIGMA_PX,
        };
        filter.update(state.pyramid.base(), &reference);
    }
    filter.regularise();
    filter.to_semi_dense()
}

/// Affine brightness `(a, b)` of a neighbour relative to the keyframe, from the intensities of the points
/// both see: the gain from their median deviations, the offset from their medians.
fn brightness(
    map: &LocalMap,
    keyframe: usize,
    image: &GrayImage,
    frame_from_keyframe: &Se3,
    points: &[SeedPoint],
) -> (f32, f32) {
    let own = map.keyframes[keyframe].pyramid.base();
    let pairs = points.iter().filter_map(|p| {
        let ray = map.camera.unproject(p.pixel[0] as f64, p.pixel[1] as f64);
        let x = frame_from_keyframe.rotation * ray + frame_from_keyframe.translation * p.inverse_depth as f64;
        let at = map.camera.project(&x);
        let visible = x.z > 0.0 && image.contains(at.x as f32, at.y as f32, 0.0);
        (visible && own.contains(p.pixel[0], p.pixel[1], 0.0))
            .then(|| (own.bilinear(p.pixel[0], p.pixel[1]), image.bilinear(at.x as f32, at.y as f32)))
    });
    let (mut a, mut b): (Vec<f32>, Vec<f32>) = pairs.unzip();
    let spread = |values: &mut Vec<f32>| {
        let middle = median(values)?;
        let mut off: Vec<f32> = values.iter().map(|v| (v - middle).abs()).collect();
        Some((middle, median(&mut off)?.max(1.0)))
    };
    let (Some(a), Some(b)) = (spread(&mut a), spread(&mut b)) else { return (0.0, 0.0) };
    let gain = (b.1 / a.1).clamp(0.5, 2.0);
    (gain.ln(), b.0 - gain * a.0)
}
