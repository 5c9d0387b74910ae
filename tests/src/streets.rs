//! Drives of more than 200 m round a block of houses that come back to a street which they began in: in their own lane, a metre
//! aside, or from the other direction.

use crate::recording::Shutter;
use crate::trajectory::look;
use crate::{Recording, Texture, World};
use geometry::{Random, Se3};
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// Metres between frames, and frames a second: 32 km/h.
const STEP: f64 = 0.3;
const RATE: f64 = 30.0;
/// Seconds from the first row to the last, and that each row gathers light.
const SHUTTER: Shutter = Shutter { readout: 0.02, exposure: 0.006 };
/// Standard deviation of the noise, grey levels.
const NOISE: f64 = 2.0;
/// Metres of the street that is driven twice.
const SHARED: f64 = 28.0;
/// Height of the camera above the ground, radius of a bend, half the width of a street and how far behind it walls stand, metres.
const HEIGHT: f64 = 1.4;
const BEND: f64 = 5.0;
const STREET: f64 = 4.5;
const WALL: f64 = 14.0;
/// Angle between the camera and the way ahead: to the side, so that the two directions of a street show the same houses.
const ASIDE: f64 = 1.15;
/// Metres that a camera needs to turn from one side to the other.
const PAN: f64 = 40.0;

/// How a drive comes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Return {
    /// Where it drove before.
    SameLane,
    /// A metre to the side of that.
    MetreAside,
    /// The other way along the street.
    OtherDirection,
}

impl Return {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::SameLane, Self::MetreAside, Self::OtherDirection];
}

/// A drive round a block, and how many frames at its end show what frames at its begin do.
pub struct Loop {
    /// The drive.
    pub recording: Recording,
    /// Frames of the street that is driven twice, at the end.
    pub returning: usize,
}

/// A drive through streets of houses, by a camera with a rolling shutter, motion blur and noise; another seed is another block. Houses
/// wear one of ten textures, and each has a grain of its own with the standard deviation `grain`, grey levels, or none.
pub fn round_the_block(how: Return, seed: u64, grain: f32) -> Loop {
    let mut random = Random::new(seed ^ 0xb10c);
    let mut size = |low, high| f64::from(random.uniform(low, high));
    let block = Vector2::new(size(58.0, 70.0), size(46.0, 54.0));
    let path = drive(how, block, seed);
    let recording = Recording::render_exposed(
        &streets(block, seed).with_grain(grain, seed),
        Recording::SMALL_CAMERA,
        &path,
        RATE,
        SHUTTER,
    );
    let returning = ((SHARED - BEND) / STEP) as usize;
    Loop { recording: recording.with_noise(NOISE, seed), returning }
}

/// Where the middles of the streets meet, to the east (x) and to the north (z) of the crossing that closes the loop.
fn corners(how: Return, block: Vector2<f64>) -> Vec<Vector2<f64>> {
    let last = if how == Return::OtherDirection { -SHARED } else { SHARED };
    vec![
        Vector2::new(-SHARED, 0.0),
        Vector2::new(block.x, 0.0),
        block,
        Vector2::new(0.0, block.y),
        Vector2::zeros(),
        Vector2::new(last, 0.0),
    ]
}

/// Poses of the camera, a frame every [`STEP`] metres.
fn drive(how: Return, block: Vector2<f64>, seed: u64) -> Vec<Se3> {
    let path = rounded(&corners(how, block));
    let length = path.len() as f64 * STEP;
    let turned = SHARED + block.x + block.y;
    let mut random = Random::new(seed ^ 0xd21e);
    let mut phase = || f64::from(random.uniform(0.0, std::f32::consts::TAU));
    let (bounce, roll, nod) = (phase(), phase(), phase());
    let pose = |(i, (at, heading)): (usize, &(Vector2<f64>, f64))| {
        let travelled = i as f64 * STEP;
        let left = Vector2::new(-heading.cos(), heading.sin());
        let aside = match how {
            Return::MetreAside => smooth((travelled - 0.5 * length) / PAN),
            _ => 0.0,
        };
        let at = at + left * aside;
        // To the left all the way, or to the right at first.
        let side = match how {
            Return::OtherDirection => 1.0 - 2.0 * smooth((travelled - turned) / PAN),
            _ => -1.0,
        };
        let height = HEIGHT + 0.02 * (0.9 * travelled + bounce).sin();
        let tilt = Se3::new(
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.01 * (0.7 * travelled + roll).sin()),
            Vector3::zeros(),
        );
        let pitch = 0.05 + 0.01 * (1.1 * travelled + nod).sin();
        look(Vector3::new(at.x, -height, at.y), heading + side * ASIDE, pitch) * tilt
    };
    path.iter().enumerate().map(pose).collect()
}

/// From 0 to 1 while `x` goes there, without a jump of its slope.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Positions along lines between corners, which are rounded, and headings, radians to the right of north; one every [`STEP`] metres.
fn rounded(corners: &[Vector2<f64>]) -> Vec<(Vector2<f64>, f64)> {
    let dense = 20;
    let step = STEP / dense as f64;
    let mut fine = Vec::new();
    let mut from = corners[0];
    for (i, corner) in corners.iter().enumerate().skip(1) {
        let ahead = (corner - from).normalize();
        let next = corners.get(i + 1).map(|next| (next - corner).normalize());
        let until = if next.is_some() { corner - ahead * BEND } else { *corner };
        let count = ((until - from).norm() / step) as usize;
        fine.extend((0..count).map(|k| (from + ahead * (k as f64 * step), ahead)));
        from = until;
        if let Some(next) = next {
            let turn = 0.5 * std::f64::consts::PI;
            let count = (BEND * turn / step) as usize;
            fine.extend((0..count).map(|k| {
                let (sin, cos) = (turn * k as f64 / count as f64).sin_cos();
                let at = until + ahead * (BEND * sin) + next * (BEND * (1.0 - cos));
                (at, ahead * cos + next * sin)
            }));
            from = corner + next * BEND;
        }
    }
    fine.iter().step_by(dense).map(|(at, ahead)| (*at, ahead.x.atan2(ahead.y))).collect()
}

/// Streets with houses on both sides and walls behind them.
fn streets(block: Vector2<f64>, seed: u64) -> World {
    let textures = (0..10).map(|i| Texture::procedural(seed.wrapping_mul(173).wrapping_add(i))).collect();
    let mut world = World { cuboids: Vec::new(), textures };
    let mut random = Random::new(seed ^ 0x57ee);
    let (west, east) = (-SHARED - WALL, block.x + WALL);
    let (south, north) = (-WALL, block.y + WALL);
    let middle = Vector3::new(0.5 * (west + east), 0.0, 0.5 * (south + north));
    let half = Vector3::new(0.5 * (east - west), 0.0, 0.5 * (north - south));
    world.add(middle, 0.0, half, 0.03, &mut random);
    for (x, z, half) in [
        (middle.x, south, Vector3::new(half.x, 4.0, 0.0)),
        (middle.x, north, Vector3::new(half.x, 4.0, 0.0)),
        (west, middle.z, Vector3::new(0.0, 4.0, half.z)),
        (east, middle.z, Vector3::new(0.0, 4.0, half.z)),
    ] {
        world.add(Vector3::new(x, -4.0, z), 0.0, half, 0.03, &mut random);
    }
    let inner = block * 0.5 - Vector2::repeat(WALL);
    let centre = Vector3::new(0.5 * block.x, -4.0, 0.5 * block.y);
    world.add(centre, 0.0, Vector3::new(inner.x, 4.0, inner.y), 0.03, &mut random);
    let mut lines = corners(Return::OtherDirection, block);
    lines.pop();
    let lines: Vec<_> = lines.windows(2).map(|ends| (ends[0], ends[1])).collect();
    for (from, to) in &lines {
        houses_along(*from, *to, &lines, &mut world, &mut random);
    }
    world
}

/// Puts houses on both sides of a street, on none of the streets.
fn houses_along(
    from: Vector2<f64>,
    to: Vector2<f64>,
    streets: &[(Vector2<f64>, Vector2<f64>)],
    world: &mut World,
    random: &mut Random,
) {
    let along = (to - from).normalize();
    let across = Vector2::new(along.y, -along.x);
    let mut at = -STREET;
    while at < (to - from).norm() + STREET {
        for side in [-1.0, 1.0] {
            let off = f64::from(random.uniform(6.2, 9.0));
            let place = from + along * (at + f64::from(random.uniform(-0.6, 0.6))) + across * (side * off);
            if streets.iter().all(|(a, b)| distance(place, *a, *b) > STREET + 1.4) {
                world.add_house(place.x, place.y, random);
            }
        }
        at += 3.2;
    }
}

/// From a point to the line between two.
fn distance(point: Vector2<f64>, from: Vector2<f64>, to: Vector2<f64>) -> f64 {
    let line = to - from;
    let share = ((point - from).dot(&line) / line.norm_squared()).clamp(0.0, 1.0);
    (point - from - line * share).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory::length;

    #[test]
    fn a_drive_is_smooth_longer_than_200_m_and_ends_where_it_was() {
        for how in Return::ALL {
            let path = drive(how, Vector2::new(60.0, 48.0), 3);
            let steps = path.windows(2).map(|w| (w[1].translation - w[0].translation).norm());
            assert!(
                steps.clone().all(|step| (0.2..0.4).contains(&step)),
                "{how:?}: {:?}",
                steps.reduce(f64::max)
            );
            let turns = path.windows(2).map(|w| w[0].rotation.angle_to(&w[1].rotation));
            assert!(turns.clone().all(|turn| turn < 0.1), "{how:?}: {:?}", turns.reduce(f64::max));
            assert!(length(&path) > 200.0 + SHARED, "{how:?}: {}", length(&path));
            let last = path[path.len() - 1];
            let off = |pose: &Se3| (pose.translation - last.translation).norm();
            let nearest = path[..path.len() / 3].iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
            let expected = if how == Return::MetreAside { 0.8..1.2 } else { 0.0..0.3 };
            assert!(expected.contains(&off(nearest)), "{how:?}: {}", off(nearest));
            let angle = (nearest.rotation * Vector3::z()).angle(&(last.rotation * Vector3::z()));
            let seen_from = std::f64::consts::PI - 2.0 * ASIDE;
            let expected = if how == Return::OtherDirection { seen_from } else { 0.0 };
            assert!((angle - expected).abs() < 0.1, "{how:?}: {angle}");
        }
    }

    #[test]
    fn no_house_stands_on_the_path() {
        let block = Vector2::new(60.0, 48.0);
        let world = streets(block, 3);
        for pose in drive(Return::OtherDirection, block, 3) {
            for house in &world.cuboids[6..] {
                let off = house.world_from_cuboid.translation - pose.translation;
                assert!(Vector2::new(off.x, off.z).norm() > 2.0);
            }
        }
    }
}
