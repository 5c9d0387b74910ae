//! One keyframe pair through §IV-C of the paper: relative pose, scale, and the similarity over all matches.

use crate::estimate::Estimate;
use crate::matching::{FeatureMatch, MatchParams, match_features};
use crate::point_alignment::{PointAlignment, PointAlignmentParams, PointAlignmentRefusal, align_points};
use crate::prepared::PreparedKeyframe;
use crate::scale_filter::{PairScale, PointMatch, ScaleFilterParams, ScaleRefusal, pair_scale};
use crate::two_view::{BearingMatch, RelativePose, TwoViewParams, TwoViewRefusal, relative_pose};
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
}

/// The geometry of two images, before any depth is looked at.
#[derive(Clone, Debug, PartialEq)]
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
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// Matches and relative pose.
    pub views: ViewPair,
    /// The matches that agree and have depth on both sides, as 3-D points.
    pub points: Vec<PointMatch>,
    /// σ and t by the Kalman filter.
    pub scale: PairScale,
    /// The similarity over all matches with depth.
    pub alignment: PointAlignment,
}

/// Why a pair was not measured.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
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
}

impl ViewPair {
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
    let matches = match_features(source.features, target.features, &params.matching);
    let bearings: Vec<BearingMatch> = matches
        .iter()
        .map(|m| BearingMatch {
            source: source.bearings[m.source as usize],
            target: target.bearings[m.target as usize],
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
                source: source.points[m.source as usize]?,
                target: target.points[m.target as usize]?,
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
    let start = Sim3::new(rotation, scale.translation, scale.scale);
    let alignment = align_points(&points, start, &params.point_alignment)?;
    Ok(Pair { views, points, scale, alignment })
}
