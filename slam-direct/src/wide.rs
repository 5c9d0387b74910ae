//! A wide search for a frame where the direct alignment failed. The map's patches are searched one by one over a
//! large part of the image, from coarse to fine, and the pose is the one with which most of them agree.
//!
//! Each patch has a gain and an offset of its own, so neither a jump of the exposure nor one of the camera hides the
//! map. Patches that are found by chance agree with no pose.

use crate::local_map::{LocalMap, PointRef};
use crate::patch::Template;
use crate::track::{SearchedPoint, TrackParams, View, choose};
use backend::params;
use geometry::Se3;
use geometry::pnp::{Consensus, Sighting, pose_by_consensus};
use geometry::sensor::Twist;
use rayon::prelude::*;

params! {
    /// Parameters of the wide search for a frame.
    pub struct WideParams {
        /// Pyramid levels over which a patch is searched. Range 1–5; each doubles how far from its prediction it is
        /// found.
        pub levels: usize = 4,
        /// How far it may be found from where the coarser level has it, pixels of the level. Range 2–12.
        pub max_shift: f32 = 8.0,
        /// Largest distance of a patch from where the pose has it, in focal lengths. Range 0.001–0.02; patches are
        /// placed to about a pixel, and depths add to that.
        pub max_error: f64 = 0.004,
        /// Triples of patches that are tried at most. Range 50–5000.
        pub max_samples: usize = 400,
        /// Share of the searched patches that must agree, 0–1. Range 0–1.
        pub min_share: f32 = 0.15,
    }
}

/// The pose `camera_from_world` with which most of the map's patches agree, searched around that of the `view`;
/// `None` when fewer than `min_matched` agree.
pub(crate) fn search(
    map: &LocalMap,
    hosts: &[usize],
    view: &View,
    track: &TrackParams,
    params: &WideParams,
    min_matched: usize,
) -> Option<Se3> {
    let searched = choose(map, hosts, view, track, track.per_cell);
    let found: Vec<Option<Sighting>> = searched
        .par_iter()
        .with_min_len(32)
        .map(|s| Some(sighting(map, s.at, find(map, s, view, track, params)?, &view.motion)))
        .collect();
    let found: Vec<Sighting> = found.into_iter().flatten().collect();
    let share = (params.min_share * searched.len() as f32) as usize;
    let consensus = Consensus {
        max_error: params.max_error,
        max_samples: params.max_samples,
        min_inliers: share.max(min_matched),
    };
    pose_by_consensus(&found, &consensus).map(|found| found.0)
}

/// Where a patch is found.
fn find(
    map: &LocalMap,
    searched: &SearchedPoint,
    view: &View,
    track: &TrackParams,
    params: &WideParams,
) -> Option<[f32; 2]> {
    let host = &map.keyframes[searched.at.host];
    let pixel = host.points[searched.at.index].pixel;
    let (mut at, mut found) = (searched.pixel, None);
    for coarser in (0..params.levels.max(1)).rev() {
        let warp = searched.warp.coarser(coarser);
        if warp.view_level >= view.pyramid.len() || warp.host_level >= host.pyramid.len() {
            continue;
        }
        let aligned = Template::cut(&host.pyramid, pixel, &warp)
            .and_then(|template| template.align(view.pyramid, at, params.max_shift, 12));
        if let Some(aligned) = aligned {
            at = aligned.pixel;
            if coarser <= 1 && aligned.unexplained <= track.max_unexplained {
                found = Some(at);
            }
        }
    }
    found
}

/// A map point with the ray of the pixel at which it is seen.
fn sighting(map: &LocalMap, at: PointRef, pixel: [f32; 2], motion: &Twist) -> Sighting {
    let point = map.point(at);
    let host_from_world = &map.keyframes[at.host].camera_from_world;
    Sighting {
        point: host_from_world.inverse() * (point.ray / point.inverse_depth),
        ray: map.sensor.ray(pixel.map(f64::from), motion, point.inverse_depth),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{CAMERA, View as Rendered, exact_map, pose};
    use geometry::{GrayImage, Pyramid};

    const HOSTS: [usize; 2] = [0, 1];

    fn map() -> LocalMap {
        exact_map(&[0.0, 0.4].map(|x| Rendered::new(pose(x, 0.0, 0.0, 0.0, 0.0))), 10)
    }

    fn search_result(map: &LocalMap, pyramid: &Pyramid, camera_from_world: Se3) -> Option<Se3> {
        let view = View { pyramid, camera_from_world, motion: Twist::zeros() };
        search(map, &HOSTS, &view, &TrackParams::default(), &WideParams::default(), 30)
    }

    #[test]
    fn a_frame_is_found_far_from_where_it_should_be() {
        let map = map();
        for (yaw, forward) in [(0.0, 0.0), (0.0, 0.05), (0.01, -0.05)] {
            let there = Rendered::new(pose(0.2, 0.05, forward, yaw, 0.02));
            let found = search_result(&map, &there.pyramid, map.keyframes[0].camera_from_world);
            let error =
                (found.unwrap_or_else(|| panic!("{yaw} {forward}")) * there.world_from_camera).log().norm();
            assert!(error < 0.03, "{yaw} {forward}: {error}");
        }
    }

    #[test]
    fn a_frame_of_another_place_is_not_found() {
        let map = map();
        let start = map.keyframes[0].camera_from_world;
        let elsewhere = Rendered::new(pose(0.0, 0.0, -9.0, 3.1, 0.0));
        assert_eq!(search_result(&map, &elsewhere.pyramid, start), None);
        let flat = Pyramid::new(GrayImage::filled(CAMERA.width, CAMERA.height, 90), 5);
        assert_eq!(search_result(&map, &flat, start), None);
    }
}
