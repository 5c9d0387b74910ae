//! Maps made of other maps: a part of one, and one moved and in other units.

use geometry::Sim3;
use map::{AgentInfo, Edge, FramePose, Keyframe, KeyframeId, Map};
use nalgebra::{SMatrix, SVector};
use std::collections::BTreeSet;
use std::ops::Range;

/// A part of a map of one agent as a map of its own: the keyframes at the positions of `range` in their order, the
/// edges and observations among them, and the frames that were tracked against them. The world stays.
pub fn cut(map: &Map, range: Range<usize>) -> Map {
    let kept: BTreeSet<KeyframeId> =
        map.keyframes.keys().skip(range.start).take(range.len()).copied().collect();
    let keyframe = |id: &KeyframeId| {
        let mut keyframe = map.keyframes.get(id)?.clone();
        keyframe.points.iter_mut().for_each(|p| p.observations.retain(|o| kept.contains(&o.keyframe)));
        Some((*id, keyframe))
    };
    let within = |edge: &&Edge| kept.contains(&edge.from) && kept.contains(&edge.to);
    // A part is not the run that it is of.
    let nameless = |info: &AgentInfo| AgentInfo { identity: None, ..info.clone() };
    Map {
        agents: map.agents.iter().map(|(agent, info)| (*agent, nameless(info))).collect(),
        keyframes: kept.iter().filter_map(keyframe).collect(),
        edges: map.edges.iter().filter(within).cloned().collect(),
        frames: map.frames.iter().filter(|frame| kept.contains(&frame.reference)).copied().collect(),
        merge_provenance: map.merge_provenance.clone(),
    }
}

/// The same map in another world and other units: `other_from_world` moves its world; afterwards each keyframe's own
/// unit is `keyframe_scale` times as large, whose lengths are therefore smaller numbers.
pub fn moved(map: &Map, other_from_world: &Sim3, keyframe_scale: f64) -> Map {
    let keyframe = |(id, keyframe): (&KeyframeId, &Keyframe)| {
        (*id, keyframe_moved(keyframe, other_from_world, keyframe_scale))
    };
    Map {
        agents: map.agents.clone(),
        keyframes: map.keyframes.iter().map(keyframe).collect(),
        edges: map.edges.iter().map(|edge| rescaled_edge(edge, keyframe_scale)).collect(),
        frames: map.frames.iter().map(|frame| rescaled_frame(*frame, keyframe_scale)).collect(),
        merge_provenance: map.merge_provenance.clone(),
    }
}

fn keyframe_moved(keyframe: &Keyframe, other_from_world: &Sim3, keyframe_scale: f64) -> Keyframe {
    let mut keyframe = keyframe.clone();
    keyframe.world_from_keyframe = *other_from_world * keyframe.world_from_keyframe;
    keyframe.world_from_keyframe.scale *= keyframe_scale;
    let factor = keyframe_scale as f32;
    keyframe.semi_dense.inverse_depth.iter_mut().for_each(|depth| *depth *= factor);
    keyframe.semi_dense.variance.iter_mut().for_each(|variance| *variance *= factor * factor);
    for point in &mut keyframe.points {
        point.inverse_depth *= factor;
        point.variance *= factor * factor;
    }
    keyframe
}

/// An edge between keyframes whose units became `keyframe_scale` times as large.
fn rescaled_edge(edge: &Edge, keyframe_scale: f64) -> Edge {
    let mut edge = edge.clone();
    edge.from_from_to.translation /= keyframe_scale;
    // A perturbation's translation becomes a smaller number by `keyframe_scale`, the rest of it stays.
    let former = SMatrix::<f64, 7, 7>::from_diagonal(&SVector::from([
        keyframe_scale,
        keyframe_scale,
        keyframe_scale,
        1.0,
        1.0,
        1.0,
        1.0,
    ]));
    edge.information = former * edge.information * former;
    edge
}

fn rescaled_frame(mut frame: FramePose, keyframe_scale: f64) -> FramePose {
    frame.keyframe_from_frame.translation /= keyframe_scale;
    frame
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Se3};
    use map::{AgentId, EdgeKind, Observation, Point, SemiDense};
    use nalgebra::{UnitQuaternion, Vector3};
    use std::sync::Arc;

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };

    fn pose(i: u32) -> Sim3 {
        let i = f64::from(i);
        let rotation = UnitQuaternion::from_euler_angles(0.1 * i, 0.2, -0.1 * i);
        Sim3::new(rotation, Vector3::new(i, 0.5, 0.2 * i), 1.0 + 0.1 * i)
    }

    /// Five keyframes in a row, numbered 0, 2, 4, …, each with a point that all see, and two frames.
    fn row() -> Map {
        let mut map = Map::new(CAMERA);
        for id in (0..5).map(|i| KeyframeId(2 * i)) {
            let sees = |i: u32| Observation {
                keyframe: KeyframeId(2 * i),
                pixel: [1.0; 2],
                information: [1.0, 0.0, 1.0],
            };
            let observations = (0..5).map(sees).collect();
            let point = Point { pixel: [1.0, 1.0], inverse_depth: 0.5, variance: 0.01, observations };
            let keyframe = Keyframe {
                id,
                agent: AgentId::default(),
                timestamp: f64::from(id.0),
                frame_index: u64::from(id.0),
                world_from_keyframe: pose(id.0),
                image: Arc::new(GrayImage::filled(4, 3, 0)),
                color: None,
                scan: None,
                semi_dense: SemiDense {
                    pixel: vec![5].into(),
                    inverse_depth: vec![0.5].into(),
                    variance: vec![0.01].into(),
                }
                .into(),
                points: vec![point],
                features: None,
                words: None,
            };
            map.keyframes.insert(id, keyframe);
            for frame_index in [u64::from(id.0), u64::from(id.0) + 1] {
                let motion =
                    Se3::new(UnitQuaternion::identity(), Vector3::new(0.3, 0.0, 0.1 * frame_index as f64));
                let timestamp = frame_index as f64;
                map.frames.push(FramePose {
                    timestamp,
                    frame_index,
                    reference: id,
                    keyframe_from_frame: motion,
                });
            }
            if id.0 > 0 {
                let from = KeyframeId(id.0 - 2);
                map.edges.push(Edge {
                    from,
                    to: id,
                    from_from_to: pose(from.0).inverse() * pose(id.0) * Sim3::exp(&SVector::from([0.01; 7])),
                    information: SMatrix::identity(),
                    kind: EdgeKind::Odometry,
                });
            }
        }
        map
    }

    #[test]
    fn a_cut_holds_what_lies_within_it() {
        let whole = row();
        let part = cut(&whole, 1..4);
        let ids = [2, 4, 6].map(KeyframeId);
        assert_eq!(part.keyframes.keys().copied().collect::<Vec<_>>(), ids);
        assert_eq!(
            part.edges.iter().map(|e| (e.from, e.to)).collect::<Vec<_>>(),
            [(ids[0], ids[1]), (ids[1], ids[2])]
        );
        assert_eq!(part.frames.iter().map(|f| f.frame_index).collect::<Vec<_>>(), [2, 3, 4, 5, 6, 7]);
        let observed =
            |id| part.keyframes[&id].points[0].observations.iter().map(|o| o.keyframe).collect::<Vec<_>>();
        assert!(ids.iter().all(|id| observed(*id) == ids));
        assert_eq!(part.keyframes[&ids[0]].world_from_keyframe, pose(2));
        assert_eq!(cut(&whole, 0..5), whole);
        assert!(cut(&whole, 7..9).keyframes.is_empty());
    }

    #[test]
    fn a_cut_can_be_saved() {
        let folder = tempfile::tempdir().unwrap();
        let (path, part) = (folder.path().join("map.mcap"), cut(&row(), 1..4));
        map::save_map(&path, &part).unwrap();
        assert_eq!(map::load_map(&path).unwrap().map, part);
    }

    /// The residual of an edge, squared and weighted by its information.
    fn cost(map: &Map, edge: &Edge) -> f64 {
        let pose = |id| map.keyframes[&id].world_from_keyframe;
        let residual = (pose(edge.from).inverse() * pose(edge.to) * edge.from_from_to.inverse()).log();
        residual.dot(&(edge.information * residual))
    }

    #[test]
    fn a_moved_map_is_the_same_elsewhere() {
        let (map, motion) = (row(), Sim3::exp(&SVector::from([3.0, -1.0, 2.0, 0.5, -0.7, 0.2, 1.2])));
        let there = moved(&map, &motion, 2.5);
        for (before, after) in map.trajectory().iter().zip(there.trajectory()) {
            let expected = motion * before.world_from_camera.translation;
            assert!((after.world_from_camera.translation - expected).norm() < 1e-9);
            let rotated = motion.rotation * before.world_from_camera.rotation;
            assert!(after.world_from_camera.rotation.angle_to(&rotated) < 1e-7);
        }
        for (id, keyframe) in &there.keyframes {
            let point = |keyframe: &Keyframe| {
                let depth = 1.0 / f64::from(keyframe.semi_dense.inverse_depth[0]);
                keyframe.world_from_keyframe * (CAMERA.unproject(1.0, 1.0) * depth)
            };
            assert!((point(keyframe) - motion * point(&map.keyframes[id])).norm() < 1e-5);
            let relative = |k: &Keyframe| k.semi_dense.variance[0] / k.semi_dense.inverse_depth[0].powi(2);
            assert!((relative(keyframe) / relative(&map.keyframes[id]) - 1.0).abs() < 1e-5);
        }
        for (before, after) in map.edges.iter().zip(&there.edges) {
            assert!((cost(&there, after) / cost(&map, before) - 1.0).abs() < 1e-9);
        }
    }
}
