//! Carrying the working map over to the public one.

use crate::local_map::{LocalMap, PointState};
use crate::mapping::UnitChange;
use geometry::Sim3;
use map::{Edge, Keyframe, Map, Observation, Point, SemiDense};
use std::collections::BTreeMap;

/// Adds a keyframe with its image and pose; depth and points follow when they are known.
pub(crate) fn add_keyframe(map: &mut Map, local: &LocalMap, keyframe: usize) {
    let state = &local.keyframes[keyframe];
    let id = LocalMap::id(keyframe);
    map.keyframes.insert(
        id,
        Keyframe {
            id,
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

/// Scales what was measured relative to the keyframes whose unit has changed: frames and semi-dense depth.
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
        }
    }
}

/// Brings inverse depths to a unit in which lengths are `factor` times what they were.
pub(crate) fn scale_depth(depth: &mut SemiDense, factor: f64) {
    let factor = factor as f32;
    depth.inverse_depth.iter_mut().for_each(|d| *d /= factor);
    depth.variance.iter_mut().for_each(|v| *v /= factor * factor);
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
