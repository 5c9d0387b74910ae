//! The pose of one image in a map, by the features that it shares with keyframes.
//!
//! What keyframes around a place know of their key points' depth makes points of the map; where the image shows them, three
//! give its pose ([`geometry::pnp`]), and the pose that most of the others agree with is proposed. It bears what direct
//! tracking does not: another side, another distance, a rolled camera. It is a proposal: among alike places some matches
//! agree by chance, so whoever takes it up looks at the image again.

use crate::matching::{MatchParams, match_features};
use crate::scale_filter::MeasuredPoint;
use geometry::pnp::{Consensus, Sighting, pose_by_consensus};
use geometry::{Pinhole, Se3, Sim3};
use place_recog::features::Features;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How the pose of an image is found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FramePoseParams {
    /// How features are matched.
    pub matching: MatchParams,
    /// Largest distance of a feature from where the pose has its point, in focal lengths. Default 0.01; above 0. Depths that
    /// were measured from the keyframe's side are seen from another one, where their errors show: a relative error of 2 % seen
    /// under 30° is a hundredth.
    pub max_error: f64,
    /// Triples of matches that are tried at most. Default 2000; at least 1. With a fifth of the matches right, 860 are enough
    /// to draw three of these with a probability of 99.9 %.
    pub max_samples: usize,
    /// Fewest features that must agree. Default 12; at least 4. With an error of 0.01 focal lengths, a wrong pose agrees with
    /// one of a thousand wrong matches beyond the three that it was made of.
    #[serde(rename = "min_agreeing")]
    pub min_inliers: usize,
}

impl Default for FramePoseParams {
    fn default() -> Self {
        Self { matching: MatchParams::default(), max_error: 0.01, max_samples: 2000, min_inliers: 12 }
    }
}

/// A keyframe that may show what the image shows.
#[derive(Clone, Copy)]
pub struct SeenBy<'a> {
    /// Its features.
    pub features: &'a Features,
    /// The points at them, in its camera frame and unit, where it has depth.
    pub points: &'a [Option<MeasuredPoint>],
    /// Its pose and unit.
    pub world_from_keyframe: Sim3,
}

/// The pose of an image, and what it rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct FramePose {
    /// The pose, in the unit of the world.
    pub camera_from_world: Se3,
    /// Features of the image that agree; one that several keyframes show counts once.
    pub inliers: usize,
    /// Matches that agree with it of each keyframe.
    pub by_keyframe: Vec<usize>,
}

/// The pose that most matches of an image's features with those of some keyframes agree with; `None` when too few do.
pub fn frame_pose(
    image: &Features,
    camera: &Pinhole,
    keyframes: &[SeenBy],
    params: &FramePoseParams,
) -> Option<FramePose> {
    let (mut sightings, mut of) = (Vec::new(), Vec::new());
    for (index, keyframe) in keyframes.iter().enumerate() {
        for found in match_features(image, keyframe.features, &params.matching) {
            let Some(Some(point)) = keyframe.points.get(found.target as usize) else { continue };
            let [x, y] = image.keypoints[found.source as usize].pixel.map(f64::from);
            let point = keyframe.world_from_keyframe * point.position;
            sightings.push(Sighting { point, ray: camera.unproject(x, y) });
            of.push((index, found.source));
        }
    }
    let consensus = Consensus {
        max_error: params.max_error,
        max_samples: params.max_samples,
        min_inliers: params.min_inliers,
    };
    let (camera_from_world, agree) = pose_by_consensus(&sightings, &consensus)?;
    let inliers = agree.iter().map(|&i| of[i].1).collect::<BTreeSet<u32>>().len();
    let mut by_keyframe = vec![0; keyframes.len()];
    agree.iter().for_each(|&i| by_keyframe[of[i].0] += 1);
    (inliers >= params.min_inliers).then_some(FramePose { camera_from_world, inliers, by_keyframe })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3, Vector6};
    use place_recog::features::{Descriptor, Keypoint};

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 420.0, cx: 319.5, cy: 239.5 };

    /// A descriptor that is like no other.
    fn descriptor(number: u64) -> Descriptor {
        let mut random = geometry::Random::new(number);
        std::array::from_fn(|_| random.below(32) as u8)
    }

    /// Points four to six metres ahead of the world's origin.
    fn world(count: u64) -> Vec<Vector3<f64>> {
        let part = |i: u64, of: u64| (i * of % 97) as f64 / 97.0 - 0.5;
        (0..count)
            .map(|i| Vector3::new(6.0 * part(i, 31), 4.0 * part(i, 57), 5.0 + 2.0 * part(i, 71)))
            .collect()
    }

    /// What a camera sees of the points: features called by the points' numbers, and the points in its frame.
    fn seen(
        points: &[Vector3<f64>],
        camera_from_world: &Se3,
        name: impl Fn(u64) -> u64,
    ) -> (Features, Vec<Option<MeasuredPoint>>) {
        let (mut features, mut measured) = (Features::default(), Vec::new());
        for (i, point) in points.iter().enumerate() {
            let position = *camera_from_world * *point;
            let pixel = CAMERA.project(&position);
            if position.z < 0.1 || !(0.0..640.0).contains(&pixel.x) || !(0.0..480.0).contains(&pixel.y) {
                continue;
            }
            let pixel = [pixel.x as f32, pixel.y as f32];
            features.keypoints.push(Keypoint { pixel, size: 3.0, angle: 0.0 });
            features.descriptors.push(descriptor(name(i as u64)));
            measured.push(Some(MeasuredPoint { position, covariance: Matrix3::identity() * 1e-4 }));
        }
        (features, measured)
    }

    fn scene() -> (Vec<Vector3<f64>>, Se3) {
        // Aside, nearer, turned back and rolled by 34°.
        (world(90), Se3::exp(&Vector6::new(-1.4, 0.1, -0.8, 0.0, 0.25, 0.6)))
    }

    #[test]
    fn an_image_from_elsewhere_is_placed_among_wrong_matches() {
        let (points, there) = scene();
        let keyframe = seen(&points, &Se3::identity(), |i| i);
        // Every third feature is matched with another point.
        let (image, _) = seen(&points, &there, |i| if i % 3 == 0 { (i * 7 + 11) % 90 } else { i });
        let by = SeenBy { features: &keyframe.0, points: &keyframe.1, world_from_keyframe: Sim3::identity() };
        let found = frame_pose(&image, &CAMERA, &[by], &FramePoseParams::default()).expect("they agree");
        assert!((found.camera_from_world * there.inverse()).log().norm() < 1e-3);
        assert!(found.inliers >= 20 && found.by_keyframe == [found.inliers], "{found:?}");
    }

    #[test]
    fn keyframes_of_other_units_agree_and_a_feature_counts_once() {
        let (points, there) = scene();
        let (image, _) = seen(&points, &there, |i| i);
        let poses = [
            Sim3::identity(),
            Sim3::new(nalgebra::UnitQuaternion::identity(), Vector3::new(0.3, 0.0, 0.1), 2.5),
        ];
        let keyframes = poses.map(|pose| {
            let (features, mut measured) = seen(&points, &pose.rigid().inverse(), |i| i);
            measured.iter_mut().flatten().for_each(|point| point.position /= pose.scale);
            (features, measured, pose)
        });
        let by = keyframes.each_ref().map(|(features, points, pose)| SeenBy {
            features,
            points,
            world_from_keyframe: *pose,
        });
        let found = frame_pose(&image, &CAMERA, &by, &FramePoseParams::default()).expect("they agree");
        assert!((found.camera_from_world * there.inverse()).log().norm() < 1e-3);
        assert!(found.inliers <= image.len() && found.by_keyframe.iter().sum::<usize>() > image.len());
    }

    #[test]
    fn another_place_with_similar_things_has_no_pose() {
        let (points, there) = scene();
        let keyframe = seen(&points, &Se3::identity(), |i| i);
        let (image, _) = seen(&points, &there, |i| (i * 37 + 5) % 90);
        let by = SeenBy { features: &keyframe.0, points: &keyframe.1, world_from_keyframe: Sim3::identity() };
        assert_eq!(frame_pose(&image, &CAMERA, &[by], &FramePoseParams::default()), None);
        assert_eq!(frame_pose(&image, &CAMERA, &[], &FramePoseParams::default()), None);
    }
}
