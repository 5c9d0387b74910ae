//! The agents' motion over time: position per axis and the turns of the camera.

use nalgebra::UnitQuaternion;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use view::report::pack::Packed;
use view::report::scene::PlacedFrame;

/// One number per frame of the scene, in its order; in the world of the first agent.
#[derive(Serialize)]
pub struct Paths {
    /// Seconds since the agent's first frame, f32.
    seconds: Packed,
    /// x, y, z per frame, map units, f32 × 3.
    position: Packed,
    /// Roll, pitch, yaw per frame, degrees, f32 × 3; without jumps of a full turn.
    turns: Packed,
}

impl Paths {
    /// The paths of frames that are ordered by agent and time.
    pub fn new(frames: &[PlacedFrame]) -> Self {
        let agents: Vec<&[PlacedFrame]> = frames.chunk_by(|a, b| a.agent == b.agent).collect();
        let seconds =
            agents.iter().flat_map(|own| own.iter().map(|f| (f.timestamp - own[0].timestamp) as f32));
        let turns = agents
            .iter()
            .flat_map(|own| continuous(own.iter().map(|f| roll_pitch_yaw(&f.world_from_frame.rotation))));
        let position = frames.iter().flat_map(|f| <[f64; 3]>::from(f.world_from_frame.translation));
        Self {
            seconds: Packed::f32(seconds),
            position: Packed::f32(position.map(|v| v as f32)),
            turns: Packed::f32(turns.flatten().map(|v| v.to_degrees() as f32)),
        }
    }
}

/// How a camera (x right, y down, z forward) is turned against the world, radians: `R = R_y(yaw) R_x(pitch) R_z(roll)`.
/// Yaw turns it to the right, pitch up, roll clockwise.
fn roll_pitch_yaw(world_from_camera: &UnitQuaternion<f64>) -> [f64; 3] {
    let r = world_from_camera.to_rotation_matrix();
    // Of R_y R_x R_z: the third column is (sin y cos p, −sin p, cos y cos p), the second row (cos p sin r, cos p cos r, −sin p).
    let pitch = (-r[(1, 2)]).clamp(-1.0, 1.0).asin();
    [r[(1, 0)].atan2(r[(1, 1)]), pitch, r[(0, 2)].atan2(r[(2, 2)])]
}

/// Angles without jumps: each within half a turn of the one before.
fn continuous(angles: impl Iterator<Item = [f64; 3]>) -> impl Iterator<Item = [f64; 3]> {
    let mut last: Option<[f64; 3]> = None;
    angles.map(move |next| {
        let near = |before: f64, now: f64| before + (now - before + PI).rem_euclid(TAU) - PI;
        let found = last.map_or(next, |last| std::array::from_fn(|i| near(last[i], next[i])));
        last = Some(found);
        found
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn turns_are_those_the_camera_was_turned_by() {
        for [roll, pitch, yaw] in [[0.1, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, -2.0], [-0.4, 0.6, 2.5]] {
            let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
            let turned = about(Vector3::y(), yaw) * about(Vector3::x(), pitch) * about(Vector3::z(), roll);
            let found = roll_pitch_yaw(&turned);
            assert!((Vector3::from(found) - Vector3::new(roll, pitch, yaw)).norm() < 1e-12, "{found:?}");
        }
    }

    #[test]
    fn a_full_circle_has_no_jump() {
        let turns = (0..100).map(|i| i as f64 * 0.1);
        let wrapped = turns.clone().map(|t| [0.0, 0.0, (t + PI).rem_euclid(TAU) - PI]);
        for (found, rotation) in continuous(wrapped).zip(turns) {
            assert!((found[2] - rotation).abs() < 1e-9, "{found:?} {rotation}");
        }
    }
}
