//! Models of LiDARs that are sold, and what each returns from a world of boxes.
//!
//! Rings, fields of view, rates, ranges and range noise are those of the makers' data sheets. A surface that reflects a tenth is seen
//! up to the stated range head-on, and at the angle θ of incidence up to that range times √cos θ: what comes back falls with
//! the square of the range and with cos θ. So the walls of a tunnel end where they are seen at a grazing angle, as real ones do.

use crate::lidar::{Corners, PERIOD};
use geometry::{Random, Se3};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// A sensor by its maker's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Velodyne VLP-16: 16 rings within ±15°.
    Vlp16,
    /// Ouster OS0, 32 rings within ±45°.
    Os0,
    /// Livox Mid-360: no rings, −7° to 52° all around.
    Mid360,
    /// Livox Avia: no rings, a rosette 70° wide.
    Avia,
}

/// A point of a sweep with what the sensor does not know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensed {
    /// In the sensor's frame at the point's own instant, metres.
    pub point: [f32; 3],
    /// Seconds after the sweep's stamp.
    pub time: f32,
    /// The ring; 0 of a sensor without rings.
    pub ring: u16,
    /// The axis of the world along which the surface's true normal lies.
    pub normal: u8,
}

impl Sensor {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Vlp16, Self::Os0, Self::Mid360, Self::Avia];

    /// Whether points have rings.
    pub fn has_rings(self) -> bool {
        matches!(self, Self::Vlp16 | Self::Os0)
    }

    /// Range at which a tenth is reflected head-on and seen, metres.
    pub fn range(self) -> f64 {
        match self {
            Self::Vlp16 => 100.0,
            Self::Os0 => 35.0,
            Self::Mid360 => 40.0,
            Self::Avia => 190.0,
        }
    }

    /// Standard deviation of a range, metres.
    pub fn noise(self) -> f64 {
        match self {
            Self::Vlp16 | Self::Os0 => 0.015,
            Self::Mid360 | Self::Avia => 0.02,
        }
    }

    /// Instants at which the sensor looks somewhere, and how many rays it casts then.
    fn shots(self) -> (u32, u16) {
        match self {
            Self::Vlp16 => (900, 16),
            Self::Os0 => (1024, 32),
            Self::Mid360 => (5000, 4),
            Self::Avia => (4000, 6),
        }
    }

    /// Direction of a ray of a shot, in the sensor's frame; `heading_change` are the sweeps so far, with the share of this one.
    fn direction(self, heading_change: f64, shot: u64, ray: u16) -> Vector3<f64> {
        let spherical = |azimuth: f64, elevation: f64| {
            let level = elevation.cos();
            Vector3::new(azimuth.cos() * level, azimuth.sin() * level, elevation.sin())
        };
        match self {
            Self::Vlp16 => spherical(-heading_change * TAU, (2.0 * f64::from(ray) - 15.0).to_radians()),
            Self::Os0 => spherical(-heading_change * TAU, (90.0 / 31.0 * f64::from(ray) - 45.0).to_radians()),
            Self::Mid360 => {
                // Twice around a sweep; elevations fill the field evenly and never repeat.
                let share = ((4 * shot + u64::from(ray)) as f64 * 0.618_033_988_75).fract();
                spherical(-2.0 * heading_change * TAU, (-7.0 + 59.0 * share).to_radians())
            }
            Self::Avia => {
                let time = heading_change + f64::from(ray) / 24_000.0;
                let radius = 0.5 * 72f64.to_radians() * (TAU * 31.7 * time).sin();
                let around = TAU * 7.13 * time + f64::from(ray) * TAU / 12.0;
                spherical(radius * around.cos(), radius * around.sin())
            }
        }
    }

    /// What a sweep returns that begins at `stamp`; `pose` is `world_from_sensor` over time.
    pub fn sweep(self, world: &[Corners], pose: impl Fn(f64) -> Se3, stamp: f64) -> Vec<Sensed> {
        let (shots, rays) = self.shots();
        let index = (stamp / PERIOD).round() as u64;
        let mut random = Random::new(index.wrapping_mul(0x9e37_79b9).wrapping_add(self as u64));
        let mut sensed = Vec::with_capacity(shots as usize * usize::from(rays));
        for shot in 0..shots {
            let share = f64::from(shot) / f64::from(shots);
            let time = share * PERIOD;
            let world_from_sensor = pose(stamp + time);
            let rotation = world_from_sensor.rotation_matrix();
            for ray in 0..rays {
                let number = index * u64::from(shots) + u64::from(shot);
                let local = self.direction(index as f64 + share, number, ray);
                let direction = rotation * local;
                let (range, axis) = hit(world, &world_from_sensor.translation, &direction);
                if range < 0.1 || range > self.range() * direction[axis].abs().sqrt() {
                    continue;
                }
                let point = local * (range + self.noise() * random.normal());
                sensed.push(Sensed {
                    point: [0, 1, 2].map(|i| point[i] as f32),
                    time: time as f32,
                    ring: if self.has_rings() { ray } else { 0 },
                    normal: axis as u8,
                });
            }
        }
        sensed
    }
}

/// Where a ray meets the world, the first box of which is seen from inside: distance and the axis of the surface's normal.
fn hit(world: &[Corners], origin: &Vector3<f64>, direction: &Vector3<f64>) -> (f64, usize) {
    let inverse = direction.map(|v| 1.0 / v);
    let mut nearest = (f64::INFINITY, 0);
    for (index, [least, most]) in world.iter().enumerate() {
        let (mut enter, mut leave) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
        for axis in 0..3 {
            let a = (least[axis] - origin[axis]) * inverse[axis];
            let b = (most[axis] - origin[axis]) * inverse[axis];
            let (near, far) = if a < b { (a, b) } else { (b, a) };
            if near > enter.0 {
                enter = (near, axis);
            }
            if far < leave.0 {
                leave = (far, axis);
            }
        }
        let met = if index == 0 { leave } else { enter };
        if enter.0 <= leave.0 && met.0 > 0.0 && met.0 < nearest.0 {
            nearest = met;
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The box hides what lies less than 3° aside: not the walls at the room's far end, which are seen at 7° and less.
    const ROOM: [Corners; 2] =
        [[[-30.0, -3.0, -1.0], [30.0, 3.0, 3.0]], [[4.0, -0.2, -1.0], [5.0, 0.2, 1.0]]];

    #[test]
    fn sensors_see_surfaces_where_they_are_and_lose_them_at_grazing_angles() {
        for sensor in Sensor::ALL {
            let sensed = sensor.sweep(&ROOM, |_| Se3::identity(), 0.3);
            assert!(sensed.len() > 5000, "{sensor:?}: {}", sensed.len());
            for s in &sensed {
                let p = s.point.map(f64::from);
                let off = (0..3).map(|i| (p[i].abs() - [30.0, 3.0, 3.0][i]).abs());
                let wall = off.fold(f64::INFINITY, f64::min);
                let near = wall.min((p[0] - 4.0).abs()).min((p[2] + 1.0).abs()).min((p[1].abs() - 0.2).abs());
                assert!(near < 6.0 * sensor.noise(), "{sensor:?}: {p:?}");
            }
            // A wall 3 m aside is seen from 24 m ahead at 7°.
            let grazing = sensed.iter().filter(|s| s.normal == 1 && s.point[0] > 24.0).count();
            let most = sensor.range() * (3.0f64 / 24.0).sqrt();
            assert_eq!(grazing > 0, most > 24.0, "{sensor:?}: {grazing} points");
        }
    }
}
