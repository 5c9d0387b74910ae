//! The world: boxes with textures.

use crate::lidar::HALL;
use crate::{Grain, Texture};
use geometry::Random;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};

/// Radius of the circles of [`World::town`], metres.
pub const RING: f64 = 10.0;

/// From a hall's axes (x forward, y left, z up) to those of a level camera.
pub fn world_from_hall() -> Se3 {
    let columns = [Vector3::z(), -Vector3::x(), -Vector3::y()];
    Se3::new(UnitQuaternion::from_matrix(&nalgebra::Matrix3::from_columns(&columns)), Vector3::zeros())
}

/// By how many texels the texture is shifted from face to face of a box.
pub(crate) const FACE_SHIFT: f32 = 171.0;

/// A textured box; one of zero thickness is a plane.
#[derive(Clone, Copy, Debug)]
pub struct Cuboid {
    /// Where its centre is and how it is turned.
    pub world_from_cuboid: Se3,
    /// Half its extent along its own axes, metres.
    pub half: Vector3<f64>,
    /// Which of the world's textures it wears.
    pub texture: usize,
    /// Size of a texel on its faces, metres.
    pub texel: f64,
    /// Shifts the texture, so that no two boxes look alike; texels.
    pub offset: [f32; 2],
}

/// Textured boxes in metres. World axes are those of a level camera: x right, y down, z forward.
pub struct World {
    /// What there is to see.
    pub cuboids: Vec<Cuboid>,
    /// What it wears.
    pub textures: Vec<Texture>,
}

impl World {
    /// The same world, in which each box has a grain of its own of this standard deviation, grey levels; 0 for none.
    pub fn with_grain(mut self, deviation: f32, seed: u64) -> Self {
        if deviation > 0.0 {
            for (number, cuboid) in self.cuboids.iter_mut().enumerate() {
                let grain =
                    Grain { seed: seed.wrapping_mul(0x9e37_79b9).wrapping_add(number as u64), deviation };
                self.textures.push(self.textures[cuboid.texture].with_grain(grain));
                cuboid.texture = self.textures.len() - 1;
            }
        }
        self
    }

    /// A walled yard, 24 m × 24 m around the origin with the ground at y = 0: a group of boxes in the middle
    /// (to orbit) and a row of boxes before the far wall z = 12 (to drive along). `seed` changes every texture
    /// and the places of the boxes.
    pub fn yard(seed: u64) -> Self {
        let textures = (0..4).map(|i| Texture::procedural(seed.wrapping_mul(31).wrapping_add(i))).collect();
        let mut world = Self { cuboids: Vec::new(), textures };
        let mut random = Random::new(seed ^ 0x5eed);
        let (side, height) = (12.0, 3.0);
        world.add(Vector3::zeros(), 0.0, Vector3::new(side, 0.0, side), 0.02, &mut random);
        for (x, z, half) in [
            (0.0, side, Vector3::new(side, height, 0.0)),
            (0.0, -side, Vector3::new(side, height, 0.0)),
            (side, 0.0, Vector3::new(0.0, height, side)),
            (-side, 0.0, Vector3::new(0.0, height, side)),
        ] {
            world.add(Vector3::new(x, -height, z), 0.0, half, 0.02, &mut random);
        }
        for i in 0..6 {
            let angle = i as f64 / 6.0 * std::f64::consts::TAU;
            let distance = random.uniform(0.5, 1.1) as f64;
            world.add_box(distance * angle.cos(), distance * angle.sin(), &mut random);
        }
        for i in 0..11 {
            let x = -10.0 + 2.0 * i as f64 + random.uniform(-0.5, 0.5) as f64;
            let z = random.uniform(8.0, 10.5) as f64;
            world.add_box(x, z, &mut random);
        }
        world
    }

    /// The hall that LiDARs see ([`HALL`]), its walls and boxes textured for cameras; [`world_from_hall`] is between the axes.
    pub fn hall(seed: u64) -> Self {
        let textures = (0..4).map(|i| Texture::procedural(seed.wrapping_mul(31).wrapping_add(i))).collect();
        let mut world = Self { cuboids: Vec::new(), textures };
        let mut random = Random::new(seed ^ 0x4a11);
        let mut add = |least: [f64; 3], most: [f64; 3]| {
            let middle = |axis: usize| 0.5 * (least[axis] + most[axis]);
            let half = |axis: usize| 0.5 * (most[axis] - least[axis]);
            let centre = world_from_hall() * Vector3::new(middle(0), middle(1), middle(2));
            world.add(centre, 0.0, Vector3::new(half(1), half(2), half(0)), 0.02, &mut random);
        };
        let [walls, boxes @ ..] = HALL;
        for axis in 0..3 {
            for side in walls {
                let (mut least, mut most) = (walls[0], walls[1]);
                (least[axis], most[axis]) = (side[axis], side[axis]);
                add(least, most);
            }
        }
        boxes.into_iter().for_each(|[least, most]| add(least, most));
        world
    }

    /// A long street of `rings` circles of radius [`RING`] metres, each touching the next along +x: a group of boxes in the
    /// middle of each, and boxes before walls on either side. See [`trajectory::town`](crate::trajectory::town).
    pub fn town(seed: u64, rings: usize) -> Self {
        let textures = (0..8).map(|i| Texture::procedural(seed.wrapping_mul(131).wrapping_add(i))).collect();
        let mut world = Self { cuboids: Vec::new(), textures };
        let mut random = Random::new(seed ^ 0x7077);
        for ring in 0..rings {
            let x = 2.0 * RING * ring as f64;
            world.add(Vector3::new(x, 0.0, 0.0), 0.0, Vector3::new(RING, 0.0, 3.0 * RING), 0.03, &mut random);
            for i in 0..7 {
                let angle = i as f64 / 7.0 * std::f64::consts::TAU;
                let distance = random.uniform(1.5, 4.5) as f64;
                world.add_house(x + distance * angle.cos(), distance * angle.sin(), &mut random);
            }
            for side in [-1.0, 1.0] {
                let wall = Vector3::new(RING, 4.0, 0.0);
                world.add(Vector3::new(x, -4.0, side * 2.0 * RING), 0.0, wall, 0.03, &mut random);
                for i in 0..6 {
                    let along = x + RING * ((i as f64 + 0.5) / 3.0 - 1.0);
                    let z = side * RING * random.uniform(1.35, 1.8) as f64;
                    world.add_house(along, z, &mut random);
                }
            }
        }
        for end in [-3.0, 2.0 * rings as f64 + 1.0] {
            let wall = Vector3::new(0.0, 4.0, 3.0 * RING);
            world.add(Vector3::new(RING * end, -4.0, 0.0), 0.0, wall, 0.03, &mut random);
        }
        world
    }

    /// Puts up a poster: a square of `side` metres, which shows all of `texture`. Its axes are x to the right, y down and z
    /// away from who reads it.
    pub fn put_up(&mut self, texture: Texture, world_from_poster: Se3, side: f64) {
        let texel = side / Texture::SIZE as f64;
        // The renderer shows other parts of a texture on each face of a box; this one is read from before.
        let offset = [0.5 * Texture::SIZE as f32 - 4.0 * FACE_SHIFT; 2];
        let half = Vector3::new(0.5 * side, 0.5 * side, 0.0);
        self.cuboids.push(Cuboid {
            world_from_cuboid: world_from_poster,
            half,
            texture: self.textures.len(),
            texel,
            offset,
        });
        self.textures.push(texture);
    }

    /// A house of random size standing on the ground at `(x, z)`.
    pub(crate) fn add_house(&mut self, x: f64, z: f64, random: &mut Random) {
        let mut size = |low, high| random.uniform(low, high) as f64;
        let half = Vector3::new(size(0.6, 1.4), size(0.7, 1.8), size(0.6, 1.4));
        let yaw = size(-0.8, 0.8);
        self.add(Vector3::new(x, -half.y, z), yaw, half, 0.015, random);
    }

    /// A room of random size around the origin, the ground at y = 0, with boxes of all sizes standing and hanging
    /// in it, each with a texture of another kind: something else for each seed.
    pub fn varied(seed: u64) -> Self {
        let textures = (0..6).map(|i| Texture::varied(seed.wrapping_mul(67).wrapping_add(i))).collect();
        let mut world = Self { cuboids: Vec::new(), textures };
        let mut random = Random::new(seed ^ 0xacce_5512);
        let (side, height) = (f64::from(random.uniform(2.5, 10.0)), f64::from(random.uniform(1.5, 3.0)));
        let texel = |random: &mut Random| f64::from(random.uniform(0.001, 0.005)) * side.min(5.0);
        let ground = texel(&mut random);
        world.add(Vector3::zeros(), 0.0, Vector3::new(side, 0.0, side), ground, &mut random);
        for (x, z) in [(0.0, side), (0.0, -side), (side, 0.0), (-side, 0.0)] {
            let half = Vector3::new(side - f64::abs(x), height, side - f64::abs(z));
            let wall = texel(&mut random);
            world.add(Vector3::new(x, -height, z), 0.0, half, wall, &mut random);
        }
        for _ in 0..30 {
            let mut within = |low: f64, high: f64| low + (high - low) * f64::from(random.uniform(0.0, 1.0));
            let half = Vector3::from_fn(|_, _| within(0.02, 0.08 * side));
            let (x, z) = (within(-0.95, 0.95) * side, within(-0.95, 0.95) * side);
            let (lift, yaw) = (within(0.0, 0.8) * height, within(-1.6, 1.6));
            let wear = texel(&mut random);
            world.add(Vector3::new(x, -half.y - lift, z), yaw, half, wear, &mut random);
        }
        world
    }

    /// A box of random size standing on the ground at `(x, z)`.
    fn add_box(&mut self, x: f64, z: f64, random: &mut Random) {
        let mut size = |low, high| random.uniform(low, high) as f64;
        let half = Vector3::new(size(0.25, 0.6), size(0.35, 0.95), size(0.25, 0.6));
        let yaw = size(-0.8, 0.8);
        self.add(Vector3::new(x, -half.y, z), yaw, half, 0.008, random);
    }

    pub(crate) fn add(
        &mut self,
        centre: Vector3<f64>,
        yaw: f64,
        half: Vector3<f64>,
        texel: f64,
        random: &mut Random,
    ) {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
        self.cuboids.push(Cuboid {
            world_from_cuboid: Se3::new(rotation, centre),
            half,
            texture: random.bits() as usize % self.textures.len(),
            texel,
            offset: [random.uniform(0.0, 1024.0), random.uniform(0.0, 1024.0)],
        });
    }
}
