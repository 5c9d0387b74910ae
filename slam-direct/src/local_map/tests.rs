use super::*;
use crate::test_scene::{CAMERA, View, bare_map, exact_map, point_state, pose};

fn views() -> Vec<View> {
    [0.0, 0.4].iter().map(|&x| View::new(pose(x, 0.0, 0.1 * x, -0.1 * x, 0.0))).collect()
}

#[test]
fn a_map_that_is_appended_looks_the_same_from_its_keyframes() {
    let views = views();
    let (mut map, mut other) = (exact_map(&views, 16), exact_map(&views, 16));
    // The other map in a world and a unit of its own: a third as long, turned and moved.
    let other_from_own = Sim3::new(
        nalgebra::UnitQuaternion::from_euler_angles(0.2, -0.5, 0.1),
        Vector3::new(0.7, -2.0, 0.3),
        1.0 / 3.0,
    );
    for state in other.keyframes.iter_mut().map(|state| &mut **state) {
        let world = other_from_own * Sim3::from(state.camera_from_world.inverse());
        state.camera_from_world = world.rigid().inverse();
        state.scale = world.scale;
        state.points.iter_mut().for_each(|point| point.inverse_depth *= 3.0);
    }
    map.append(other, &other_from_own.inverse());
    assert_eq!(map.keyframes.len(), 4);
    for (own, appended) in [(0, 2), (1, 3)] {
        let [a, b] = [own, appended].map(|k| &map.keyframes[k]);
        assert!((a.camera_from_world * b.camera_from_world.inverse()).log().norm() < 1e-12);
        assert!((a.scale - b.scale).abs() < 1e-12);
        let [a, b] = [own, appended].map(|k| map.reference_points(k));
        assert_eq!(a.len(), b.len());
        let gap = |(a, b): (&ReferencePoint, &ReferencePoint)| (a.inverse_depth - b.inverse_depth).abs();
        assert!(a.iter().zip(&b).map(gap).fold(0.0, f32::max) < 1e-5);
    }
    assert_eq!(map.covisible(2), [(3, map.covisible(0)[0].1)], "they share points with none of the first");
}

#[test]
fn a_map_that_is_appended_and_split_off_again_is_as_it_was() {
    let views = views();
    let mut map = exact_map(&views, 16);
    let (first, other) = (map.clone(), exact_map(&views, 12));
    map.append(other.clone(), &Sim3::identity());
    // The last keyframe sees a point of the first one, and its own point is seen there alone.
    let own = PointRef { host: 3, index: map.keyframes[3].points.len() };
    let seen = |keyframe| SeenAt { keyframe, pixel: [5.0, 6.0], information: [1.0, 0.0, 1.0] };
    let across = PointState { observations: vec![seen(0)], ..map.keyframes[3].points[0].clone() };
    map.keyframes[3].points.push(across);
    map.keyframes[0].seen.push(own);
    map.observe(PointRef { host: 0, index: 0 }, seen(3));
    let mut later = map.split_off(2);
    assert!(!later.point(PointRef { host: 1, ..own }).alive);
    later.keyframes[1].points.pop();
    for (part, expected) in [(&map, &first), (&later, &other)] {
        assert_eq!(part.keyframes.len(), 2);
        let of = |map: &LocalMap| {
            format!("{:?}", map.keyframes.iter().map(|k| (&k.points, &k.seen)).collect::<Vec<_>>())
        };
        assert!(of(part) == of(expected));
    }
}

#[test]
fn reference_points_lie_where_the_keyframe_sees_them() {
    let views = views();
    let map = exact_map(&views, 16);
    let hosted = map.keyframes[1].points.len();
    let points = map.reference_points(1);
    assert_eq!(points.len(), hosted + map.keyframes[1].seen.len());
    for (point, state) in points.iter().zip(&map.keyframes[1].points) {
        assert_eq!((point.pixel, point.inverse_depth), (state.pixel, state.inverse_depth as f32));
    }
    assert!(points.len() > hosted + 20);
    for (point, &at) in points[hosted..].iter().zip(&map.keyframes[1].seen) {
        let host = map.point(at);
        let world = views[0].world_from_camera * (host.ray / host.inverse_depth);
        let here = views[1].world_from_camera.inverse() * world;
        let pixel = CAMERA.project(&here);
        assert!((pixel.x as f32 - point.pixel[0]).hypot(pixel.y as f32 - point.pixel[1]) < 1e-3);
        assert!((point.inverse_depth * here.z as f32 - 1.0).abs() < 1e-5);
        // Seen from farther away the same error of depth is a smaller one of inverse depth.
        let relative = |variance: f64, inverse_depth: f64| variance / inverse_depth.powi(2);
        let (own, hosts) = (
            relative(point.variance as f64, point.inverse_depth as f64),
            relative(host.variance, host.inverse_depth),
        );
        assert!((own / hosts - 1.0).abs() < 1e-3);
    }
}

#[test]
fn the_dead_and_those_behind_are_no_reference_points() {
    let views = views();
    let mut map = exact_map(&views, 30);
    let before = map.reference_points(0).len();
    map.keyframes[0].points[0].alive = false;
    assert_eq!(map.reference_points(0).len(), before - 1);
    map.keyframes[1].camera_from_world = pose(0.0, 0.0, 0.0, std::f64::consts::PI, 0.0).inverse()
        * pose(0.0, 0.0, 0.0, 0.0, 0.0)
        * map.keyframes[1].camera_from_world;
    assert_eq!(map.reference_points(1).len(), map.keyframes[1].points.len());
}

#[test]
fn covisible_keyframes_are_counted_and_ordered() {
    let views = views();
    let mut map =
        bare_map(&[0, 1, 0, 1].map(|i| View { pyramid: views[i].pyramid.clone(), ..copy(&views[i]) }));
    // Who hosts → who sees.
    for (host, watchers) in [(0, vec![1, 2]), (0, vec![1]), (1, vec![2]), (2, vec![1]), (2, vec![3])] {
        let index = map.keyframes[host].points.len();
        map.keyframes[host].points.push(point_state(views[0].points(60)[0]));
        for keyframe in watchers {
            let seen = SeenAt { keyframe, pixel: [0.0; 2], information: [1.0; 3] };
            map.observe(PointRef { host, index }, seen);
        }
    }
    assert_eq!(map.covisible(1), [(2, 3), (0, 2)]);
    assert_eq!(map.covisible(0), [(1, 2), (2, 1)]);
    assert_eq!(map.covisible(3), [(2, 1)]);
    map.keyframes[2].points[0].alive = false;
    assert_eq!(map.covisible(1), [(2, 2), (0, 2)], "of equals the newer comes first");
    assert_eq!(map.points_of(1).count(), 3);
}

fn copy(view: &View) -> View {
    View {
        world_from_camera: view.world_from_camera,
        pyramid: view.pyramid.clone(),
        inverse_depth: view.inverse_depth.clone(),
    }
}

#[test]
fn searched_and_found_points_are_counted() {
    let mut map = exact_map(&views(), 40);
    let at = |index| PointRef { host: 0, index };
    let matched = |index, inlier| Matched {
        at: at(index),
        pixel: [0.0; 2],
        information: [1.0; 3],
        rmse: 1.0,
        squared: 0.0,
        inlier,
    };
    let mut frame = Counts::default();
    frame.add(&[at(0), at(1), at(2)], &[matched(0, true), matched(1, false)]);
    assert_eq!(frame.hosts().collect::<Vec<_>>(), [0]);
    map.count(&frame);
    let counts: Vec<_> = map.keyframes[0].points[..3].iter().map(|p| (p.searched, p.found)).collect();
    assert_eq!(counts, [(1, 1), (1, 0), (1, 0)]);
}
