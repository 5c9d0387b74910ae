//! Places that look alike: of one kind, they have much in common and are yet different places.

use crate::trajectory::look;
use crate::{Cuboid, Texture, World};
use geometry::Random;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};

/// What places of one kind have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A row of equal houses behind one pavement; what stands in front of them differs.
    Houses,
    /// One pavement with its kerb and lines; the houses behind it and what stands in front of them differ.
    Pavement,
    /// A corridor of equal doors; notices on the wall and things on the floor differ.
    Corridor,
    /// A car park: the pavement, its bays and cars of three makes; which of them stand where and the wall behind
    /// differ.
    CarPark,
}

/// Textures that all places of a kind have in common.
const COMMON: u64 = 4;
/// Textures that each place has for itself.
const OWN: u64 = 3;

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Houses, Self::Pavement, Self::Corridor, Self::CarPark];

    /// Place number `place` of this kind around the origin, to be seen towards +z. Another `seed` gives another kind of the
    /// sort: other doors, other cars.
    pub fn place(self, seed: u64, place: u64) -> World {
        let mut common = Random::new(seed.wrapping_mul(0x51ed).wrapping_add(self as u64));
        let mut own = Random::new(common.bits() ^ place.wrapping_mul(0x9e37_79b9));
        let textures = |random: &mut Random, count| -> Vec<Texture> {
            (0..count).map(|_| Texture::varied(random.bits())).collect()
        };
        let mut worn = textures(&mut common, COMMON);
        worn.extend(textures(&mut own, OWN));
        let mut built = Built { world: World { cuboids: Vec::new(), textures: worn }, common, own };
        match self {
            Self::Houses => built.houses(),
            Self::Pavement => built.pavement(),
            Self::Corridor => built.corridor(),
            Self::CarPark => built.car_park(),
        }
        built.world
    }

    /// A way of `count` frames past a place of this kind, number `pass` of those past the place: each from elsewhere, in
    /// either direction, and each past the middle.
    pub fn path(self, seed: u64, place: u64, pass: u64, count: usize) -> Vec<Se3> {
        let mut random = Random::new(seed.wrapping_mul(0xa11e).wrapping_add(place.wrapping_mul(64) + pass));
        let mut uniform = |low, high| f64::from(random.uniform(low, high));
        let reach = if self == Self::Corridor { 0.45 } else { 1.0 };
        let middle = Vector3::new(uniform(-0.8, 0.8), uniform(-1.5, -1.2), uniform(-0.5, 0.5)) * reach;
        let (yaw, pitch) = (uniform(-0.15, 0.15), uniform(0.1, 0.16));
        let sense = if uniform(0.0, 1.0) < 0.25 { -1.0 } else { 1.0 };
        let length = 5.0 * reach;
        let pose = |i: usize| {
            let s = i as f64 / (count - 1).max(1) as f64 - 0.5;
            let x = sense * length * s;
            let swing = Vector3::new(x, 0.02 * (1.9 * x).sin(), 0.06 * reach * (1.1 * x).sin());
            look(middle + swing, yaw + 0.03 * (1.3 * x).sin(), pitch)
        };
        (0..count).map(pose).collect()
    }
}

/// A place that is being built, and where its numbers come from.
struct Built {
    world: World,
    common: Random,
    own: Random,
}

/// Whether a thing is the same at all places of a kind.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Of {
    All,
    One,
}

impl Built {
    fn houses(&mut self) {
        self.ground();
        let half = Vector3::new(1.6, self.uniform(Of::All, 1.8, 2.4), 1.0);
        for i in -4..=4 {
            self.repeated(Vector3::new(4.0 * f64::from(i), -half.y, 7.5), half, 1, 0.008);
            self.repeated(
                Vector3::new(4.0 * f64::from(i) + 0.6, -1.0, 6.46),
                Vector3::new(0.45, 1.0, 0.04),
                2,
                0.004,
            );
        }
        self.wall(Of::All, 10.0, 2.5);
        self.things(5.0);
    }

    fn pavement(&mut self) {
        self.ground();
        self.lines();
        let mut x = -16.0;
        while x < 16.0 {
            let half = Vector3::new(self.uniform(Of::One, 0.8, 2.0), self.uniform(Of::One, 1.2, 2.6), 1.0);
            let set_back = self.uniform(Of::One, 0.0, 1.2);
            self.add(Of::One, Vector3::new(x + half.x, -half.y, 7.5 + set_back), 0.0, half, 0.008);
            x += 2.0 * half.x + self.uniform(Of::One, 0.0, 0.8);
        }
        self.things(5.0);
    }

    fn corridor(&mut self) {
        self.ground();
        self.wall(Of::All, 2.4, 1.4);
        for i in -5..=5 {
            let x = 2.2 * f64::from(i);
            self.repeated(Vector3::new(x, -1.05, 2.37), Vector3::new(0.45, 1.05, 0.04), 2, 0.003);
            self.repeated(Vector3::new(x + 0.3, -1.0, 2.3), Vector3::new(0.03, 0.03, 0.04), 3, 0.001);
        }
        for i in -5..=5 {
            if self.uniform(Of::One, 0.0, 1.0) < 0.7 {
                let half =
                    Vector3::new(self.uniform(Of::One, 0.1, 0.4), self.uniform(Of::One, 0.1, 0.4), 0.01);
                let at = [self.uniform(Of::One, 0.9, 1.3), self.uniform(Of::One, -1.8, -1.2)];
                self.add(Of::One, Vector3::new(2.2 * f64::from(i) + at[0], at[1], 2.38), 0.0, half, 0.002);
            }
        }
        self.things(1.9);
    }

    fn car_park(&mut self) {
        self.ground();
        self.lines();
        self.wall(Of::One, 8.0, 2.5);
        for bay in -5..=5 {
            let make = self.own.bits() % 4;
            if make == 3 {
                continue;
            }
            let (x, z) = (
                2.6 * f64::from(bay) + self.uniform(Of::One, -0.15, 0.15),
                5.2 + self.uniform(Of::One, -0.2, 0.2),
            );
            let long = 0.8 + 0.06 * make as f64;
            let wheel =
                |side: f64| (Vector3::new(x + side * 0.62, -0.3, z - 1.6), Vector3::new(0.12, 0.3, 0.3));
            let make = make as usize;
            self.repeated(Vector3::new(x, -0.55, z), Vector3::new(long, 0.35, 1.8), make + 1, 0.004);
            self.repeated(
                Vector3::new(x, -1.1, z + 0.3),
                Vector3::new(long - 0.12, 0.28, 1.0),
                make + 1,
                0.005,
            );
            for (centre, half) in [wheel(-1.0), wheel(1.0)] {
                self.repeated(centre, half, 0, 0.003);
            }
        }
    }

    /// The pavement, slabs that repeat.
    fn ground(&mut self) {
        self.repeated(Vector3::zeros(), Vector3::new(30.0, 0.0, 12.0), 0, 0.004);
    }

    /// Kerb and lines of bays.
    fn lines(&mut self) {
        self.repeated(Vector3::new(0.0, -0.06, 7.0), Vector3::new(30.0, 0.06, 0.12), 1, 0.004);
        for i in -7..=7 {
            let x = 2.6 * f64::from(i) + 1.3;
            self.repeated(Vector3::new(x, -0.01, 4.6), Vector3::new(0.06, 0.01, 2.2), 3, 0.02);
        }
    }

    /// A wall across the view.
    fn wall(&mut self, of: Of, z: f64, half_height: f64) {
        let half = Vector3::new(30.0, half_height, 0.0);
        self.add(of, Vector3::new(0.0, -half_height, z), 0.0, half, 0.004);
    }

    /// Things that stand around before what is `far` away, this place's own.
    fn things(&mut self, far: f64) {
        let count = 4 + self.own.bits() % 9;
        for _ in 0..count {
            let size = 0.12 * far;
            let half = Vector3::from_fn(|_, _| self.uniform(Of::One, 0.25, 1.0) * size);
            let x = self.uniform(Of::One, -1.6, 1.6) * far;
            let z = far * self.uniform(Of::One, 0.75, 1.1);
            let yaw = self.uniform(Of::One, -0.8, 0.8);
            self.add(Of::One, Vector3::new(x, -half.y, z), yaw, half, 0.0012 * far);
        }
    }

    fn uniform(&mut self, of: Of, low: f32, high: f32) -> f64 {
        let random = if of == Of::All { &mut self.common } else { &mut self.own };
        f64::from(random.uniform(low, high))
    }

    /// A box with a texture and an offset that are drawn.
    fn add(&mut self, of: Of, centre: Vector3<f64>, yaw: f64, half: Vector3<f64>, texel: f64) {
        let (random, first, count) =
            if of == Of::All { (&mut self.common, 0, COMMON) } else { (&mut self.own, COMMON, OWN) };
        let texture = (first + random.bits() % count) as usize;
        let offset = [random.uniform(0.0, 1024.0), random.uniform(0.0, 1024.0)];
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
        let world_from_cuboid = Se3::new(rotation, centre);
        self.world.cuboids.push(Cuboid { world_from_cuboid, half, texture, texel, offset });
    }

    /// A box like others of its sort everywhere.
    fn repeated(&mut self, centre: Vector3<f64>, half: Vector3<f64>, texture: usize, texel: f64) {
        let world_from_cuboid = Se3::new(UnitQuaternion::identity(), centre);
        self.world.cuboids.push(Cuboid { world_from_cuboid, half, texture, texel, offset: [0.0; 2] });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Recording, render};

    /// Mean difference of two images of places, grey levels.
    fn difference(kind: Kind, a: u64, b: u64) -> f64 {
        let pose = look(Vector3::new(0.0, -1.3, 0.0), 0.0, 0.12);
        let images = [a, b].map(|place| render(&kind.place(1, place), &Recording::SMALL_CAMERA, &pose).0);
        let pixels = images[0].data().iter().zip(images[1].data());
        pixels.clone().map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / pixels.len() as f64
    }

    #[test]
    fn places_of_a_kind_are_similar_and_not_the_same() {
        for kind in Kind::ALL {
            assert_eq!(difference(kind, 1, 1), 0.0);
            let found = difference(kind, 1, 2);
            assert!((2.0..40.0).contains(&found), "{kind:?}: {found}");
        }
    }
}
