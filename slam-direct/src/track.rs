//! Map-to-frame tracking: points of the map are found in the frame patch by patch, and the frame's pose minimises
//! their reprojection error.

mod pose;

pub(crate) use pose::{
    INLIER, TRACKING, learn_position_sigma, motion_by_rows, pose_covariance, position_deviation, refine_pose,
    with_depth_variance, world_point,
};

use crate::align::{AlignmentReference, Brightness};
use crate::local_map::{LocalMap, Matched, PointRef};
use crate::patch::Template;
use crate::warp::Warp;
use backend::params;
use geometry::sensor::Twist;
use geometry::{Pyramid, Se3};
use nalgebra::{Vector3, Vector6};
use rayon::prelude::*;

params! {
    /// Parameters of the map-to-frame tracking.
    pub struct TrackParams {
        /// Side of the image cells over which the searched points are spread, pixels. Range 4–200.
        pub cell: usize = 24,
        /// Points searched per cell at most. Range 1–50.
        pub per_cell: usize = 2,
        /// The same when a frame that becomes a keyframe is searched again from its refined pose. Range 1–6; more
        /// connect keyframes more closely and cost time.
        pub keyframe_per_cell: usize = 2,
        /// How far a patch may be found from its prediction, pixels. Range 1–50.
        pub max_shift: f32 = 6.0,
        /// Share of a patch's variance that may stay unexplained. Range 0.01–1.
        pub max_unexplained: f32 = 0.3,
        /// Intensity noise of a patch, grey levels: the least that is assumed. Range 0.1–50.
        pub patch_sigma: f32 = 3.0,
        /// Least value that `position_sigma` is lowered to, pixels. Range 0.01–2.
        pub least_position_sigma: f32 = 0.1,
        /// Uncertainty of position that no intensity explains (rolling shutter, lens), pixels: the initial value,
        /// then learnt from the residuals of the tracked frames. Range 0.01–5.
        pub position_sigma: f32 = 0.5,
        /// Change of a camera's rotation rate, one standard deviation, radians per second squared: the prior with
        /// which the rows of a rolling shutter give the rotation while they are read. Range 0–200; with 0 the camera
        /// rotates as it did since the frame before. Hands change theirs by up to 40.
        #[key = "turn_change"]
        pub rotation_change: f32 = 40.0,
        /// Keyframes whose points are searched at most. Range 1–100.
        pub max_hosts: usize = 14,
        /// Standard deviation of a position, over the median depth of what is seen, above which a camera that only
        /// localises gets no pose: five of them are 1 % of the depth. In maps of hand-held recordings frames have
        /// 0.0016 at most; where the map ends and a hundredth of the depth is missed, 0.002 to 0.007. Range 1e-5–0.1.
        pub max_deviation: f32 = 0.002,
        /// Share of the points found that agree with another motion than the camera's, from which the second frame in a row has no pose, or a later
        /// one where it is less: something that was mapped moves. Range 0.15–1: of still surroundings less than 0.13 in 99 of 100 frames, in single ones of a
        /// jolt 0.24; of a lorry over two fifths of the view that drives off 0.3.
        pub max_rival: f32 = 0.2,
    }
}

/// A point to look for: where it should be and how it should look.
pub(crate) struct SearchedPoint {
    pub at: PointRef,
    pub pixel: [f32; 2],
    pub warp: Warp,
    /// Rank within its cell: seen often first, then well known.
    rank: (std::cmp::Reverse<usize>, f64),
}

/// A frame with the pose from which its points are searched.
pub(crate) struct View<'a> {
    pub pyramid: &'a Pyramid,
    pub camera_from_world: Se3,
    /// Motion of the camera, in map units.
    pub motion: Twist,
}

/// Searches the map's points in the frame. Second value: how many were searched.
pub(crate) fn match_points(
    map: &LocalMap,
    hosts: &[usize],
    view: &View,
    params: &TrackParams,
    per_cell: usize,
) -> (Vec<Matched>, Vec<PointRef>) {
    let searched = choose(map, hosts, view, params, per_cell);
    let found: Vec<Option<Matched>> =
        searched.par_iter().with_min_len(64).map(|s| find(map, s, view, params)).collect();
    (found.into_iter().flatten().collect(), searched.iter().map(|s| s.at).collect())
}

/// The points expected in the frame, spread over its cells.
pub(crate) fn choose(
    map: &LocalMap,
    hosts: &[usize],
    view: &View,
    params: &TrackParams,
    per_cell: usize,
) -> Vec<SearchedPoint> {
    let camera = &map.camera;
    let columns = camera.width.div_ceil(params.cell);
    let rows = camera.height.div_ceil(params.cell);
    let mut cells: Vec<Vec<SearchedPoint>> = Vec::new();
    cells.resize_with(columns * rows, Vec::new);
    for &host in hosts {
        let state = &map.keyframes[host];
        let relative = view.camera_from_world * state.camera_from_world.inverse();
        let rotation = relative.rotation_matrix();
        for (index, point) in state.points.iter().enumerate().filter(|(_, p)| p.alive) {
            let Some((warp, pixel)) =
                Warp::new(camera, &relative, &rotation, &point.ray, point.inverse_depth)
            else {
                continue;
            };
            let depth = (rotation * point.ray + relative.translation * point.inverse_depth).z;
            let pixel = map.sensor.distorted_pixel(pixel.into(), &view.motion, point.inverse_depth / depth);
            let pixel = pixel.map(|v| v as f32);
            // What moves with the camera hides what is behind it.
            if !view.pyramid.base().contains(pixel[0], pixel[1], 5.0) || map.mask.covers_at(pixel) {
                continue;
            }
            let cell = (pixel[1] as usize / params.cell) * columns + pixel[0] as usize / params.cell;
            let relative_variance = point.variance / (point.inverse_depth * point.inverse_depth).max(1e-12);
            let rank = (std::cmp::Reverse(point.observations.len().min(6)), relative_variance);
            cells[cell].push(SearchedPoint { at: PointRef { host, index }, pixel, warp, rank });
        }
    }
    for cell in &mut cells {
        cell.sort_by(|a, b| {
            a.rank.0.cmp(&b.rank.0).then(a.rank.1.total_cmp(&b.rank.1)).then(a.at.cmp(&b.at))
        });
        cell.truncate(per_cell);
    }
    cells.into_iter().flatten().collect()
}

/// Finds one point; a view too blurred for the patch is tried at the next coarser level.
fn find(map: &LocalMap, searched: &SearchedPoint, view: &View, params: &TrackParams) -> Option<Matched> {
    let host = &map.keyframes[searched.at.host];
    let pixel = host.points[searched.at.index].pixel;
    (0..=1).find_map(|coarser| {
        let warp = searched.warp.coarser(coarser);
        let template = Template::cut(&host.pyramid, pixel, &warp)?;
        let found = template.align(view.pyramid, searched.pixel, params.max_shift, 12)?;
        (found.unexplained <= params.max_unexplained).then(|| Matched {
            at: searched.at,
            pixel: found.pixel,
            information: position_information(&found.information, found.rmse, template.level(), params),
            rmse: found.rmse,
            squared: 0.0,
            inlier: true,
        })
    })
}

/// Information of a patch's position: photometric noise through its Hessian plus the positional floor,
/// `Λ = (σ_I² H⁻¹ + σ_0² I)⁻¹ = H (σ_I² I + σ_0² H)⁻¹`.
pub(crate) fn position_information(
    hessian: &[f32; 3],
    rmse: f32,
    level: usize,
    params: &TrackParams,
) -> [f32; 3] {
    let [xx, xy, yy] = *hessian;
    let intensity = rmse.max(params.patch_sigma).powi(2);
    let floor = (params.position_sigma * (1u32 << level) as f32).powi(2);
    let (mxx, mxy, myy) = (intensity + floor * xx, floor * xy, intensity + floor * yy);
    let det = mxx * myy - mxy * mxy;
    [(xx * myy - xy * mxy) / det, (xy * mxx - xx * mxy) / det, (yy * mxx - xy * mxy) / det]
}

/// A keyframe whose points may be visible in a frame, with a sample of these.
pub(crate) struct Near {
    pub keyframe: usize,
    /// How many points it has.
    points: usize,
    /// The ray and the inverse depth of some.
    probes: Vec<(Vector3<f64>, f64)>,
}

impl Near {
    /// A keyframe of a map as it is.
    pub fn of(map: &LocalMap, keyframe: usize) -> Self {
        const PROBES: usize = 24;
        let alive: Vec<_> = map.keyframes[keyframe].points.iter().filter(|p| p.alive).collect();
        let stride = alive.len().div_ceil(PROBES).max(1);
        let probes = alive.iter().step_by(stride).map(|point| (point.ray, point.inverse_depth)).collect();
        Self { keyframe, points: alive.len(), probes }
    }
}

/// The keyframes of `near` whose points may be visible in the frame, most promising first.
pub(crate) fn choose_hosts(
    map: &LocalMap,
    near: &[Near],
    view_camera_from_world: &Se3,
    reference: usize,
    count: usize,
) -> Vec<usize> {
    let mut scored: Vec<(usize, usize)> = Vec::new();
    for Near { keyframe, points, probes } in near {
        let relative = *view_camera_from_world * map.keyframes[*keyframe].camera_from_world.inverse();
        let rotation = relative.rotation_matrix();
        let is_visible = |(ray, inverse_depth): &&(Vector3<f64>, f64)| {
            let seen = Warp::new(&map.camera, &relative, &rotation, ray, *inverse_depth);
            seen.is_some_and(|(_, p)| {
                p.x >= 5.0
                    && p.y >= 5.0
                    && p.x < map.camera.width as f64 - 5.0
                    && p.y < map.camera.height as f64 - 5.0
            })
        };
        // What counts is how many points may be seen, not their share.
        let score = probes.iter().filter(is_visible).count() * points / probes.len().max(1);
        if score > 0 || *keyframe == reference {
            scored.push((*keyframe, score));
        }
    }
    scored
        .sort_by(|a, b| (b.0 == reference).cmp(&(a.0 == reference)).then(b.1.cmp(&a.1)).then(b.0.cmp(&a.0)));
    scored.truncate(count);
    scored.into_iter().map(|s| s.0).collect()
}

/// Rotations tried about the prediction when the alignment is poor: small rotations about each axis and pairs of axes
/// (Engel 2018, §3.1).
fn turns() -> impl Iterator<Item = Se3> {
    [0.03, 0.07].into_iter().flat_map(|angle: f64| {
        let mut all = Vec::new();
        for x in -1..=1 {
            for y in -1..=1 {
                for z in -1..=1 {
                    if (x, y, z) != (0, 0, 0) {
                        let w = Vector3::new(x as f64, y as f64, z as f64) * angle;
                        all.push(Se3::exp(&Vector6::new(0.0, 0.0, 0.0, w.x, w.y, w.z)));
                    }
                }
            }
        }
        all
    })
}

/// Direct alignment from the most plausible guesses; it tries more only while the result is poor.
pub(crate) fn align_from_guesses(
    reference: &AlignmentReference,
    image: &Pyramid,
    guesses: &[Se3],
    brightness: Brightness,
    good: f32,
) -> crate::align::Alignment {
    let quality = |a: &crate::align::Alignment| a.inlier_share * a.visible_share.min(1.0);
    let mut best: Option<crate::align::Alignment> = None;
    let mut consider = |alignment: crate::align::Alignment| {
        if best.as_ref().is_none_or(|b| quality(&alignment) > quality(b)) {
            best = Some(alignment);
        }
        best.as_ref().is_some_and(|b| b.inlier_share >= good)
    };
    for guess in guesses {
        if consider(reference.align(image, guess, brightness)) {
            break;
        }
    }
    let poor = best.as_ref().is_none_or(|b| b.inlier_share < good);
    if poor && let Some(first) = guesses.first() {
        let cost = |rotated: &Se3| reference.coarse_cost(image, &(*rotated * *first), brightness);
        let mut ranked: Vec<(f64, Se3)> = turns().map(|rotated| (cost(&rotated), rotated)).collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, rotated) in ranked.iter().take(3) {
            let alignment = reference.align(image, &(*rotated * *first), brightness);
            if best.as_ref().is_none_or(|b| quality(&alignment) > quality(b)) {
                best = Some(alignment);
            }
        }
    }
    best.expect("at least one guess is given")
}

#[cfg(test)]
mod tests;
