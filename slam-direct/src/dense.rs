//! Semi-dense depth of a keyframe that has neighbours before and after it.

use crate::depth::{DepthFilter, DepthParams, SeedPoint, StereoFrame, choose_references};
use crate::local_map::{Companion, LocalMap};
use crate::mask::Mask;
use geometry::sensor::{Shift, Twist};
use geometry::{GrayImage, Pinhole, Se3, median};
use map::SemiDense;
use std::sync::Arc;

/// Baselines, over the median depth, at which frames are kept as companions.
const COMPANION_PARALLAX: std::ops::Range<f64> = 0.015..0.1;
/// How much longer the next companion's baseline must be.
const COMPANION_GROWTH: f64 = 1.8;

/// Keeps a frame as companion of a keyframe when its baseline continues the ladder.
///
/// `frame_from_keyframe` and the frame's `motion` have their translations in the keyframe's unit.
pub(crate) fn keep_companion(
    companions: &mut Vec<Companion>,
    image: Arc<GrayImage>,
    frame_from_keyframe: Se3,
    motion: Twist,
    parallax: f64,
) {
    let least = companions.last().map_or(0.0, |c| COMPANION_GROWTH * c.parallax);
    if COMPANION_PARALLAX.contains(&parallax) && parallax >= least {
        companions.push(Companion { image, frame_from_keyframe, motion, parallax });
    }
}

/// Neighbours considered as stereo references.
const NEIGHBOURS: usize = 16;
/// Uncertainty of the epipolar lines from the window's poses, pixels.
const POSE_SIGMA_PX: f32 = 0.2;

/// A frame to find a keyframe's pixels in.
#[derive(Clone)]
struct Reference {
    image: Arc<GrayImage>,
    /// World units.
    frame_from_keyframe: Se3,
    /// How far the image is off an ideal camera's.
    shift: Shift,
}

/// All that the semi-dense depth of one keyframe is computed from, owned, so that it can be computed beside
/// the tracking.
pub(crate) struct StereoJob {
    camera: Pinhole,
    image: Arc<GrayImage>,
    /// How far the image is off an ideal camera's.
    shift: Shift,
    seeds: Vec<SeedPoint>,
    /// References in the order of their use.
    references: Vec<Reference>,
    /// World units per unit of the keyframe.
    unit: f64,
    /// What of the image moves with the camera: it has no depth.
    mask: Arc<Mask>,
    params: DepthParams,
}

impl StereoJob {
    /// Gathers a keyframe's points and its references among covisible keyframes and companions.
    pub fn new(map: &LocalMap, keyframe: usize, companions: &[Companion], params: &DepthParams) -> Self {
        let state = &map.keyframes[keyframe];
        let points = map.reference_points(keyframe);
        let mut depths: Vec<f32> = points.iter().map(|p| p.inverse_depth).collect();
        let mean = median(&mut depths).unwrap_or(1.0);
        let shift = |motion: &Twist| match map.sensor.is_ideal() {
            true => Shift::none(map.camera),
            false => Shift::new(&map.sensor, motion),
        };
        let world_from_keyframe = state.camera_from_world.inverse();
        let neighbours = map.covisible(keyframe).into_iter().take(NEIGHBOURS).map(|(n, _)| {
            let neighbour = &map.keyframes[n];
            Reference {
                image: neighbour.pyramid.shared_base(),
                frame_from_keyframe: neighbour.camera_from_world * world_from_keyframe,
                shift: shift(&neighbour.motion_in_world()),
            }
        });
        let companions = companions.iter().map(|companion| {
            let (pose, mut motion) = (companion.frame_from_keyframe, companion.motion);
            motion.fixed_rows_mut::<3>(0).scale_mut(state.unit);
            Reference {
                image: Arc::clone(&companion.image),
                frame_from_keyframe: Se3::new(pose.rotation, pose.translation * state.unit),
                shift: shift(&motion),
            }
        });
        let candidates: Vec<Reference> = neighbours.chain(companions).collect();
        let poses: Vec<Se3> = candidates.iter().map(|c| c.frame_from_keyframe).collect();
        let chosen = choose_references(&poses, mean, &map.camera, params);
        Self {
            camera: map.camera,
            image: state.pyramid.shared_base(),
            shift: shift(&state.motion_in_world()),
            seeds: points
                .iter()
                .map(|p| SeedPoint { pixel: p.pixel, inverse_depth: p.inverse_depth, variance: p.variance })
                .collect(),
            references: chosen.into_iter().map(|i| candidates[i].clone()).collect(),
            unit: state.unit,
            mask: Arc::clone(&map.mask),
            params: params.clone(),
        }
    }

    /// The keyframe's semi-dense inverse depth, in the keyframe's unit.
    pub fn run(&self) -> SemiDense {
        let mut filter = DepthFilter::new(&self.image, &self.camera, self.shift, &self.params);
        filter.seed(&self.seeds);
        for reference in &self.references {
            let frame = StereoFrame {
                image: &reference.image,
                frame_from_keyframe: reference.frame_from_keyframe,
                brightness: self.brightness(reference),
                pose_sigma_px: POSE_SIGMA_PX,
                shift: reference.shift,
            };
            filter.update(&self.image, &frame);
        }
        filter.regularise();
        let mut depth = self.unmasked(filter.to_semi_dense());
        depth.scale(1.0 / self.unit as f32);
        depth
    }

    /// The depths that the mask does not cover.
    fn unmasked(&self, depth: SemiDense) -> SemiDense {
        if self.mask.is_empty() {
            return depth;
        }
        let width = self.image.width();
        let free = |pixel: u32| !self.mask.covers(pixel as usize % width, pixel as usize / width);
        let kept: Vec<_> = depth.iter().filter(|(pixel, ..)| free(*pixel)).collect();
        SemiDense {
            pixel: kept.iter().map(|kept| kept.0).collect(),
            inverse_depth: kept.iter().map(|kept| kept.1).collect(),
            variance: kept.iter().map(|kept| kept.2).collect(),
        }
    }

    /// Affine brightness `(a, b)` of a neighbour relative to the keyframe, from the intensities of the points
    /// both see: the gain from their median deviations, the offset from their medians.
    fn brightness(&self, reference: &Reference) -> (f32, f32) {
        let (own, image) = (&self.image, &reference.image);
        let pairs = self.seeds.iter().filter_map(|p| {
            let [dx, dy] = self.shift.to_ideal(p.pixel, p.inverse_depth);
            let ray = self.camera.unproject((p.pixel[0] + dx) as f64, (p.pixel[1] + dy) as f64);
            let pose = &reference.frame_from_keyframe;
            let x = pose.rotation * ray + pose.translation * p.inverse_depth as f64;
            let at = self.camera.project(&x);
            let at = [at.x as f32, at.y as f32];
            let [dx, dy] = reference.shift.to_shown(at, p.inverse_depth / x.z as f32);
            let at = [at[0] + dx, at[1] + dy];
            let visible = x.z > 0.0 && image.contains(at[0], at[1], 0.0);
            (visible && own.contains(p.pixel[0], p.pixel[1], 0.0))
                .then(|| (own.bilinear(p.pixel[0], p.pixel[1]), image.bilinear(at[0], at[1])))
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{View, bare_map, brightened, exact_map, pose, quantile};

    fn views() -> Vec<View> {
        [(0.0, 0.0), (0.2, 0.0), (-0.25, 0.05), (0.4, 0.1), (-0.5, 0.0)]
            .iter()
            .map(|&(x, z)| View::new(pose(x, 0.0, z, 0.0, 0.0)))
            .collect()
    }

    #[test]
    fn depth_is_dense_and_right() {
        let views = views();
        let map = exact_map(&views, 16);
        let depth = StereoJob::new(&map, 0, &[], &DepthParams::default()).run();
        assert!(depth.len() > 5000, "{} pixels", depth.len());
        let truth = views[0].inverse_depth.data();
        let errors: Vec<f64> =
            depth.iter().map(|(p, d, _)| (d as f64 / truth[p as usize] as f64 - 1.0).abs()).collect();
        let median = quantile(errors, 0.5);
        assert!(median < 0.02, "{median}");
    }

    #[test]
    fn a_keyframe_without_points_has_no_depth() {
        assert!(StereoJob::new(&bare_map(&views()[..2]), 0, &[], &DepthParams::default()).run().is_empty());
    }

    #[test]
    fn brightness_between_keyframes_is_found() {
        let views = views();
        let map = exact_map(&views, 12);
        let mut job = StereoJob::new(&map, 0, &[], &DepthParams::default());
        let image = views[1].pyramid.base();
        let reference = |image: GrayImage| Reference {
            image: Arc::new(image),
            frame_from_keyframe: views[0].to(&views[1]),
            shift: job.shift,
        };
        let (plain, bright) = (reference(image.clone()), reference(brightened(image, 0.7, 25.0)));
        let (a, b) = job.brightness(&bright);
        assert!((a.exp() / 0.7 - 1.0).abs() < 0.08 && (b - 25.0).abs() < 8.0, "{} {b}", a.exp());
        job.seeds.clear();
        assert_eq!(job.brightness(&plain), (0.0, 0.0));
    }

    #[test]
    fn companions_climb_a_ladder_of_baselines() {
        let view = View::new(pose(0.0, 0.0, 0.0, 0.0, 0.0));
        let mut companions = Vec::new();
        let expected = pose(0.2, 0.0, 0.0, 0.05, 0.0).inverse() * view.world_from_camera;
        for parallax in [0.001, 0.014, 0.02, 0.021, 0.03, 0.037, 0.05, 0.09, 0.4] {
            keep_companion(&mut companions, view.pyramid.shared_base(), expected, Twist::zeros(), parallax);
        }
        let kept: Vec<f64> = companions.iter().map(|c| c.parallax).collect();
        assert_eq!(kept, [0.02, 0.037, 0.09]);
        assert_eq!(companions[0].frame_from_keyframe, expected);
    }
}
