//! The worlds and units that maps come in do not matter.

use crate::merging::{first_and_opposite, fused, merged, pair_result};
use crate::yard::{first, opposite};
use geometry::Sim3;
use map::{KeyframeId, Map};
use merge::estimate::Estimate;
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::LazyLock;

/// How much of the path, of a turn in radians and of a scale the results may differ by.
const TOLERANCE: f64 = 1e-3;

/// The first and the opposite drive merged as they came.
fn plain() -> &'static Map {
    static PLAIN: LazyLock<Map> = LazyLock::new(|| {
        fused(&merged(&[&first().end, &opposite().end], &[([0, 1], first_and_opposite())]).0).map
    });
    &PLAIN
}

/// The map in another world.
fn moved(map: &Map, motion: &Sim3) -> Map {
    let mut moved = map.clone();
    for keyframe in moved.keyframes.values_mut() {
        keyframe.world_from_keyframe = *motion * keyframe.world_from_keyframe;
    }
    moved
}

/// The same map in the same world where keyframe `id` counts lengths in units of `unit(id)` times what it did.
fn in_units(map: &Map, unit: impl Fn(KeyframeId) -> f64) -> Map {
    let old_from_new = |id| Sim3 { scale: unit(id), ..Sim3::identity() };
    let mut changed = map.clone();
    for (id, keyframe) in &mut changed.keyframes {
        let factor = unit(*id) as f32;
        keyframe.world_from_keyframe = keyframe.world_from_keyframe * old_from_new(*id);
        keyframe.semi_dense.inverse_depth.iter_mut().for_each(|d| *d *= factor);
        keyframe.semi_dense.variance.iter_mut().for_each(|v| *v *= factor * factor);
        for point in &mut keyframe.points {
            point.inverse_depth *= factor;
            point.variance *= factor * factor;
        }
    }
    for edge in &mut changed.edges {
        let old = Estimate { a_from_b: edge.from_from_to, information: edge.information };
        let new = old.carried(&old_from_new(edge.from).inverse(), &old_from_new(edge.to));
        let new = new.expect("an edge fixes all degrees of freedom");
        (edge.from_from_to, edge.information) = (new.a_from_b, new.information);
    }
    for frame in &mut changed.frames {
        frame.keyframe_from_frame.translation /= unit(frame.reference);
    }
    changed
}

/// Fails unless the merged map is that of the maps as they came, moved by `motion`, its keyframes in units of `unit`
/// times theirs.
fn assert_same(found: &Map, motion: &Sim3, unit: impl Fn(KeyframeId) -> f64) {
    let plain = plain();
    let cameras =
        |map: &Map| map.keyframes.values().map(|k| k.world_from_keyframe.translation).collect::<Vec<_>>();
    let places = cameras(plain);
    let extent = places.iter().map(|p| (p - places[0]).norm()).fold(0.0, f64::max) * motion.scale;
    assert_eq!(found.keyframes.len(), plain.keyframes.len());
    for (id, keyframe) in &found.keyframes {
        let expected = *motion * plain.keyframes[id].world_from_keyframe;
        let pose = keyframe.world_from_keyframe;
        let shift = (pose.translation - expected.translation).norm() / extent;
        let rotation = pose.rotation.angle_to(&expected.rotation);
        let scale = (pose.scale / (expected.scale * unit(*id))).ln().abs();
        let worst = shift.max(rotation).max(scale);
        assert!(worst <= TOLERANCE, "{id:?}: shift {shift:.2e}, turn {rotation:.2e}, scale {scale:.2e}");
    }
}

/// A motion to anywhere, with the world's unit `1 / scale` of what it was.
fn far(scale: f64, side: f64) -> Sim3 {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(2.0, -1.0, 0.7) * side);
    Sim3::new(rotation, Vector3::new(80.0, -30.0, 50.0) * side, scale)
}

#[test]
fn maps_merge_equally_wherever_and_however_large_they_are() {
    let one = Sim3::identity();
    for [of_a, of_c] in [[far(0.2, 1.0), far(5.0, -1.0)], [one, far(0.2, -0.6)]] {
        let (a, c) = (moved(&first().end, &of_a), moved(&opposite().end, &of_c));
        let merged = fused(&merged(&[&a, &c], &[([0, 1], &pair_result(&a, &c))]).0);
        assert_same(&merged.map, &of_a, |_| 1.0);
    }
}

#[test]
fn keyframes_may_have_units_of_their_own() {
    let cycle = [1.0, 0.2, 2.5, 5.0, 0.7];
    let unit = |id: KeyframeId| cycle[id.0 as usize % cycle.len()];
    let (a, c) = (in_units(&first().end, unit), in_units(&opposite().end, |_| 0.2));
    let motion = far(5.0, 0.5);
    let a = moved(&a, &motion);
    let merged = fused(&merged(&[&a, &c], &[([0, 1], &pair_result(&a, &c))]).0);
    let first_of_c =
        merged.map.agents.values().nth(1).and_then(|info| info.own.as_ref()).unwrap().first_keyframe;
    assert_same(&merged.map, &motion, |id| if id.0 < first_of_c { unit(id) } else { 0.2 });
}
