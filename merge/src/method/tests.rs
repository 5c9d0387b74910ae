//! The baselines on three keyframes of either agent in a room, whose poses, clouds and measurements are made by hand.

use super::*;
use crate::icp::Cloud;
use crate::pair::PairRefusal;
use crate::scale_filter::{PairScale, ScaleRefusal};
use crate::test_support::Numbers;
use geometry::Sim3;
use nalgebra::{Matrix3, Matrix4, SMatrix, Vector3, Vector4};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use std::collections::BTreeMap;

const BASELINES: [Baseline; 5] = [
    Baseline::PcrPro,
    Baseline::PoseGraph(Configuration::Straight),
    Baseline::PoseGraph(Configuration::Full),
    Baseline::PoseGraph(Configuration::Top),
    Baseline::LoopBox,
];

/// Standard deviations of what PCR-Pro measures: rotation in rad, translation in parts of the room's half width (in
/// target units), ln σ; and of the clouds' points, in half widths.
const ROTATION: f64 = 0.003;
const TRANSLATION: f64 = 0.005;
const LOG_SCALE: f64 = 0.005;
const POINT: f64 = 0.003;

/// Both agents' keyframes in one room, with the truth.
struct Room {
    observed: Observed,
    target_world_from_source_world: Sim3,
}

impl Room {
    /// A room measured with `noise` times the deviations above.
    fn new(seed: u64, noise: f64) -> Self {
        let numbers = &mut Numbers::new(seed);
        let motion = Sim3::new(numbers.rotation(1.0), numbers.vector(3.0), numbers.uniform(-0.7, 0.7).exp());
        let points: Vec<Vector3<f64>> = (0..300).map(|i| wall_point(i % 3, numbers)).collect();
        let source = side(10, &points, &Sim3::identity(), noise, numbers);
        let target = side(3, &points, &motion, noise, numbers);
        let mut observed = Observed { source, target, direct: [None, None, None], cross: Vec::new() };
        for z in 0..3 {
            observed.direct[z] = Some(observed.measure((z, z), 100 + 10 * z, &motion, noise, numbers));
        }
        for (s, t) in [(1, 0), (0, 1), (2, 1), (1, 2)] {
            observed.cross.push(observed.measure((s, t), 50, &motion, noise, numbers));
        }
        Self { observed, target_world_from_source_world: motion }
    }

    fn solve(&self, baseline: Baseline) -> Result<Placement, MethodRefusal> {
        solve(baseline, &self.observed, &BaselineParams::default())
    }

    /// How far a placement is from the truth: ε of `placed = exp(ε) ∘ true` for the two keyframes.
    fn error(&self, placement: &Placement) -> nalgebra::SVector<f64, 7> {
        let (source, target) = self.observed.poses(placement.source, placement.target).unwrap();
        let truth = target.inverse() * self.target_world_from_source_world * source;
        (placement.target_from_source.a_from_b * truth.inverse()).log()
    }

    /// Multiplies the measured scale of pair z by `factor`, and its standard deviation by `deviation`.
    fn rescale(&mut self, z: usize, factor: f64, deviation: f64) {
        let scale = &mut self.observed.direct[z].as_mut().unwrap().measured.as_mut().unwrap().scale;
        scale.scale *= factor;
        scale.variance *= deviation * deviation;
        let spread = Matrix4::from_diagonal(&Vector4::new(deviation, 1.0, 1.0, 1.0));
        scale.covariance = spread * scale.covariance * spread;
    }
}

impl Observed {
    /// A pair by the indices of its keyframes, measured with noise.
    fn measure(
        &self,
        (s, t): (usize, usize),
        match_count: usize,
        motion: &Sim3,
        noise: f64,
        numbers: &mut Numbers,
    ) -> ObservedPair {
        let key = |side: &Side, k: usize| *side.world_from_keyframes.keys().nth(k).unwrap();
        let (source, target) = (key(&self.source, s), key(&self.target, t));
        let (source_pose, target_pose) = self.poses(source, target).unwrap();
        let truth = target_pose.inverse() * *motion * source_pose;
        let half_width = motion.scale / target_pose.scale;
        let mut draw = |deviation: f64| Vector3::from_fn(|_, _| numbers.normal() * noise * deviation);
        let rotation_error = nalgebra::UnitQuaternion::from_scaled_axis(draw(ROTATION));
        let translation = truth.translation + draw(TRANSLATION) * half_width;
        let scale = truth.scale * draw(LOG_SCALE).x.exp();
        let t_variance = (TRANSLATION * half_width).powi(2);
        let variance = (LOG_SCALE * scale).powi(2);
        let diagonal = Vector4::new(variance, t_variance, t_variance, t_variance);
        let scale = PairScale {
            scale,
            variance,
            translation,
            covariance: Matrix4::from_diagonal(&diagonal),
            distance_ratio: scale,
            used: match_count,
            gated: 0,
        };
        let measured = Measurement {
            match_count,
            rotation: rotation_error * truth.rotation,
            rotation_covariance: Matrix3::identity() * ROTATION.powi(2),
            scale,
        };
        ObservedPair { source, target, measured: Ok(measured) }
    }
}

/// A point on one of three walls of a room of half width 1 around the origin, with some relief: nothing slides.
fn wall_point(wall: usize, numbers: &mut Numbers) -> Vector3<f64> {
    let mut point = numbers.vector(1.0);
    point[wall] = 1.0 + 0.15 * (7.0 * point[(wall + 1) % 3]).sin();
    point
}

/// Three keyframes that see all of the room, in a world that `world_from_room` leads to, with ids from `first` on.
fn side(
    first: u32,
    points: &[Vector3<f64>],
    world_from_room: &Sim3,
    noise: f64,
    numbers: &mut Numbers,
) -> Side {
    let mut world_from_keyframes = BTreeMap::new();
    let mut clouds = BTreeMap::new();
    for k in 0..3 {
        let id = KeyframeId(first + k);
        let offset = Vector3::new(0.2 * f64::from(k), 0.0, 0.0) + numbers.vector(0.05);
        let room_from_keyframe = Sim3::new(numbers.rotation(0.1), offset, numbers.uniform(0.8, 1.2));
        let seen = |point: &Vector3<f64>| {
            let shift = Vector3::from_fn(|_, _| numbers.normal() * noise * POINT);
            room_from_keyframe.inverse() * (point + shift)
        };
        let points: Vec<_> = points.iter().map(seen).collect();
        let deviation = POINT / room_from_keyframe.scale;
        let covariances = Some(vec![Matrix3::identity() * deviation * deviation; points.len()]);
        clouds.insert(id, Cloud { points, covariances });
        world_from_keyframes.insert(id, *world_from_room * room_from_keyframe);
    }
    let edge = |(from, to): (u32, u32)| {
        let (from, to) = (KeyframeId(first + from), KeyframeId(first + to));
        let from_from_to = world_from_keyframes[&from].inverse() * world_from_keyframes[&to];
        Edge { from, to, from_from_to, information: SMatrix::identity() * 1e6, kind: EdgeKind::Odometry }
    };
    let edges = [(0, 1), (1, 2)].into_iter().map(edge).collect();
    Side { world_from_keyframes, edges, clouds }
}

#[test]
fn exact_measurements_give_the_exact_motion() {
    for seed in 0..3 {
        let room = Room::new(seed, 0.0);
        for baseline in BASELINES {
            let placement = room.solve(baseline).unwrap();
            let error = room.error(&placement).norm();
            assert!(error < 1e-6, "{baseline:?}, seed {seed}: {error}");
            assert!(placement.target_from_source.information.cholesky().is_some());
        }
    }
}

/// Bounds of five deviations of one measurement: no method may make of it worse than it is.
#[test]
fn with_noise_every_method_stays_within_what_one_pair_knows() {
    for seed in 10..16 {
        let room = Room::new(seed, 1.0);
        for baseline in BASELINES {
            let error = room.error(&room.solve(baseline).unwrap());
            let (_, target) = room.observed.poses(KeyframeId(11), KeyframeId(4)).unwrap();
            let half_width = room.target_world_from_source_world.scale / target.scale;
            let shift = error.fixed_rows::<3>(0).norm() / half_width;
            let rotation_error = error.fixed_rows::<3>(3).norm();
            assert!(shift < 5.0 * (TRANSLATION + ROTATION), "{baseline:?}, seed {seed}: shift {shift}");
            assert!(rotation_error < 5.0 * ROTATION, "{baseline:?}, seed {seed}: turn {rotation_error}");
            assert!(error[6].abs() < 5.0 * LOG_SCALE, "{baseline:?}, seed {seed}: scale {}", error[6]);
        }
    }
}

/// A vague centre is mended by its neighbours through the maps' edges; PCR-Pro has it alone.
#[test]
fn the_pose_graphs_weigh_all_pairs() {
    let mut room = Room::new(30, 0.0);
    room.rescale(1, 1.04, 20.0);
    let scale_error = |baseline| room.error(&room.solve(baseline).unwrap())[6].abs();
    assert!((scale_error(Baseline::PcrPro) - 1.04f64.ln()).abs() < 1e-9);
    for configuration in [Configuration::Straight, Configuration::Full] {
        let error = scale_error(Baseline::PoseGraph(configuration));
        assert!(error < 0.005, "{configuration:?}: {error}");
    }
}

/// The last pair has most matches: what the other two measured does not matter to the top configuration, and does to
/// the straight one.
#[test]
fn top_matches_take_one_pair_for_all() {
    let mut room = Room::new(31, 0.0);
    room.rescale(0, 0.95, 1.0);
    room.rescale(1, 0.95, 1.0);
    let error = |configuration| room.error(&room.solve(Baseline::PoseGraph(configuration)).unwrap());
    assert!(error(Configuration::Top).norm() < 1e-6);
    assert!(error(Configuration::Straight)[6].abs() > 0.001);
}

/// Algorithm 1 takes the two scales that agree, of more matches than those taken before.
#[test]
fn loop_box_of_the_paper_takes_the_scale_of_algorithm_1() {
    let mut room = Room::new(32, 0.0);
    room.rescale(0, 1.05, 1.0);
    room.rescale(1, 1.01, 1.0);
    let placement = room.solve(Baseline::LoopBox).unwrap();
    assert_eq!((placement.source, placement.target), (KeyframeId(12), KeyframeId(5)));
    assert!((room.error(&placement)[6] - 1.005f64.ln()).abs() < 1e-9);
}

#[test]
fn methods_do_with_the_pairs_there_are() {
    let mut room = Room::new(33, 0.0);
    room.observed.direct[0] = None;
    room.observed.cross.clear();
    for baseline in BASELINES {
        let error = room.error(&room.solve(baseline).unwrap()).norm();
        assert!(error < 1e-6, "{baseline:?}: {error}");
    }
    let mut room = Room::new(33, 0.0);
    let refusal = PairRefusal::Scale(ScaleRefusal::Degenerate);
    room.observed.direct[1].as_mut().unwrap().measured = Err(refusal);
    assert_eq!(room.solve(Baseline::PcrPro), Err(MethodRefusal::NotMeasured(refusal)));
    for baseline in &BASELINES[1..] {
        let error = room.error(&room.solve(*baseline).unwrap()).norm();
        assert!(error < 1e-6, "{baseline:?}: {error}");
    }
    // Algorithm 1 falls back on the centre, and only on it.
    room.observed.direct[0] = None;
    assert!(matches!(room.solve(Baseline::LoopBox), Err(MethodRefusal::Scale(_))));
    room.observed.direct[2].as_mut().unwrap().measured = Err(refusal);
    for baseline in BASELINES {
        assert_eq!(room.solve(baseline), Err(MethodRefusal::NotMeasured(refusal)), "{baseline:?}");
    }
}

/// The normalised squared error of PCR-Pro's estimate averages to its 7 degrees of freedom.
#[test]
fn the_information_of_a_measurement_is_consistent() {
    let mut sum = 0.0;
    let count = 400;
    for seed in 0..count {
        let numbers = &mut Numbers::new(seed + 100);
        let mut room = Room::new(40, 0.0);
        let motion = room.target_world_from_source_world;
        room.observed.direct[1] = Some(room.observed.measure((1, 1), 100, &motion, 1.0, numbers));
        let placement = room.solve(Baseline::PcrPro).unwrap();
        let error = room.error(&placement);
        sum += error.dot(&(placement.target_from_source.information * error)) / count as f64;
    }
    // The mean's own deviation is √(2·7/400) = 0.19.
    assert!((sum - 7.0).abs() < 0.75, "{sum}");
}

#[test]
fn names_lead_back_to_their_methods() {
    for method in Method::ALL {
        assert_eq!(method.to_string().parse(), Ok(method));
        let name: serde::de::value::StrDeserializer<serde::de::value::Error> =
            method.name().into_deserializer();
        assert_eq!(Method::deserialize(name), Ok(method));
        assert_eq!(method.baseline().is_none(), method == Method::default());
    }
    let error = "orb".parse::<Method>().unwrap_err().to_string();
    assert!(error.contains("pgo-top") && error.contains("orb"), "{error}");
}
