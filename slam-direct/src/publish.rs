//! Carrying the working map over to the public one.

use crate::local_map::{LocalMap, PointState};
use crate::mapping::UnitChange;
use geometry::Sim3;
use map::{AgentId, Edge, Keyframe, Map, Observation, Point, SemiDense};
use std::collections::BTreeMap;

/// Adds a keyframe with its image and pose; depth and points follow when they are known.
pub(crate) fn add_keyframe(map: &mut Map, local: &LocalMap, keyframe: usize) {
    let state = &local.keyframes[keyframe];
    let id = LocalMap::id(keyframe);
    map.keyframes.insert(
        id,
        Keyframe {
            id,
            agent: AgentId::default(),
            timestamp: state.timestamp,
            frame_index: state.frame_index,
            world_from_keyframe: Sim3::from(state.camera_from_world.inverse()),
            image: state.pyramid.shared_base(),
            semi_dense: SemiDense::default(),
            points: Vec::new(),
        },
    );
}

/// Sets a keyframe's semi-dense depth and the points it hosts.
pub(crate) fn set_depth(map: &mut Map, local: &LocalMap, keyframe: usize, depth: SemiDense) {
    if let Some(public) = map.keyframes.get_mut(&LocalMap::id(keyframe)) {
        public.semi_dense = depth;
        public.points = points(local, keyframe);
    }
}

/// Poses of all keyframes.
pub(crate) fn update_poses(map: &mut Map, local: &LocalMap) {
    for (index, state) in local.keyframes.iter().enumerate() {
        if let Some(public) = map.keyframes.get_mut(&LocalMap::id(index)) {
            public.world_from_keyframe = Sim3::from(state.camera_from_world.inverse());
        }
    }
}

/// Scales what was measured relative to the keyframes whose unit has changed: frames, semi-dense depth and points.
pub(crate) fn scale_surroundings(map: &mut Map, changes: &[UnitChange]) {
    let factors: BTreeMap<_, f64> = changes.iter().map(|c| (LocalMap::id(c.keyframe), c.factor)).collect();
    for frame in &mut map.frames {
        if let Some(factor) = factors.get(&frame.reference) {
            frame.keyframe_from_frame.translation *= *factor;
        }
    }
    for (id, factor) in factors {
        if let Some(public) = map.keyframes.get_mut(&id) {
            scale_depth(&mut public.semi_dense, factor);
            scale_points(&mut public.points, factor);
        }
    }
}

/// Brings inverse depths to a unit in which lengths are `factor` times what they were.
pub(crate) fn scale_depth(depth: &mut SemiDense, factor: f64) {
    let factor = factor as f32;
    depth.inverse_depth.iter_mut().for_each(|d| *d /= factor);
    depth.variance.iter_mut().for_each(|v| *v /= factor * factor);
}

/// The same for points: until the end brings the optimised ones, a reader of the live map finds them where the
/// semi-dense depth lies.
fn scale_points(points: &mut [Point], factor: f64) {
    let factor = factor as f32;
    for point in points {
        point.inverse_depth /= factor;
        point.variance /= factor * factor;
    }
}

/// Poses, points and edges as they stand at the end of a run.
pub(crate) fn complete(map: &mut Map, local: &LocalMap, edges: Vec<Edge>) {
    update_poses(map, local);
    map.edges = edges;
    for keyframe in 0..local.keyframes.len() {
        if let Some(public) = map.keyframes.get_mut(&LocalMap::id(keyframe)) {
            public.points = points(local, keyframe);
        }
    }
}

fn points(local: &LocalMap, keyframe: usize) -> Vec<Point> {
    local.keyframes[keyframe].points.iter().filter(|p| p.alive).map(point).collect()
}

fn point(state: &PointState) -> Point {
    let observation = |o: &crate::local_map::SeenAt| Observation {
        keyframe: LocalMap::id(o.keyframe),
        pixel: o.pixel,
        information: o.information,
    };
    Point {
        pixel: state.pixel,
        inverse_depth: state.inverse_depth as f32,
        variance: state.variance as f32,
        observations: state.observations.iter().map(observation).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{CAMERA, View, exact_map, pose};
    use geometry::Se3;
    use map::{FramePose, KeyframeId};

    /// A working map of two keyframes, and the public one with depth and a frame tracked against each.
    fn published() -> (LocalMap, Map) {
        let views: Vec<View> = [0.0, 0.4].iter().map(|&x| View::new(pose(x, 0.0, 0.0, 0.0, 0.0))).collect();
        let local = exact_map(&views, 30);
        let mut map = Map::new(CAMERA);
        for keyframe in 0..2 {
            add_keyframe(&mut map, &local, keyframe);
            let depth =
                SemiDense { pixel: vec![7, 9], inverse_depth: vec![0.5, 0.25], variance: vec![0.04, 0.01] };
            set_depth(&mut map, &local, keyframe, depth);
            map.frames.push(FramePose {
                timestamp: keyframe as f64,
                frame_index: keyframe as u64,
                reference: LocalMap::id(keyframe),
                keyframe_from_frame: pose(0.1, 1.3, -4.5, 0.1, 0.0),
            });
        }
        (local, map)
    }

    #[test]
    fn keyframes_carry_pose_image_and_points() {
        let (local, map) = published();
        for (index, state) in local.keyframes.iter().enumerate() {
            let public = &map.keyframes[&KeyframeId(index as u32)];
            let pose = public.world_from_keyframe;
            assert_eq!(pose.scale, 1.0);
            assert!((pose.rigid() * state.camera_from_world).log().norm() < 1e-12);
            assert_eq!(*public.image, *state.pyramid.base());
            assert_eq!(public.points.len(), state.points.len());
            let (a, b) = (&public.points[0], &state.points[0]);
            assert_eq!(
                (a.pixel, a.inverse_depth, a.observations.len()),
                (b.pixel, b.inverse_depth as f32, b.observations.len())
            );
        }
    }

    #[test]
    fn surroundings_are_scaled_with_the_unit() {
        let (_, before) = published();
        let mut map = before.clone();
        scale_surroundings(&mut map, &[UnitChange { keyframe: 1, factor: 2.0 }]);
        let id = KeyframeId(1);
        assert!(!map.keyframes[&id].points.is_empty());
        assert_eq!(map.keyframes[&KeyframeId(0)], before.keyframes[&KeyframeId(0)]);
        assert_eq!(map.frames[0], before.frames[0]);
        let (old, new) = (before.frames[1].keyframe_from_frame, map.frames[1].keyframe_from_frame);
        assert_eq!(new, Se3::new(old.rotation, old.translation * 2.0));
        assert_eq!(map.keyframes[&id].semi_dense.inverse_depth, [0.25, 0.125]);
        assert_eq!(map.keyframes[&id].semi_dense.variance, [0.01, 0.0025]);
        assert_eq!(map.keyframes[&id].semi_dense.pixel, [7, 9]);
        for (new, old) in map.keyframes[&id].points.iter().zip(&before.keyframes[&id].points) {
            assert_eq!((new.inverse_depth, new.variance), (old.inverse_depth / 2.0, old.variance / 4.0));
            assert_eq!((new.pixel, &new.observations), (old.pixel, &old.observations));
        }
        scale_surroundings(&mut map, &[UnitChange { keyframe: 1, factor: 0.5 }]);
        assert_eq!(map, before);
        scale_surroundings(&mut map, &[UnitChange { keyframe: 17, factor: 3.0 }]);
        assert_eq!(map, before, "a keyframe that is not public yet has no surroundings");
    }

    #[test]
    fn the_end_brings_poses_and_points_up_to_date() {
        let (mut local, mut map) = published();
        local.keyframes[1].camera_from_world = pose(1.0, 0.0, 0.0, 0.2, 0.0).inverse();
        local.keyframes[1].points[0].alive = false;
        local.keyframes[1].points[1].inverse_depth = 0.75;
        let points = local.keyframes[1].points.len();
        complete(&mut map, &local, Vec::new());
        let public = &map.keyframes[&KeyframeId(1)];
        assert!(
            (public.world_from_keyframe.rigid() * local.keyframes[1].camera_from_world).log().norm() < 1e-12
        );
        assert_eq!(public.points.len(), points - 1);
        assert_eq!(public.points[0].inverse_depth, 0.75);
        assert_eq!(public.semi_dense.len(), 2);
    }
}
