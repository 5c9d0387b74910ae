//! Semi-dense depth of a keyframe that has neighbours before and after it.

use crate::depth::{DepthFilter, DepthParams, SeedPoint, StereoFrame, choose_references};
use crate::local_map::{Companion, LocalMap};
use crate::mask::Mask;
use geometry::sensor::{Lens, Shift, Twist};
use geometry::{GrayImage, Pinhole, Se3, median};
use map::{SemiDense, Shared};
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
    scale: f64,
    /// What of the image moves with the camera: it has no depth.
    mask: Arc<Mask>,
    /// What is known and stays.
    known: Option<KnownDepth>,
    params: DepthParams,
}

/// Depths that stay up to a distance from the middle of the image.
struct KnownDepth {
    depth: Shared<SemiDense>,
    lens: Lens,
    /// The distance, as a share of the corner's.
    within: f64,
}

/// Pixels beyond what stays that depths are computed of as well: they support their neighbours.
const RIM: f64 = 3.0;

impl KnownDepth {
    /// Whether a pixel lies nearer to the middle, by so many pixels, than the distance up to which depths stay.
    fn holds(&self, x: usize, y: usize, nearer: f64) -> bool {
        let camera = &self.lens.camera;
        let nearer = 2.0 * nearer / (camera.width as f64).hypot(camera.height as f64);
        self.lens.share_of_corner([x as f64, y as f64]) < self.within - nearer
    }

    /// What stays, and beyond it the `fresh` depths.
    fn with(&self, fresh: &SemiDense) -> SemiDense {
        let width = self.lens.camera.width;
        let stays = |pixel: u32| self.holds(pixel as usize % width, pixel as usize / width, 0.0);
        let kept = self.depth.iter().filter(|(pixel, ..)| stays(*pixel));
        let mut all: Vec<_> = kept.chain(fresh.iter().filter(|(pixel, ..)| !stays(*pixel))).collect();
        all.sort_unstable_by_key(|(pixel, ..)| *pixel);
        of_pixels(&all)
    }
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
            motion.fixed_rows_mut::<3>(0).scale_mut(state.scale);
            Reference {
                image: Arc::clone(&companion.image),
                frame_from_keyframe: Se3::new(pose.rotation, pose.translation * state.scale),
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
            scale: state.scale,
            mask: Arc::clone(&map.mask),
            known: None,
            params: params.clone(),
        }
    }

    /// The job of computing the depth again from a distance from the middle on, as a share of the corner's; up to there the
    /// `known` one stays.
    pub fn beyond(self, lens: Lens, distance: f64, known: Shared<SemiDense>) -> Self {
        Self { known: Some(KnownDepth { depth: known, lens, within: distance }), ..self }
    }

    /// The keyframe's semi-dense inverse depth, in the keyframe's unit.
    pub fn run(&self) -> SemiDense {
        let mut filter = DepthFilter::new(&self.image, &self.camera, self.shift, &self.params);
        if let Some(known) = &self.known {
            filter.retain(|[x, y]| !known.holds(x as usize, y as usize, RIM));
        }
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
        let mut depth = filter.to_semi_dense();
        depth.scale(1.0 / self.scale as f32);
        if let Some(known) = &self.known {
            depth = known.with(&depth);
        }
        self.unmasked(depth)
    }

    /// The depths that the mask does not cover.
    fn unmasked(&self, depth: SemiDense) -> SemiDense {
        if self.mask.is_empty() {
            return depth;
        }
        let width = self.image.width();
        let free = |pixel: u32| !self.mask.covers(pixel as usize % width, pixel as usize / width);
        let kept: Vec<_> = depth.iter().filter(|(pixel, ..)| free(*pixel)).collect();
        of_pixels(&kept)
    }

    /// Affine brightness `(a, b)` of a neighbour relative to the keyframe, from the intensities of the points
    /// both see: the gain from their median deviations, the offset from their medians.
    fn brightness(&self, reference: &Reference) -> (f32, f32) {
        let (own, image) = (&self.image, &reference.image);
        let pairs = self.seeds.iter().filter_map(|p| {
            let [dx, dy] = self.shift.to_undistorted(p.pixel, p.inverse_depth);
            let ray = self.camera.unproject((p.pixel[0] + dx) as f64, (p.pixel[1] + dy) as f64);
            let pose = &reference.frame_from_keyframe;
            let x = pose.rotation * ray + pose.translation * p.inverse_depth as f64;
            let at = self.camera.project(&x);
            let at = [at.x as f32, at.y as f32];
            let [dx, dy] = reference.shift.to_distorted(at, p.inverse_depth / x.z as f32);
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

/// The depths of pixels that come with their inverse depths and variances, in order.
fn of_pixels(pixels: &[(u32, f32, f32)]) -> SemiDense {
    SemiDense {
        pixel: pixels.iter().map(|pixel| pixel.0).collect(),
        inverse_depth: pixels.iter().map(|pixel| pixel.1).collect(),
        variance: pixels.iter().map(|pixel| pixel.2).collect(),
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
    fn depth_that_is_computed_again_beyond_a_distance_stays_up_to_there() {
        let views = views();
        let (map, params) = (exact_map(&views, 16), DepthParams::default());
        let again = |known: &SemiDense, beyond: f64| {
            let job = StereoJob::new(&map, 0, &[], &params);
            job.beyond(map.sensor.lens, beyond, known.clone().into()).run()
        };
        let fresh = StereoJob::new(&map, 0, &[], &params).run();
        assert_eq!(again(&SemiDense::default(), 0.0), fresh, "beyond nothing all is computed");
        // What was known is told by its depth, which nothing shows.
        let mut known = fresh.clone();
        known.scale(3.0);
        let (both, width) = (again(&known, 0.6), map.camera.width as u32);
        assert!(both.pixel.windows(2).all(|pair| pair[0] < pair[1]));
        let (mut stayed, mut computed) = (0, 0);
        for (pixel, depth, _) in both.iter() {
            let at = [f64::from(pixel % width), f64::from(pixel / width)];
            let is_known = known.iter().any(|known| (known.0, known.1) == (pixel, depth));
            assert_eq!(is_known, map.sensor.lens.share_of_corner(at) < 0.6, "{at:?}");
            *(if is_known { &mut stayed } else { &mut computed }) += 1;
        }
        let count = |within: bool| {
            let at = |p: u32| [f64::from(p % width), f64::from(p / width)];
            fresh.iter().filter(|d| (map.sensor.lens.share_of_corner(at(d.0)) < 0.6) == within).count()
        };
        assert_eq!(stayed, count(true), "of these nothing is lost");
        assert!(computed.abs_diff(count(false)) * 20 < computed, "{computed} of {}", count(false));
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
