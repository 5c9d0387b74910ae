//! A spinning LiDAR in a hall of boxes, its sweeps ray-cast with the truth known, and recordings of them as folders of
//! KITTI scans.
//!
//! A [`Sensor`] turns clockwise, ten times a second; each point is seen from where the sensor is at its own
//! instant, so that sweeps are distorted as real ones are. x forward, y left, z up; metres and seconds.

use geometry::Random;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};
use std::fmt::Write;
use std::fs;
use std::io;
use std::path::Path;

/// Seconds of a sweep.
pub const PERIOD: f64 = 0.1;

/// A spinning sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Its rings, evenly spaced.
    pub rings: u8,
    /// Elevation of the lowest ring, degrees.
    pub lowest: f64,
    /// From one ring to the next, degrees.
    pub spacing: f64,
    /// Columns of a sweep.
    pub columns: u32,
    /// Ranges err by up to this, metres, evenly.
    pub noise: f64,
    /// What is farther gives no return, metres.
    pub reach: f64,
}

/// 16 rings two degrees apart, the lowest at −15°: the sensor of [`sweep`].
pub const SIXTEEN: Sensor =
    Sensor { rings: 16, lowest: -15.0, spacing: 2.0, columns: 900, noise: 0.02, reach: f64::INFINITY };

/// 32 rings 1.25 degrees apart that look down more than up, and err more.
pub const THIRTY_TWO: Sensor =
    Sensor { rings: 32, lowest: -24.0, spacing: 1.25, columns: 720, noise: 0.03, reach: 60.0 };

/// A box by its least and largest corner.
pub type Corners = [[f64; 3]; 2];

/// A hall of 40 × 24 m, seen from inside, and what stands in it: no two places look alike.
pub const HALL: [Corners; 15] = [
    [[-20.0, -12.0, -1.0], [20.0, 12.0, 5.0]],
    [[-16.0, 8.0, -1.0], [-13.0, 10.0, 1.5]],
    [[-9.0, 9.5, -1.0], [-4.0, 11.0, 3.0]],
    [[1.0, 9.0, -1.0], [2.5, 10.5, 5.0]],
    [[7.0, 8.0, -1.0], [12.0, 9.0, 0.5]],
    [[16.0, 6.0, -1.0], [18.0, 10.0, 2.5]],
    [[-18.0, -3.0, -1.0], [-17.0, 2.0, 3.5]],
    [[-12.0, -1.5, -1.0], [-7.0, 0.5, 2.0]],
    [[-2.0, -0.5, -1.0], [1.0, 1.5, 4.0]],
    [[5.0, -2.0, -1.0], [10.0, -0.5, 1.2]],
    [[15.0, -4.0, -1.0], [16.5, -1.0, 5.0]],
    [[-15.0, -11.0, -1.0], [-11.0, -8.5, 0.8]],
    [[-5.0, -10.0, -1.0], [-4.0, -9.0, 5.0]],
    [[3.0, -11.5, -1.0], [8.0, -9.5, 2.2]],
    [[12.0, -10.0, -1.0], [14.0, -8.0, 1.6]],
];

/// A point of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// In the sensor's frame at the point's own instant, metres.
    pub point: [f32; 3],
    /// Seconds after the sweep's stamp.
    pub time: f32,
    /// The ring.
    pub ring: u8,
}

/// How a sensor turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// Whether azimuth grows with time, seen from above.
    pub counter_clockwise: bool,
    /// Azimuth at which a sweep begins, radians from x towards y.
    pub start: f64,
}

/// A sweep of [`SIXTEEN`] that begins at `stamp`; `world_from_sensor` over time is `pose`.
pub fn sweep(world: &[Corners], pose: impl Fn(f64) -> Se3, stamp: f64) -> Vec<Return> {
    sweep_of(&SIXTEEN, world, pose, stamp)
}

/// A sweep that begins at `stamp`, of a sensor whose `world_from_sensor` over time is `pose`.
pub fn sweep_of(sensor: &Sensor, world: &[Corners], pose: impl Fn(f64) -> Se3, stamp: f64) -> Vec<Return> {
    sweep_turning(sensor, world, pose, stamp, Turning { counter_clockwise: false, start: 0.0 })
}

/// The same of a sensor that turns otherwise.
pub fn sweep_turning(
    sensor: &Sensor,
    world: &[Corners],
    pose: impl Fn(f64) -> Se3,
    stamp: f64,
    turning: Turning,
) -> Vec<Return> {
    let sense = if turning.counter_clockwise { 1.0 } else { -1.0 };
    let mut returns = Vec::with_capacity(sensor.columns as usize * usize::from(sensor.rings));
    let mut random = Random::new((stamp / PERIOD).round() as u64);
    for column in 0..sensor.columns {
        let share = f64::from(column) / f64::from(sensor.columns);
        let time = share * PERIOD;
        let world_from_sensor = pose(stamp + time);
        for ring in 0..sensor.rings {
            let azimuth = turning.start + sense * share * std::f64::consts::TAU;
            let elevation = (sensor.spacing * f64::from(ring) + sensor.lowest).to_radians();
            let level = elevation.cos();
            let direction = Vector3::new(azimuth.cos() * level, azimuth.sin() * level, elevation.sin());
            let range =
                cast(world, &world_from_sensor.translation, &(world_from_sensor.rotation * direction));
            let point = direction * (range + f64::from(random.uniform(-1.0, 1.0)) * sensor.noise);
            if range <= sensor.reach {
                returns.push(Return { point: [0, 1, 2].map(|i| point[i] as f32), time: time as f32, ring });
            }
        }
    }
    returns
}

/// Distance along a ray to the nearest box, in metres where the direction has length 1.
fn cast(world: &[Corners], origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
    let mut nearest = f64::INFINITY;
    for [least, most] in world {
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..3 {
            let a = (least[axis] - origin[axis]) / direction[axis];
            let b = (most[axis] - origin[axis]) / direction[axis];
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        if enter <= leave && leave > 0.0 {
            nearest = nearest.min(if enter > 0.0 { enter } else { leave });
        }
    }
    nearest
}

/// A way along straight legs at walking pace, turning on the spot of each corner, from rest to rest: `world_from_sensor`
/// over time, and how long it takes.
pub fn walk(corners: &[[f64; 2]]) -> (impl Fn(f64) -> Se3 + use<>, f64) {
    // Metres a second in the middle of a leg; corners are rounded by the smooth parameter along the way.
    const PACE: f64 = 1.5;
    let points: Vec<Vector3<f64>> = corners.iter().map(|c| Vector3::new(c[0], c[1], 0.0)).collect();
    let length = |k: usize| (points[k + 1] - points[k]).norm();
    let mut ends = vec![0.0];
    for k in 0..points.len() - 1 {
        ends.push(ends[k] + length(k));
    }
    let total = ends[ends.len() - 1];
    let duration = total / PACE + 1.0;
    let at = move |time: f64| {
        let share = (time / duration).clamp(0.0, 1.0);
        // From rest to rest: the speed rises and falls over the first and last tenth.
        let ramp = 0.1;
        let travelled = match share {
            s if s < ramp => s * s / (2.0 * ramp),
            s if s > 1.0 - ramp => 1.0 - ramp - (1.0 - s).powi(2) / (2.0 * ramp),
            s => s - 0.5 * ramp,
        } / (1.0 - ramp)
            * total;
        let leg = (1..ends.len() - 1).take_while(|&k| ends[k] <= travelled).count();
        let direction = |k: usize| (points[k + 1] - points[k]).normalize();
        let along = travelled - ends[leg];
        // The robot turns over a metre on either side of a corner.
        let blend = |near: f64| 0.5 - 0.5 * (std::f64::consts::PI * near.clamp(0.0, 1.0)).cos();
        let heading = |k: usize| direction(k).y.atan2(direction(k).x);
        let rotation = |from: f64, to: f64| {
            (to - from + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
        };
        let mut yaw = heading(leg);
        let (left, last) = (ends[leg + 1] - travelled, leg + 2 == ends.len());
        if along < 1.0 && leg > 0 {
            yaw -= rotation(heading(leg - 1), yaw) * (1.0 - blend(0.5 + 0.5 * along));
        } else if left < 1.0 && !last {
            yaw += rotation(yaw, heading(leg + 1)) * blend(0.5 - 0.5 * left);
        }
        let position = points[leg] + direction(leg) * along;
        Se3::new(UnitQuaternion::from_scaled_axis(Vector3::z() * yaw), position)
    };
    (at, duration)
}

/// Writes a recording as a folder of KITTI scans (`velodyne`, `times`, `rings`, `times.txt`) with `groundtruth.txt` (TUM, 100
/// poses a second); returns the number of scans.
///
/// # Errors
/// When a file cannot be written.
pub fn write_recording(
    folder: &Path,
    world: &[Corners],
    pose: impl Fn(f64) -> Se3,
    duration: f64,
) -> io::Result<usize> {
    write_recording_of(&SIXTEEN, folder, world, pose, duration)
}

/// The same of another sensor.
///
/// # Errors
/// As [`write_recording`].
pub fn write_recording_of(
    sensor: &Sensor,
    folder: &Path,
    world: &[Corners],
    pose: impl Fn(f64) -> Se3,
    duration: f64,
) -> io::Result<usize> {
    for part in ["velodyne", "times", "rings"] {
        fs::create_dir_all(folder.join(part))?;
    }
    let count = (duration / PERIOD) as usize;
    let mut times = String::new();
    for index in 0..count {
        let stamp = index as f64 * PERIOD;
        let returns = sweep_of(sensor, world, &pose, stamp);
        let points = returns.iter().flat_map(|r| [r.point[0], r.point[1], r.point[2], 0.0]);
        fs::write(folder.join(format!("velodyne/{index:06}.bin")), bytes(points))?;
        fs::write(folder.join(format!("times/{index:06}.f32")), bytes(returns.iter().map(|r| r.time)))?;
        let rings: Vec<u8> = returns.iter().map(|r| r.ring).collect();
        fs::write(folder.join(format!("rings/{index:06}.u8")), rings)?;
        let _ = writeln!(times, "{stamp:.6} {index:06}");
    }
    fs::write(folder.join("times.txt"), times)?;
    let mut truth = String::new();
    for step in 0..=(100.0 * (duration + PERIOD)) as usize {
        let time = 0.01 * step as f64;
        let numbers = pose(time).to_tum().map(|v| format!("{v:.9}")).join(" ");
        let _ = writeln!(truth, "{time:.6} {numbers}");
    }
    fs::write(folder.join("groundtruth.txt"), truth)?;
    Ok(count)
}

fn bytes(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_is_smooth_and_ends_at_its_last_corner() {
        let (pose, duration) = walk(&[[0.0, 0.0], [6.0, 0.0], [6.0, 6.0]]);
        assert!((pose(duration).translation - Vector3::new(6.0, 6.0, 0.0)).norm() < 1e-9);
        let steps = (0..(duration * 100.0) as usize).map(|i| {
            let (a, b) = (pose(0.01 * i as f64), pose(0.01 * (i + 1) as f64));
            let step = a.inverse() * b;
            (step.translation.norm(), step.rotation.angle())
        });
        let most = steps.fold((0.0f64, 0.0f64), |m, s| (m.0.max(s.0), m.1.max(s.1)));
        // 2 m/s, 150°/s.
        assert!(most.0 < 0.02 && most.1 < 0.026, "{most:?}");
        assert!((pose(duration).rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn a_resting_sensor_sees_the_walls_where_they_are() {
        let returns = sweep(&HALL, |_| Se3::identity(), 0.0);
        assert_eq!(returns.len(), 14_400);
        let ahead = returns.iter().find(|r| r.ring == 8).unwrap();
        // The box that stands around the origin reaches from x = −2 to 1: the sensor is in it and sees its wall.
        assert!((f64::from(ahead.point[0]) - 1.0).abs() < SIXTEEN.noise + 1e-3, "{ahead:?}");
    }
}
