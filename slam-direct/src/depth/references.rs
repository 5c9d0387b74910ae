//! Choosing the frames a keyframe is observed in.

use super::DepthParams;
use geometry::{Pinhole, Se3};
use nalgebra::Vector3;

/// Ratio between the baselines of successive references: each sharpens what the one before has found.
const GROWTH: f64 = 2.0;

/// Indices of the candidates (poses `frame_from_keyframe`) to observe a keyframe in, in the order to use them:
/// growing baselines between `params.min_parallax` and `params.max_parallax`, the share of the keyframe they
/// see at least `params.min_overlap`, at most `params.max_references`.
///
/// `mean_inverse_depth` is the keyframe's, 1/keyframe unit.
pub fn choose_references(
    candidates: &[Se3],
    mean_inverse_depth: f32,
    camera: &Pinhole,
    params: &DepthParams,
) -> Vec<usize> {
    let parallax = |pose: &Se3| pose.translation.norm() * mean_inverse_depth as f64;
    let range = params.min_parallax as f64..=params.max_parallax as f64;
    let mut usable: Vec<(f64, usize)> = candidates
        .iter()
        .enumerate()
        .filter(|(_, pose)| pose.is_finite() && range.contains(&parallax(pose)))
        .filter(|(_, pose)| overlap(pose, mean_inverse_depth as f64, camera) >= params.min_overlap)
        .map(|(i, pose)| (parallax(pose), i))
        .collect();
    usable.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    thinned(&usable, candidates, params.max_references)
}

/// Keeps references on a ladder of growing baselines, one to each side of the keyframe per rung.
fn thinned(usable: &[(f64, usize)], candidates: &[Se3], most: usize) -> Vec<usize> {
    let mut chosen: Vec<(f64, usize)> = Vec::new();
    for &(parallax, i) in usable {
        let centre = candidates[i].inverse().translation;
        let same_side = |j: usize| candidates[j].inverse().translation.dot(&centre) > 0.0;
        let crowded = chosen.iter().any(|&(p, j)| same_side(j) && parallax < GROWTH * p);
        if !crowded {
            chosen.push((parallax, i));
        }
    }
    // The shortest baseline finds, the longest sharpen: what is too much goes from the middle.
    while chosen.len() > most.max(1) {
        chosen.remove(1.min(chosen.len() - 1));
    }
    chosen.into_iter().map(|(_, i)| i).collect()
}

/// Share of a grid of keyframe pixels at the mean depth that the candidate sees.
fn overlap(frame_from_keyframe: &Se3, inverse_depth: f64, camera: &Pinhole) -> f32 {
    const GRID: usize = 8;
    let (width, height) = (camera.width as f64, camera.height as f64);
    let mut seen = 0;
    for k in 0..GRID * GRID {
        let x = ((k % GRID) as f64 + 0.5) / GRID as f64 * width;
        let y = ((k / GRID) as f64 + 0.5) / GRID as f64 * height;
        let ray = camera.unproject(x, y);
        let point: Vector3<f64> =
            frame_from_keyframe.rotation * ray + frame_from_keyframe.translation * inverse_depth;
        let u = camera.project(&point);
        let inside = u.x >= 0.0 && u.y >= 0.0 && u.x < width && u.y < height;
        seen += (point.z > 0.0 && inside) as usize;
    }
    seen as f32 / (GRID * GRID) as f32
}
