//! Loops within one map: which old keyframes may show what the current one shows, and whether they do.

use backend::params;
use backend::sim3_align::{
    AlignRefusal, KeyframeView, Sim3AlignParams, Sim3Alignment, align_from, reciprocal, turned_starts,
};
use geometry::{Pinhole, Sim3, median};
use map::{Edge, EdgeKind, Keyframe, KeyframeId, PlaceCandidate};
use std::collections::BTreeMap;
use thiserror::Error;

#[cfg(test)]
mod alignment_data;
#[cfg(test)]
mod tests;

params! {
    /// Parameters of the loop search.
    pub struct LoopParams {
        /// Least number of keyframes between the current and an old one. Range 2–1000; fewer closes small loops and
        /// repeats what covisibility has already.
        pub min_gap: u32 = 15,
        /// Most candidates given. Range 1–20; each costs two alignments.
        pub max_candidates: usize = 3,
        /// Least share of a candidate's points that the map's poses project into the current keyframe.
        /// Range 0–1.
        pub min_overlap: f64 = 0.4,
        /// Largest angle between the viewing directions by the map's poses, degrees. Range 5–90.
        pub max_view_angle: f64 = 35.0,
        /// Largest distance of the camera centres by the map's poses, in median depths of the current
        /// keyframe. Range 0.05–5; direct alignment bears little parallax.
        pub max_distance: f64 = 0.5,
        /// Candidates this near in id to a better one are left out. Range 0–50.
        pub spacing: u32 = 3,
        /// Angle between the starts of an alignment, degrees; 0 for a single start. Range 0–20; nine
        /// starts cost about as much as all that follows.
        pub start_angle: f64 = 5.0,
        /// Largest photometric residual of a closed loop, root mean square, grey levels.
        /// Range 5–80; repeated structure aligns with more.
        pub max_rmse: f32 = 30.0,
        /// The alignment itself.
        pub align: Sim3AlignParams = Sim3AlignParams::default(),
    }
}

/// An old keyframe that may show what the current one shows.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopCandidate {
    /// The old keyframe.
    pub keyframe: KeyframeId,
    /// Share of its points that the map's poses project into the current keyframe; 0 when the poses
    /// speak against it.
    pub overlap: f64,
    /// Score by appearance; 0 when it was not proposed.
    pub appearance: f32,
    /// Where alignments start: by the map's poses, by appearance, or both.
    pub current_from_old: Vec<Sim3>,
}

impl LoopCandidate {
    fn score(&self) -> f64 {
        self.overlap + self.appearance as f64
    }
}

/// Old keyframes that may close a loop with `current`, best first.
///
/// Of the `admitted` those that by their poses look the same way from nearby and see the same points, and those that
/// appearance proposes, the given `places`. The newest are left out.
pub fn candidates(
    camera: &Pinhole,
    current: &Keyframe,
    admitted: impl Iterator<Item = Keyframe>,
    places: &[PlaceCandidate],
    params: &LoopParams,
) -> Vec<LoopCandidate> {
    let Some(depth) = median_depth(current) else { return Vec::new() };
    let appearance: BTreeMap<KeyframeId, f32> = places.iter().map(|p| (p.keyframe, p.score)).collect();
    let is_old = |old: &Keyframe| old.id.0.saturating_add(params.min_gap) <= current.id.0;
    let mut found: Vec<LoopCandidate> = admitted
        .filter(is_old)
        .filter_map(|old| {
            let appearance = appearance.get(&old.id).copied();
            propose(camera, (current, depth), &old, appearance, params)
        })
        .collect();
    found.sort_by(|a, b| b.score().total_cmp(&a.score()).then(a.keyframe.cmp(&b.keyframe)));
    let mut spread: Vec<LoopCandidate> = Vec::new();
    for candidate in found {
        let is_near = |kept: &LoopCandidate| kept.keyframe.0.abs_diff(candidate.keyframe.0) <= params.spacing;
        if spread.len() < params.max_candidates && !spread.iter().any(is_near) {
            spread.push(candidate);
        }
    }
    spread
}

/// A candidate, when poses or appearance speak for it.
fn propose(
    camera: &Pinhole,
    (current, current_depth): (&Keyframe, f64),
    old: &Keyframe,
    appearance: Option<f32>,
    params: &LoopParams,
) -> Option<LoopCandidate> {
    let current_from_old = current.world_from_keyframe.inverse() * old.world_from_keyframe;
    let view_angle =
        current_from_old.rotation.transform_vector(&nalgebra::Vector3::z()).z.clamp(-1.0, 1.0).acos();
    let is_near = current_from_old.is_valid()
        && view_angle <= params.max_view_angle.to_radians()
        && current_from_old.translation.norm() <= params.max_distance * current_depth;
    let overlap = if is_near { overlap(camera, &current_from_old, old) } else { 0.0 };
    let mut guesses = Vec::new();
    if overlap >= params.min_overlap {
        guesses.push(current_from_old);
    }
    if appearance.is_some() {
        // Alike means: the same camera, in the same place, seeing the same depths in its own unit.
        let mut same_place = Sim3::identity();
        same_place.scale = current_depth / median_depth(old)?;
        guesses.push(same_place);
    }
    let candidate = LoopCandidate {
        keyframe: old.id,
        overlap: if overlap >= params.min_overlap { overlap } else { 0.0 },
        appearance: appearance.unwrap_or(0.0),
        current_from_old: guesses,
    };
    (!candidate.current_from_old.is_empty()).then_some(candidate)
}

/// `(x, y, inverse depth)` of at most about 200 of a keyframe's points.
fn sample_points(keyframe: &Keyframe, width: usize) -> Vec<[f64; 3]> {
    let step = |count: usize| count.div_ceil(200).max(1);
    if keyframe.semi_dense.is_empty() {
        let points = keyframe.points.iter().step_by(step(keyframe.points.len()));
        return points.map(|p| [p.pixel[0] as f64, p.pixel[1] as f64, p.inverse_depth as f64]).collect();
    }
    let semi_dense = &keyframe.semi_dense;
    semi_dense
        .iter()
        .step_by(step(semi_dense.len()))
        .map(|(pixel, d, _)| [(pixel as usize % width) as f64, (pixel as usize / width) as f64, d as f64])
        .collect()
}

/// Share of a keyframe's points that fall inside the current image.
fn overlap(camera: &Pinhole, current_from_old: &Sim3, old: &Keyframe) -> f64 {
    let points = sample_points(old, camera.width);
    let seen = points.iter().filter(|[x, y, d]| {
        let point = *current_from_old * (camera.unproject(*x, *y) / *d);
        let pixel = camera.project(&point);
        let inside = |v: f64, size: usize| v >= 0.0 && v <= (size - 1) as f64;
        point.z > 0.0 && inside(pixel.x, camera.width) && inside(pixel.y, camera.height)
    });
    seen.count() as f64 / points.len().max(1) as f64
}

/// Median depth of a keyframe in its own unit; `None` without depth.
fn median_depth(keyframe: &Keyframe) -> Option<f64> {
    // The width does not matter for the depths alone.
    let mut depths: Vec<f64> =
        sample_points(keyframe, 1).iter().map(|p| 1.0 / p[2]).filter(|d| d.is_finite() && *d > 0.0).collect();
    median(&mut depths)
}

/// A loop that was closed.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosedLoop {
    /// The edge from the current to the old keyframe.
    pub edge: Edge,
    /// Distance between the alignments both ways, standard deviations.
    pub mahalanobis: f64,
    /// The alignment of the old keyframe in the current one, with its evidence.
    pub alignment: Sim3Alignment,
}

/// Why a candidate is no loop.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LoopRefusal {
    /// The old keyframe does not align with the current one.
    #[error("the old keyframe does not align with the current one: {0}")]
    Forward(AlignRefusal),
    /// The current keyframe does not align with the old one.
    #[error("the current keyframe does not align with the old one: {0}")]
    Backward(AlignRefusal),
    /// The residuals are too large for the same place.
    #[error("the images differ by {rmse} grey levels")]
    Unlike {
        /// Root mean square photometric residual.
        rmse: f32,
    },
    /// The alignments both ways do not undo each other.
    #[error("the alignments both ways differ by {mahalanobis} standard deviations")]
    Inconsistent {
        /// Their distance, standard deviations; infinite when a covariance is singular.
        mahalanobis: f64,
    },
}

/// Aligns the current keyframe with a candidate both ways, each from its own starts, and makes an
/// edge when the alignments agree.
pub fn close(
    current: (KeyframeId, &KeyframeView),
    old: &KeyframeView,
    candidate: &LoopCandidate,
    params: &LoopParams,
) -> Result<ClosedLoop, LoopRefusal> {
    let angle = params.start_angle.to_radians();
    let starts = |guesses: &mut dyn Iterator<Item = Sim3>| -> Vec<Sim3> {
        if angle > 0.0 {
            guesses.flat_map(|guess| turned_starts(guess, angle)).collect()
        } else {
            guesses.collect()
        }
    };
    let forward = starts(&mut candidate.current_from_old.iter().copied());
    let alignment = align_from(old, current.1, &forward, &params.align).map_err(LoopRefusal::Forward)?;
    if alignment.rmse > params.max_rmse {
        return Err(LoopRefusal::Unlike { rmse: alignment.rmse });
    }
    let backward = starts(&mut candidate.current_from_old.iter().map(Sim3::inverse));
    let back = align_from(current.1, old, &backward, &params.align).map_err(LoopRefusal::Backward)?;
    if back.rmse > params.max_rmse {
        return Err(LoopRefusal::Unlike { rmse: back.rmse });
    }
    let verdict = reciprocal(&alignment, &back, &params.align)
        .ok_or(LoopRefusal::Inconsistent { mahalanobis: f64::INFINITY })?;
    if !verdict.consistent {
        return Err(LoopRefusal::Inconsistent { mahalanobis: verdict.mahalanobis });
    }
    let edge = Edge {
        from: current.0,
        to: candidate.keyframe,
        from_from_to: verdict.a_from_b,
        information: verdict.information,
        kind: EdgeKind::Loop,
    };
    Ok(ClosedLoop { edge, mahalanobis: verdict.mahalanobis, alignment })
}
