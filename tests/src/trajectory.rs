//! Camera motions through [`World::yard`](crate::World::yard): `world_from_camera` of each frame, metres.

use crate::world::RING;
use geometry::Random;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::{PI, TAU};

/// Height of the cameras above the ground, metres.
const HEIGHT: f64 = 1.3;
/// A whole turn, radians.
const FULL_ROTATION: f32 = std::f32::consts::TAU;

/// A drive of `length` metres to the right, looking at the row of boxes before the far wall, with the small
/// bumps of a cart; `count` frames.
pub fn sideways(count: usize, length: f64) -> Vec<Se3> {
    (0..count)
        .map(|i| {
            let s = i as f64 / (count - 1).max(1) as f64;
            let x = length * (s - 0.5);
            let bump = 0.02 * (1.7 * x).sin();
            look(Vector3::new(x, -HEIGHT + bump, 5.0 + 0.15 * (0.8 * x).sin()), 0.03 * (0.9 * x).sin(), 0.08)
        })
        .collect()
}

/// A hand-held camera that moves to and fro by about ±`reach` metres and turns by a few degrees, before the row
/// of boxes; `count` frames, one slow sweep to the side every 60. The path is periodic: the same place is seen
/// again and again however long it lasts.
pub fn hand_held(count: usize, reach: f64) -> Vec<Se3> {
    (0..count)
        .map(|i| {
            let phase = TAU * i as f64 / 60.0;
            let position = Vector3::new(
                reach * phase.sin(),
                -HEIGHT + 0.4 * reach * (2.0 * phase).sin(),
                5.5 + 0.5 * reach * (1.0 - phase.cos()),
            );
            look(position, 0.06 * phase.sin(), 0.08 + 0.04 * (phase.cos() - 1.0))
        })
        .collect()
}

/// `turns` times round the group of boxes in the middle at `radius` metres, looking at it; `count` frames.
/// More than one turn sees its beginning again.
pub fn orbit(count: usize, radius: f64, turns: f64) -> Vec<Se3> {
    (0..count)
        .map(|i| {
            let angle = TAU * turns * i as f64 / (count - 1).max(1) as f64;
            let position = Vector3::new(-radius * angle.sin(), -HEIGHT, -radius * angle.cos());
            look(position, angle, 0.2)
        })
        .collect()
}

/// A hand-held camera that wanders before the row of boxes, all six degrees of freedom at once, up to 0.8 metres a second
/// and 50° a second; `count` frames, `rate` a second. Another `seed` gives another way.
pub fn walk(count: usize, rate: f64, seed: u64) -> Vec<Se3> {
    let mut random = Random::new(seed ^ 0x3a1c);
    // Of each: how far, and two sines of periods that have nothing to do with each other.
    let mut sway = |reach: f64| {
        let mut number = |low: f32, high: f32| f64::from(random.uniform(low, high));
        let sines = [(0.65 * reach, number(5.0, 8.0)), (0.35 * reach, number(2.0, 3.5))];
        let phases = [number(0.0, FULL_ROTATION), number(0.0, FULL_ROTATION)];
        move |time: f64| {
            let sine = |i: usize| sines[i].0 * (TAU * time / sines[i].1 + phases[i]).sin();
            sine(0) + sine(1)
        }
    };
    let (x, y, z) = (sway(0.9), sway(0.25), sway(0.5));
    let (yaw, pitch, roll) = (sway(0.45), sway(0.12), sway(0.1));
    (0..count)
        .map(|i| {
            let time = i as f64 / rate;
            let position = Vector3::new(x(time), y(time) - HEIGHT, 5.0 + z(time));
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll(time));
            look(position, yaw(time), 0.08 + pitch(time)) * Se3::new(roll, Vector3::zeros())
        })
        .collect()
}

/// A drive through [`World::town`](crate::World::town), a frame every `step` metres, looking to the left: one and a half
/// times round every circle, so that each is a loop, and on to the next, of which the camera sees the middle where it saw
/// the surroundings before, and the other way round; `count` frames.
pub fn town(count: usize, step: f64) -> Vec<Se3> {
    let per_ring = 3.0 * PI * RING;
    (0..count)
        .map(|i| {
            let travelled = step * i as f64;
            let ring = (travelled / per_ring).floor();
            let sense = if ring % 2.0 == 0.0 { 1.0 } else { -1.0 };
            let angle = PI + sense * (travelled - ring * per_ring) / RING;
            let (sin, cos) = angle.sin_cos();
            let bump = 0.03 * (0.9 * travelled).sin();
            let position = Vector3::new(2.0 * RING * ring + RING * cos, bump - HEIGHT, RING * sin);
            let heading = Vector3::new(-sense * sin, 0.0, sense * cos);
            let left = Vector3::new(-heading.z, 0.0, heading.x);
            let ahead = left * 0.94 + heading * 0.34;
            look(position, ahead.x.atan2(ahead.z), 0.06)
        })
        .collect()
}

/// `count` views that have nothing to do with each other, from places within `reach` metres of the origin in all
/// directions; another `seed` gives others.
pub fn scattered(count: usize, reach: f64, seed: u64) -> Vec<Se3> {
    let mut random = Random::new(seed);
    let mut uniform = |low, high| f64::from(random.uniform(low, high));
    (0..count)
        .map(|_| {
            let (x, z) = (uniform(-1.0, 1.0) * reach, uniform(-1.0, 1.0) * reach);
            let position = Vector3::new(x, -uniform(0.6, 1.7), z);
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), uniform(-0.3, 0.3));
            look(position, uniform(-3.1, 3.1), uniform(-0.2, 0.6)) * Se3::new(roll, Vector3::zeros())
        })
        .collect()
}

/// Turns to the right by `angle` radians about the camera's own centre, starting from pose `start`; `count`
/// frames, the first of which is `start`.
pub fn turning(start: Se3, count: usize, angle: f64) -> Vec<Se3> {
    (0..count)
        .map(|i| {
            let yaw = angle * i as f64 / (count - 1).max(1) as f64;
            start * Se3::new(UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw), Vector3::zeros())
        })
        .collect()
}

/// The length of a path, metres.
pub fn length(path: &[Se3]) -> f64 {
    path.windows(2).map(|w| (w[1].translation - w[0].translation).norm()).sum()
}

/// A level camera at `position`, turned right by `yaw` from +z and then down by `pitch`, radians.
pub(crate) fn look(position: Vector3<f64>, yaw: f64, pitch: f64) -> Se3 {
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
    let pitch = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -pitch);
    Se3::new(yaw * pitch, position)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_looks_at_the_middle() {
        for pose in orbit(50, 4.0, 1.2) {
            let ahead = pose.rotation * Vector3::z();
            let middle = -Vector3::new(pose.translation.x, 0.0, pose.translation.z).normalize();
            assert!(ahead.dot(&middle) > 0.97);
            assert!(ahead.y > 0.0, "y is down: the camera looks down at the boxes");
        }
    }

    #[test]
    fn the_path_through_town_is_continuous() {
        let path = town(4000, 0.1);
        let steps = path.windows(2).map(|w| (w[1].translation - w[0].translation).norm());
        assert!(steps.clone().all(|step| (0.09..0.11).contains(&step)));
        let turns = path.windows(2).map(|w| w[0].rotation.angle_to(&w[1].rotation));
        assert!(turns.clone().all(|rotation| rotation < 0.02), "{}", turns.fold(0.0, f64::max));
        let round = (2.0 * PI * RING / 0.1).round() as usize;
        assert!((path[round].translation - path[0].translation).norm() < 0.2, "a circle is a loop");
    }

    #[test]
    fn a_pure_rotation_stays_in_place() {
        let start = sideways(3, 2.0)[1];
        let path = turning(start, 10, 0.5);
        assert_eq!(path[0], start);
        assert!(length(&path) < 1e-12);
        assert!((path[0].rotation.angle_to(&path[9].rotation) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_walk_is_no_faster_than_a_hand() {
        for seed in 1..20 {
            let path = walk(600, 30.0, seed);
            let steps = path.windows(2).map(|w| (w[1].translation - w[0].translation).norm() * 30.0);
            assert!(steps.fold(0.0, f64::max) < 2.0);
            let turns = path.windows(2).map(|w| w[0].rotation.angle_to(&w[1].rotation) * 30.0);
            assert!(turns.fold(0.0, f64::max) < 0.9, "50 degrees a second");
        }
    }

    #[test]
    fn a_hand_held_path_repeats() {
        let path = hand_held(121, 0.4);
        assert!((path[0].inverse() * path[60]).log().norm() < 1e-9);
        assert!((path[7].inverse() * path[67]).log().norm() < 1e-9);
    }
}
