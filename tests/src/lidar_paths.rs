//! How sensors are carried: on wheels, by hand, by a drone.

use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// A sensor's `world_from_sensor` along corners in space, which it rounds; it looks where it goes, and shakes as its carrier does.
#[derive(Clone, Debug)]
pub struct Carried {
    corners: Vec<Vector3<f64>>,
    /// Way up to each corner, metres.
    ends: Vec<f64>,
    /// Metres a second.
    pace: f64,
    carrier: Carrier,
    /// How the sensor is mounted.
    mount: UnitQuaternion<f64>,
}

/// What carries the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// A cart, which hardly shakes.
    Wheels,
    /// A walking person: two steps a second move it by 2 cm and turn it by 3°.
    Hand,
    /// A person with the sensor on the back: two steps a second, 2 cm and 1.5°, leaning forward by 10°.
    BackPack,
    /// A drone, which leans by 4° slowly.
    Drone,
}

/// Seconds over which corners are rounded.
const ROUNDED: f64 = 0.7;
/// Seconds of standing still at either end.
const REST: f64 = 1.0;

impl Carried {
    /// Along corners at a pace, metres a second.
    pub fn along(corners: &[[f64; 3]], pace: f64, carrier: Carrier) -> Self {
        let corners: Vec<Vector3<f64>> = corners.iter().map(|c| Vector3::from(*c)).collect();
        let mut ends = vec![0.0];
        for pair in corners.windows(2) {
            ends.push(ends[ends.len() - 1] + (pair[1] - pair[0]).norm());
        }
        let lean = if carrier == Carrier::BackPack { 10f64.to_radians() } else { 0.0 };
        // Nothing stands at right angles to a sensor.
        let mount = UnitQuaternion::from_euler_angles(0.01, lean + 0.015, 0.35);
        Self { corners, ends, pace, carrier, mount }
    }

    /// Seconds that it takes.
    pub fn duration(&self) -> f64 {
        self.ends[self.ends.len() - 1] / self.pace + 2.0 * REST
    }

    /// Position, metres: along the corners' lines at the pace, its mean over [`ROUNDED`] before and after, weighted by a raised cosine. Each
    /// change of velocity is spread over that time as one curve: a sum over some instants would be as many jolts.
    fn smooth(&self, time: f64) -> Vector3<f64> {
        let (mut position, mut before) = (self.corners[0], Vector3::zeros());
        for (k, end) in self.ends.iter().enumerate() {
            let next = self.corners.get(k + 1).and_then(|next| (next - self.corners[k]).try_normalize(1e-9));
            let velocity = next.unwrap_or_default() * self.pace;
            position += (velocity - before) * ramp(time - REST - end / self.pace);
            before = velocity;
        }
        position
    }

    /// `world_from_sensor` at a time from the begin, seconds.
    pub fn at(&self, time: f64) -> Se3 {
        let position = self.smooth(time);
        let clamped = time.clamp(REST, self.duration() - REST);
        let ahead = self.smooth(clamped + 0.5 * ROUNDED) - self.smooth(clamped - 0.5 * ROUNDED);
        let yaw = ahead.y.atan2(ahead.x);
        // Who begins to walk begins to sway, within a second.
        let moving = 0.5 - 0.5 * (0.5 * TAU * ((time - 0.5 * REST) / REST).clamp(0.0, 1.0)).cos();
        let (swing, rate, rotation) = match self.carrier {
            Carrier::Wheels => (0.002, 3.1, 0.2f64),
            Carrier::Hand => (0.02, 1.9, 3.0),
            Carrier::BackPack => (0.02, 1.8, 1.5),
            Carrier::Drone => (0.03, 0.6, 4.0),
        };
        let wave = |times: f64, offset: f64| moving * (TAU * rate * times * time + offset).sin();
        let bob = Vector3::new(0.3 * wave(0.5, 1.0), 0.6 * wave(0.5, 0.3), wave(1.0, 0.0)) * swing;
        let angles =
            [wave(0.5, 0.7), 0.7 * wave(1.0, 2.1), 0.8 * wave(0.5, 1.9)].map(|a| a * rotation.to_radians());
        let heading = UnitQuaternion::from_euler_angles(angles[0], angles[1], yaw + angles[2]);
        Se3::new(heading * self.mount, position + bob)
    }
}

/// How far a velocity of one that comes about within [`ROUNDED`] before and after carries in so long since, seconds: its mean over
/// that time, weighted by a raised cosine.
fn ramp(since: f64) -> f64 {
    let share = since / ROUNDED;
    if share.abs() >= 1.0 {
        return since.max(0.0);
    }
    let swing = (1.0 + (0.5 * TAU * share).cos()) * 2.0 / (TAU * TAU);
    ROUNDED * (0.25 * (1.0 + share).powi(2) - swing)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a body can do: nothing here is faster than 200°/s, nor accelerates by more than 8 m/s².
    #[test]
    fn paths_are_those_of_bodies() {
        for carrier in [Carrier::Wheels, Carrier::Hand, Carrier::BackPack, Carrier::Drone] {
            let path =
                Carried::along(&[[0.0; 3], [3.0, 0.0, 0.0], [3.0, 1.2, 0.0], [0.0, 1.2, 1.6]], 1.0, carrier);
            let poses: Vec<Se3> =
                (0..(path.duration() * 100.0) as usize).map(|i| path.at(0.01 * i as f64)).collect();
            let mut most = (0.0f64, 0.0f64);
            for three in poses.windows(3) {
                let turned = (three[0].inverse() * three[1]).rotation.angle().to_degrees() * 100.0;
                let [a, b, c] = [0, 1, 2].map(|k| three[k].translation);
                most = (most.0.max(turned), most.1.max((a + c - 2.0 * b).norm() * 1e4));
            }
            assert!(most.0 < 200.0 && most.1 < 8.0, "{carrier:?}: {most:?}");
            let end = path.at(path.duration()).translation;
            assert!((end - Vector3::new(0.0, 1.2, 1.6)).norm() < 0.05, "{end:?}");
        }
    }
}
