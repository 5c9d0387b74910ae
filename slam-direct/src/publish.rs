//! Converts the working map to the public map.

use crate::local_map::{LocalMap, PointState};
use map::{Edge, Keyframe, KeyframeId, Map, Moved, Observation, Point};

/// A keyframe with its image, its pose, and its depth once that is known; without points.
pub(crate) fn keyframe(local: &LocalMap, keyframe: usize) -> Keyframe {
    let state = &local.keyframes[keyframe];
    let (id, pose) = (LocalMap::id(keyframe), local.world_from_keyframe(keyframe));
    let bare = Keyframe::of_image(id, state.timestamp, state.frame_index, pose, state.pyramid.shared_base());
    Keyframe { semi_dense: state.semi_dense.clone(), ..bare }
}

/// The pose of a keyframe now.
pub(crate) fn moved(local: &LocalMap, keyframe: usize) -> Moved {
    Moved { keyframe: LocalMap::id(keyframe), world_from_keyframe: local.world_from_keyframe(keyframe) }
}

/// Brings poses, points and edges to where they stand: of a map whose keyframes begin with the `first` of the working map.
pub(crate) fn complete(map: &mut Map, local: &LocalMap, first: usize, edges: Vec<Edge>) {
    map.edges = edges;
    for (id, keyframe) in &mut map.keyframes {
        let index = id.0 as usize + first;
        if index < local.keyframes.len() {
            keyframe.world_from_keyframe = local.world_from_keyframe(index);
            keyframe.points = own_points(points(local, index), first);
        }
    }
}

/// What a map whose keyframes begin with the `first` of the working map calls one of these; `None` of those before.
pub(crate) fn own_id(id: KeyframeId, first: usize) -> Option<KeyframeId> {
    (id.0 as usize).checked_sub(first).map(LocalMap::id)
}

/// Points without what keyframes before the `first` of the working map observe of them, which is the first of a map.
pub(crate) fn own_points(mut points: Vec<Point>, first: usize) -> Vec<Point> {
    for point in points.iter_mut().filter(|_| first > 0) {
        let seen = std::mem::take(&mut point.observations);
        let own = |o: Observation| Some(Observation { keyframe: own_id(o.keyframe, first)?, ..o });
        point.observations = seen.into_iter().filter_map(own).collect();
    }
    points
}

/// The living points that a keyframe hosts, in its unit; without those that single precision cannot hold, of which a map
/// that went astray may have some.
pub(crate) fn points(local: &LocalMap, keyframe: usize) -> Vec<Point> {
    let state = &local.keyframes[keyframe];
    let living = state.points.iter().filter(|p| p.alive).map(|p| point(p, state.scale));
    living.filter(is_finite).collect()
}

fn is_finite(point: &Point) -> bool {
    let seen = |o: &Observation| o.pixel.iter().chain(&o.information).all(|v| v.is_finite());
    point.inverse_depth.is_finite() && point.variance.is_finite() && point.observations.iter().all(seen)
}

fn point(state: &PointState, scale: f64) -> Point {
    let observation = |o: &crate::local_map::SeenAt| Observation {
        keyframe: LocalMap::id(o.keyframe),
        pixel: o.pixel,
        information: o.information,
    };
    Point {
        pixel: state.pixel,
        inverse_depth: (state.inverse_depth * scale) as f32,
        variance: (state.variance * scale * scale) as f32,
        observations: state.observations.iter().map(observation).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{CAMERA, View, exact_map, pose};

    fn local() -> LocalMap {
        let views: Vec<View> = [0.0, 0.4].iter().map(|&x| View::new(pose(x, 0.0, 0.0, 0.0, 0.0))).collect();
        exact_map(&views, 30)
    }

    #[test]
    fn keyframes_carry_pose_unit_image_and_points() {
        let mut local = local();
        local.keyframes[1].scale = 2.0;
        let mut map = Map::new(CAMERA);
        for index in 0..2 {
            let keyframe = keyframe(&local, index);
            assert!(keyframe.points.is_empty() && keyframe.semi_dense.is_empty());
            map.keyframes.insert(keyframe.id, keyframe);
        }
        complete(&mut map, &local, 0, Vec::new());
        for (index, state) in local.keyframes.iter().enumerate() {
            let public = &map.keyframes[&LocalMap::id(index)];
            let pose = public.world_from_keyframe;
            assert_eq!(pose.scale, state.scale);
            assert!((pose.rigid() * state.camera_from_world).log().norm() < 1e-12);
            assert_eq!(*public.image, *state.pyramid.base());
            assert_eq!(public.points.len(), state.points.len());
            for (a, b) in public.points.iter().zip(&state.points) {
                assert_eq!((a.pixel, a.observations.len()), (b.pixel, b.observations.len()));
                // The same place in the world, by the pose handed out as by the working map.
                let handed = pose * (b.ray / f64::from(a.inverse_depth));
                let known = state.camera_from_world.inverse() * (b.ray / b.inverse_depth);
                assert!((handed - known).norm() < 1e-5 * known.norm(), "{handed} {known}");
                let relative = |variance: f64, depth: f64| variance / (depth * depth);
                let (own, expected) = (
                    relative(a.variance.into(), a.inverse_depth.into()),
                    relative(b.variance, b.inverse_depth),
                );
                assert!((own / expected - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn frames_stay_where_they_are_measured_when_the_unit_changes() {
        let mut local = local();
        let frame_from_world = pose(0.55, 0.0, 0.1, 0.02, 0.0).inverse();
        let measured = local.keyframe_from_frame(1, &frame_from_world);
        let before = local.world_from_keyframe(1) * geometry::Sim3::from(measured);
        assert!((before.rigid() * frame_from_world).log().norm() < 1e-12);
        // The world grows by a half.
        let state = &mut local.keyframes[1];
        state.camera_from_world.translation *= 1.5;
        state.scale *= 1.5;
        let after = local.world_from_keyframe(1) * geometry::Sim3::from(measured);
        assert!((after.translation - before.translation * 1.5).norm() < 1e-12);
        assert_eq!(moved(&local, 1).world_from_keyframe.scale, 1.5);
    }

    #[test]
    fn dead_points_are_not_handed_out() {
        let mut local = local();
        let count = local.keyframes[1].points.len();
        local.keyframes[1].points[0].alive = false;
        local.keyframes[1].points[1].inverse_depth = 0.75;
        let points = points(&local, 1);
        assert_eq!((points.len(), points[0].inverse_depth), (count - 1, 0.75));
    }

    #[test]
    fn points_that_a_file_cannot_hold_are_not_handed_out() {
        let mut local = local();
        let count = local.keyframes[1].points.len();
        local.keyframes[1].points[0].variance = 1e300;
        local.keyframes[1].points[1].inverse_depth = f64::NAN;
        local.keyframes[1].points[2].observations[0].information[1] = f32::INFINITY;
        assert_eq!(points(&local, 1).len(), count - 3);
    }
}
