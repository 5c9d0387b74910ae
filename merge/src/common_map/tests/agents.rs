//! Agents whose way is known exactly, and closures between them.

use super::{Address, Link};
use crate::estimate::Estimate;
use crate::test_support::Numbers;
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use map::{AgentId, AgentInfo, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Map, SemiDense};
use nalgebra::{SMatrix, SVector, Vector3};
use std::sync::Arc;

const CAMERA: Pinhole = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
/// Depth of what all keyframes see, true units.
const DEPTH: f64 = 5.0;

/// An agent on its way.
#[derive(Clone)]
pub(super) struct Traveller {
    seed: u64,
    /// Where its keyframes truly are, each with a unit of its own.
    pub truth_from_keyframe: Vec<Sim3>,
    own_from_truth: Sim3,
}

impl Traveller {
    /// Along x by one true unit a keyframe, in a world of its own; another seed gives another agent.
    pub fn new(seed: u64, count: usize) -> Self {
        let numbers = &mut Numbers::new(seed);
        let aside = numbers.vector(0.5);
        let truth_from_keyframe = (0..count)
            .map(|k| {
                let place = Vector3::new(k as f64, 0.0, 0.0) + aside + numbers.vector(0.1);
                Sim3::new(numbers.rotation(0.1), place, numbers.uniform(-0.5, 0.5).exp())
            })
            .collect();
        Self { seed, truth_from_keyframe, own_from_truth: Sim3::identity() }.in_another_world(seed)
    }

    /// The same way told in another world and unit.
    pub fn in_another_world(&self, seed: u64) -> Self {
        let numbers = &mut Numbers::new(seed + 1000);
        let scale = numbers.uniform(-1.5, 1.5).exp();
        let own_from_truth = Sim3::new(numbers.rotation(1.5), numbers.vector(10.0), scale);
        Self { own_from_truth, ..self.clone() }
    }

    /// The same way where every keyframe's unit is the true one, and its world's too: a LiDAR's.
    pub fn in_metres(&self) -> Self {
        let truth_from_keyframe = self.truth_from_keyframe.iter().map(|pose| pose.rigid().into()).collect();
        Self { truth_from_keyframe, own_from_truth: self.own_from_truth.rigid().into(), ..self.clone() }
    }

    /// The agent when it had that many keyframes.
    pub fn first(&self, count: usize) -> Self {
        Self { truth_from_keyframe: self.truth_from_keyframe[..count].to_vec(), ..self.clone() }
    }

    /// Its own map, exact.
    pub fn own_map(&self) -> Map {
        let poses = self.truth_from_keyframe.iter().map(|pose| self.own_from_truth * *pose);
        self.map_of(poses.collect(), 1e8)
    }

    /// Its own map where every step makes the map larger by the share `drift`, and its edges know no better.
    pub fn drifted_map(&self, drift: f64) -> Map {
        let truth = &self.truth_from_keyframe;
        let mut poses = vec![self.own_from_truth * truth[0]];
        let growth = Sim3 { scale: 1.0 + drift, ..Sim3::identity() };
        for (k, pair) in truth.windows(2).enumerate() {
            poses.push(poses[k] * growth * pair[0].inverse() * pair[1]);
        }
        self.map_of(poses, drift.powi(-2))
    }

    fn map_of(&self, own_from_keyframe: Vec<Sim3>, information: f64) -> Map {
        let mut map = Map::of(AgentInfo::new(format!("agent {}", self.seed), CAMERA));
        for (earlier, pair) in own_from_keyframe.windows(2).enumerate() {
            map.edges.push(Edge {
                from: KeyframeId(earlier as u32),
                to: KeyframeId(earlier as u32 + 1),
                from_from_to: pair[0].inverse() * pair[1],
                information: SMatrix::identity() * information,
                kind: EdgeKind::Odometry,
            });
        }
        for (k, world_from_keyframe) in own_from_keyframe.into_iter().enumerate() {
            let (id, unit) = (KeyframeId(k as u32), self.truth_from_keyframe[k].scale);
            let (frame_index, timestamp) = (k as u64, self.seed as f64 * 100.0 + k as f64);
            let pixel = vec![0, 9, 20, 40];
            let semi_dense = SemiDense {
                inverse_depth: vec![(unit / DEPTH) as f32; pixel.len()].into(),
                variance: vec![1e-4; pixel.len()].into(),
                pixel: pixel.into(),
            };
            let image = Arc::new(GrayImage::filled(CAMERA.width, CAMERA.height, k as u8));
            let (agent, points) = (AgentId(0), Vec::new());
            let keyframe = Keyframe {
                id,
                agent,
                timestamp,
                frame_index,
                world_from_keyframe,
                image,
                color: None,
                scan: None,
                semi_dense: semi_dense.into(),
                points,
                features: None,
                words: None,
            };
            map.keyframes.insert(id, keyframe);
            map.frames.push(FramePose {
                frame_index,
                timestamp,
                reference: id,
                keyframe_from_frame: Se3::identity(),
            });
        }
        map
    }
}

/// The closure between two keyframes of travellers as it truly is.
pub(super) fn exact(travellers: &[&Traveller], from: Address, to: Address) -> Link {
    // Keyframes that are not there are put anywhere: such closures are made to be refused.
    let pose = |of: &Address| {
        let traveller = travellers.get(usize::from(of.agent.0));
        let pose = traveller.and_then(|t| t.truth_from_keyframe.get(of.keyframe.0 as usize));
        pose.copied().unwrap_or(Sim3::identity())
    };
    let information = SMatrix::identity() * 1e6;
    Link { from, to, from_from_to: Estimate { a_from_b: pose(&from).inverse() * pose(&to), information } }
}

/// The closure moved by about `size` in each of its degrees of freedom.
pub(super) fn far_off(mut link: Link, size: f64) -> Link {
    let shift = SVector::from([size, -size, size, -0.3 * size, 0.3 * size, 0.3 * size, 0.2 * size]);
    link.from_from_to.a_from_b = Sim3::exp(&shift) * link.from_from_to.a_from_b;
    link
}

/// The largest distance of a keyframe from where it truly is, true units and radians and logarithm of scale, where
/// the first keyframe of the first agent is.
pub(super) fn worst(map: &Map, travellers: &[&Traveller]) -> f64 {
    let mut keyframes = map.keyframes.values();
    let first = map.keyframes.values().next().unwrap();
    let truth_from_map = travellers[0].truth_from_keyframe[0] * first.world_from_keyframe.inverse();
    let mut worst: f64 = 0.0;
    for (number, traveller) in travellers.iter().enumerate() {
        for truth in &traveller.truth_from_keyframe {
            let keyframe = keyframes.next().unwrap();
            assert_eq!(usize::from(keyframe.agent.0), number);
            let found = truth_from_map * keyframe.world_from_keyframe;
            let shift = (found.translation - truth.translation).norm();
            let rotation = found.rotation.angle_to(&truth.rotation);
            worst = worst.max(shift).max(rotation).max((found.scale / truth.scale).ln().abs());
        }
    }
    assert!(keyframes.next().is_none(), "no more keyframes than the agents have");
    worst
}

/// Fails unless every keyframe is where it truly is.
pub(super) fn assert_near(map: &Map, travellers: &[&Traveller], tolerance: f64) {
    let worst = worst(map, travellers);
    assert!(worst <= tolerance, "off by {worst:e}");
}
