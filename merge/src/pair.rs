//! One keyframe pair through §IV-C of the paper: relative pose, scale, and the similarity over all matches.

use crate::estimate::Estimate;
use crate::matching::{FeatureMatch, MatchParams, match_features};
use crate::point_alignment::{PointAlignment, PointAlignmentParams, PointAlignmentRefusal, align_points};
use crate::prepared::PreparedKeyframe;
use crate::scale_filter::{PairScale, PointMatch, ScaleFilterParams, ScaleRefusal, pair_scale};
use crate::two_view::{BearingMatch, RelativePose, Scene, TwoViewParams, TwoViewRefusal, relative_pose};
use geometry::Sim3;
use map::KeyframeId;
use serde::{Deserialize, Serialize};

/// How a pair is measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PairParams {
    /// Matching key points.
    pub matching: MatchParams,
    /// Relative pose.
    pub two_view: TwoViewParams,
    /// Scale.
    pub scale_filter: ScaleFilterParams,
    /// All seven degrees of freedom.
    pub point_alignment: PointAlignmentParams,
    /// How far t of the depths may point away from t̂ of the images.
    pub direction: DirectionParams,
}

/// When two directions of the translation contradict each other: both bounds must be passed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DirectionParams {
    /// Largest angle between them in its own standard deviations. Default 6; above 0. The deviations are those of
    /// independent errors and understate real ones by half.
    pub max_deviations: f64,
    /// Angle below which they never contradict each other, degrees. Default 15; 0 or more. Two cameras in nearly one
    /// place differ by more than their deviations say.
    pub min_angle: f64,
}

impl Default for DirectionParams {
    fn default() -> Self {
        Self { max_deviations: 6.0, min_angle: 15.0 }
    }
}

/// By how much t of the scale filter points away from t̂ of the eight-point algorithm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DirectionGap {
    /// The angle, degrees.
    pub angle: f64,
    /// Its standard deviation, degrees.
    pub deviation: f64,
}

/// A place that both agents may have seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Keyframe of the source.
    pub source: KeyframeId,
    /// Keyframe of the target.
    pub target: KeyframeId,
}

/// The geometry of two images, before any depth is looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewPair {
    /// The source keyframe.
    pub source: KeyframeId,
    /// The target keyframe.
    pub target: KeyframeId,
    /// All mutual nearest neighbours.
    pub matches: Vec<FeatureMatch>,
    /// R, t̂ and which matches agree with them.
    pub relative_pose: RelativePose,
}

/// A measured pair with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pair {
    /// Matches and relative pose.
    pub views: ViewPair,
    /// The matches that agree and have depth on both sides, as 3-D points.
    pub points: Vec<PointMatch>,
    /// σ and t by the Kalman filter.
    pub scale: PairScale,
    /// t against t̂; nothing where the images leave the direction open.
    pub direction_gap: Option<DirectionGap>,
    /// The similarity over all matches with depth.
    pub alignment: PointAlignment,
}

/// Why a pair was not measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum PairRefusal {
    /// The images do not fit.
    #[error("{0}")]
    RelativePose(#[from] TwoViewRefusal),
    /// The depths leave no scale.
    #[error("{0}")]
    Scale(#[from] ScaleRefusal),
    /// The depths leave no similarity.
    #[error("{0}")]
    Alignment(#[from] PointAlignmentRefusal),
    /// Depths and images contradict each other.
    #[error(
        "the depths put the other camera {angle:.0}° away from where the images do, {deviation:.1}° being its \
         standard deviation"
    )]
    Direction {
        /// The angle, degrees.
        angle: f64,
        /// Its standard deviation, degrees.
        deviation: f64,
    },
}

impl ViewPair {
    /// The place that it is of.
    pub fn place(&self) -> Place {
        Place { source: self.source, target: self.target }
    }

    /// γ: how many matches agree with the relative pose.
    pub fn match_count(&self) -> usize {
        self.relative_pose.match_count()
    }
}

impl Pair {
    /// target_from_source of the keyframes.
    pub fn estimate(&self) -> Estimate {
        Estimate { a_from_b: self.alignment.target_from_source, information: self.alignment.information }
    }
}

/// Matches two images and finds their relative pose (PCR-Pro, §IV-C1).
pub fn view_pair(
    source: &PreparedKeyframe,
    target: &PreparedKeyframe,
    params: &PairParams,
) -> Result<ViewPair, TwoViewRefusal> {
    let matches = match_features(&source.features, &target.features, &params.matching);
    let bearings: Vec<BearingMatch> = matches
        .iter()
        .map(|m| BearingMatch {
            source: source.bearings()[m.source as usize],
            target: target.bearings()[m.target as usize],
        })
        .collect();
    // The coarser of both cameras sets how exact a match can be.
    let focal_length = source.camera.fx.min(target.camera.fx);
    let relative_pose = relative_pose(&bearings, focal_length.recip(), &params.two_view)?;
    Ok(ViewPair { source: source.keyframe.id, target: target.keyframe.id, matches, relative_pose })
}

/// The matches that agree with the relative pose and have depth on both sides, as 3-D points.
pub fn matched_points(
    source: &PreparedKeyframe,
    target: &PreparedKeyframe,
    views: &ViewPair,
) -> Vec<PointMatch> {
    views
        .relative_pose
        .inliers
        .iter()
        .filter_map(|&index| {
            let m = views.matches.get(index)?;
            Some(PointMatch {
                source: source.points()[m.source as usize]?,
                target: target.points()[m.target as usize]?,
            })
        })
        .collect()
}

/// Scale and similarity of a pair whose relative pose is known (§IV-C2).
pub fn measure_pair(
    source: &PreparedKeyframe,
    target: &PreparedKeyframe,
    views: ViewPair,
    params: &PairParams,
) -> Result<Pair, PairRefusal> {
    let points = matched_points(source, target, &views);
    let rotation = views.relative_pose.target_from_source;
    let scale = pair_scale(&points, &rotation, &params.scale_filter)?;
    let direction_gap = direction_gap(&views.relative_pose, &scale);
    if let Some(DirectionGap { angle, deviation }) = direction_gap
        && angle > params.direction.min_angle.max(params.direction.max_deviations * deviation)
    {
        return Err(PairRefusal::Direction { angle, deviation });
    }
    let start = Sim3::new(rotation, scale.translation, scale.scale);
    let alignment = align_points(&points, start, &params.point_alignment)?;
    Ok(Pair { views, points, scale, direction_gap, alignment })
}

/// t against t̂ (§IV-C2): both are where the source camera is in the target's frame, the one from depths, the other
/// from images alone. `None` where the images leave it open: no parallax, or a plane that allows two poses.
fn direction_gap(pose: &RelativePose, scale: &PairScale) -> Option<DirectionGap> {
    let direction = pose.direction.as_ref()?;
    if matches!(pose.scene, Scene::Plane { alternative: Some(_), .. }) {
        return None;
    }
    let length = scale.translation.norm();
    let across = direction.basis.transpose();
    let of_images = direction.covariance.fixed_view::<2, 2>(3, 3).trace();
    let of_depths = (across * scale.covariance.fixed_view::<3, 3>(1, 1) * across.transpose()).trace();
    let deviation = (of_images + of_depths / (length * length)).sqrt().to_degrees();
    let angle = direction.vector.angle(&scale.translation).to_degrees();
    (angle.is_finite() && deviation.is_finite()).then_some(DirectionGap { angle, deviation })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::point_scene::{CAMERA, scene};
    use crate::two_view::relative_pose;

    /// Bearings of a scene's matches and its points, as [`measure_pair`] has them.
    fn measured(seed: u64) -> (RelativePose, PairScale) {
        let scene = scene(seed, 200, 0.1, 0.5);
        let bearing = |p: &nalgebra::Vector3<f64>| p.normalize();
        let bearings: Vec<BearingMatch> = scene
            .matches
            .iter()
            .map(|m| BearingMatch {
                source: bearing(&m.source.position),
                target: bearing(&m.target.position),
            })
            .collect();
        let pose = relative_pose(&bearings, CAMERA.fx.recip(), &TwoViewParams::default()).unwrap();
        let scale =
            pair_scale(&scene.matches, &pose.target_from_source, &ScaleFilterParams::default()).unwrap();
        (pose, scale)
    }

    #[test]
    fn images_and_depths_of_one_scene_give_the_same_direction() {
        for seed in 0..10 {
            let (pose, scale) = measured(seed);
            let gap = direction_gap(&pose, &scale).unwrap();
            assert!(gap.angle < 6.0 * gap.deviation, "seed {seed}: {gap:?}");
            let mut wrong = scale.clone();
            wrong.translation = -wrong.translation;
            assert!(direction_gap(&pose, &wrong).unwrap().angle > 150.0);
        }
    }
}
