//! Choosing the frames a keyframe is observed in.

use super::DepthParams;
use geometry::{Pinhole, Se3};
use nalgebra::Vector3;

/// Parallax beyond which a reference is only used where there are too few others.
const PREFERRED_PARALLAX: f64 = 0.15;
/// Ratios between the baselines of successive references, wished for first: each sharpens what the one before
/// has found. Where frames are few, closer ones will do.
const GROWTH: [f64; 4] = [2.0, 1.5, 1.2, 1.0];

/// Indices of the candidates (poses `frame_from_keyframe`) in which to observe a keyframe, in the order to use them.
/// Baselines grow from `params.min_parallax` to `params.max_parallax`, each candidate sees at least the share
/// `params.min_overlap` of the keyframe, and there are at most `params.max_references`.
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

/// Keeps references on a ladder of growing baselines, one to each side of the keyframe per rung, the rungs
/// as far apart as leaves `most` of them.
fn thinned(usable: &[(f64, usize)], candidates: &[Se3], most: usize) -> Vec<usize> {
    let mut chosen = Vec::new();
    for growth in GROWTH {
        chosen = ladder(usable, candidates, growth);
        if chosen.len() >= most {
            break;
        }
    }
    // The shortest baseline finds, the longest sharpen, but views that differ much match less: what is too much
    // goes from beyond the preferred baseline, then from the middle.
    while chosen.len() > most.max(1) {
        let too_long = chosen.last().is_some_and(|last| last.0 > PREFERRED_PARALLAX);
        chosen.remove(if too_long { chosen.len() - 1 } else { 1 });
    }
    chosen.into_iter().map(|(_, i)| i).collect()
}

/// The references, each of a baseline at least `growth` times that of the one before on the same side.
fn ladder(usable: &[(f64, usize)], candidates: &[Se3], growth: f64) -> Vec<(f64, usize)> {
    let mut chosen: Vec<(f64, usize)> = Vec::new();
    for &(parallax, i) in usable {
        let centre = candidates[i].inverse().translation;
        let same_side = |j: usize| candidates[j].inverse().translation.dot(&centre) > 0.0;
        if !chosen.iter().any(|&(p, j)| same_side(j) && parallax < growth * p) {
            chosen.push((parallax, i));
        }
    }
    chosen
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
