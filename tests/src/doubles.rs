//! Doubles: places that share what is made in numbers, the plan, posters, frames, goods, and differ in a share of their things,
//! each surface with a grain of its own or without; and the same places again after a share of their things has moved.

use crate::trajectory::look;
use crate::{Cuboid, Grain, Texture, World};
use geometry::{Random, Se3};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::LazyLock;

/// What places of one kind have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Rooms of other plaster, brick, wood or tiles, in which the same three posters hang.
    Posters,
    /// A façade of equal windows, each with a curtain, a blind or a thing in it.
    Facade,
    /// A supermarket's aisle, goods on five boards.
    Aisle,
    /// An office of one plan: desks, screens, papers, a board.
    Office,
    /// An empty room of tiles.
    Empty,
    /// A lobby: lifts, doors, notices, a number on the wall.
    Lobby,
    /// A hotel's corridor: equal doors, numbers, lamps, a carpet.
    Hotel,
    /// A stairwell: steps, a rail, a door, notices.
    Stairs,
    /// A row of houses with bins, bicycles, plants before them.
    Row,
    /// A hall of racks, pallets in their bays.
    Hall,
    /// A flat and its mirror image next door, as architects draw them: the same furniture, some of it another.
    Mirrored,
}

/// Which of the places of a kind, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Version {
    /// Another seed is another design: other posters, other windows.
    pub seed: u64,
    /// Number of the place; its grain and the things that differ are its own.
    pub place: u64,
    /// Share of the things that differ from those of place 0, 0–1.
    pub share: f64,
    /// When: of another time than 0 a share of the things has moved or was changed for another.
    pub time: u64,
    /// That share, 0–1.
    pub moved: f64,
    /// Standard deviation of the grain that each surface has for itself, grey levels; 0 for none.
    pub grain: f32,
}

/// Pictures that things of all places wear, each another part of one.
static PICTURES: LazyLock<Vec<Texture>> = LazyLock::new(|| (900..908).map(Texture::varied).collect());
/// Plaster, brick, wood, tiles, a carpet.
static STUFFS: LazyLock<[Texture; 5]> = LazyLock::new(|| {
    let joint = |v: usize, step: usize| v % step < 3;
    let tone = |x: usize, y: usize| (Random::new((x * 977 + y) as u64).unit() as f32 - 0.5) * 30.0;
    [
        Texture::painted(|_, _| 168.0),
        Texture::painted(move |x, y| {
            let (row, column) = (y / 32, (x + y / 32 % 2 * 32) / 64 % 16);
            let is_joint = joint(y, 32) || joint(x + row % 2 * 32, 64);
            if is_joint { 150.0 } else { 105.0 + tone(column, row) }
        }),
        Texture::painted(move |x, y| {
            let plank = x / 64;
            let waves = (x as f32 * 0.9).sin() * 4.0 + ((y as f32) * 0.012 + plank as f32).sin() * 6.0;
            if joint(x, 64) { 70.0 } else { 120.0 + tone(plank, 7) + waves }
        }),
        Texture::painted(move |x, y| if joint(x, 128) || joint(y, 128) { 120.0 } else { 196.0 }),
        Texture::varied(77),
    ]
});
const PLASTER: usize = 0;
const BRICK: usize = 1;
const WOOD: usize = 2;
const TILES: usize = 3;
const CARPET: usize = 4;

impl Kind {
    /// The kinds that limits may be set on.
    pub const TUNED: [Self; 6] =
        [Self::Posters, Self::Facade, Self::Aisle, Self::Office, Self::Empty, Self::Hall];
    /// The kinds that are shown only.
    pub const HELD_OUT: [Self; 5] = [Self::Lobby, Self::Hotel, Self::Stairs, Self::Row, Self::Mirrored];

    /// A place of this kind around the origin, to be seen towards +z.
    pub fn world(self, version: &Version) -> World {
        let world = World { cuboids: Vec::new(), textures: Vec::new() };
        let mut built = Built { version: *version, kind: self as u64, slot: 0, world };
        match self {
            Self::Posters => built.posters(),
            Self::Facade => built.facade(),
            Self::Aisle => built.aisle(),
            Self::Office => built.office(),
            Self::Empty => built.room([TILES, TILES, TILES], 3.2, 2.6),
            Self::Lobby => built.lobby(),
            Self::Hotel => built.hotel(),
            Self::Stairs => built.stairs(),
            Self::Row => built.row(),
            Self::Hall => built.hall(),
            Self::Mirrored => built.mirrored(),
        }
        built.world
    }

    /// A way of `count` frames past a place, number `pass` of those past it: each from elsewhere, in either direction, and each
    /// past the middle.
    pub fn path(self, pass: u64, count: usize) -> Vec<Se3> {
        let mut random = Random::new(0xd0b1 + pass.wrapping_mul(7919));
        let mut uniform = |low, high| f64::from(random.uniform(low, high));
        let reach = if matches!(self, Self::Facade | Self::Row | Self::Hall) { 1.6 } else { 1.0 };
        let middle = Vector3::new(uniform(-0.2, 0.2), uniform(-1.5, -1.3), uniform(-0.3, 0.1)) * reach;
        let (yaw, pitch) = (uniform(-0.1, 0.1), uniform(0.02, 0.08));
        let sense = if uniform(0.0, 1.0) < 0.3 { -1.0 } else { 1.0 };
        let pose = |i: usize| {
            let x = sense * reach * 1.8 * (i as f64 / (count - 1).max(1) as f64 - 0.5);
            let swing = Vector3::new(x, 0.03 * (3.9 * x).sin(), 0.08 * reach * (2.1 * x).sin());
            look(middle + swing, yaw + 0.05 * (2.3 * x).sin(), pitch)
        };
        (0..count).map(pose).collect()
    }
}

/// A place that is being built.
struct Built {
    version: Version,
    kind: u64,
    /// Number of the next thing.
    slot: u64,
    world: World,
}

/// Numbers drawn from numbers.
fn hash(parts: &[u64]) -> u64 {
    parts.iter().fold(0x5eed, |sum, part| {
        Random::new(sum ^ part.wrapping_mul(0x9e37_79b9_7f4a_7c15)).bits().rotate_left(17)
    })
}

impl Built {
    /// What the next thing is drawn from: that of all places, or where it differs or has moved, another.
    fn thing(&mut self) -> Random {
        let Version { seed, place, share, time, moved, .. } = self.version;
        self.slot += 1;
        let mut content = hash(&[seed, self.kind, self.slot]);
        let chance = |parts: &[u64]| Random::new(hash(parts)).unit();
        if place != 0 && chance(&[content, 1]) < share {
            content = hash(&[content, 3, place]);
        }
        if time != 0 && chance(&[content, 2, time]) < moved {
            content = hash(&[content, 4, place, time]);
        }
        Random::new(content)
    }

    /// A box of a texture, which is given a grain of its own.
    fn add(&mut self, [centre, half]: [Vector3<f64>; 2], yaw: f64, texture: &Texture, wear: Wear) {
        let grain = Grain { seed: hash(&[wear.own, self.version.place]), deviation: self.version.grain };
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
        self.world.cuboids.push(Cuboid {
            world_from_cuboid: Se3::new(rotation, centre),
            half,
            texture: self.world.textures.len(),
            texel: wear.texel,
            offset: wear.offset,
        });
        let is_bare = self.version.grain <= 0.0;
        self.world.textures.push(if is_bare { texture.clone() } else { texture.with_grain(grain) });
    }

    /// What all places have: a wall, a board, a frame.
    fn fixed(&mut self, box_: [Vector3<f64>; 2], stuff: usize, texel: f64) {
        self.slot += 1;
        let own = hash(&[self.version.seed, self.kind, self.slot, 9]);
        self.add(box_, 0.0, &STUFFS[stuff], Wear { own, texel, offset: [0.0; 2] });
    }

    /// A thing of its own look: `size` is the most it measures, `play` how far it may stand off.
    fn piece(&mut self, centre: Vector3<f64>, size: Vector3<f64>, play: f64, texel: f64) {
        let mut random = self.thing();
        let mut within = |low: f32, high: f32| f64::from(random.uniform(low, high));
        let half = size.map(|size| 0.5 * size * within(0.65, 1.0));
        // It stands on what the largest would stand on.
        let shift =
            Vector3::new(play * within(-1.0, 1.0), 0.5 * size.y - half.y, 0.3 * play * within(-1.0, 1.0));
        let yaw = if size.z > 0.05 { within(-0.3, 0.3) } else { 0.0 };
        let offset = [0, 1].map(|_| within(0.0, 1024.0) as f32);
        let texture = &PICTURES[random.index(PICTURES.len())];
        let own = random.bits();
        self.add([centre + shift, half], yaw, texture, Wear { own, texel, offset });
    }

    /// Floor, back wall and side walls at `depth` and `wide` metres.
    fn room(&mut self, [floor, back, side]: [usize; 3], depth: f64, wide: f64) {
        self.fixed([Vector3::zeros(), Vector3::new(12.0, 0.0, 12.0)], floor, 0.004);
        self.fixed([Vector3::new(0.0, -1.5, depth), Vector3::new(wide, 1.5, 0.0)], back, 0.004);
        for x in [-wide, wide] {
            self.fixed([Vector3::new(x, -1.5, 0.0), Vector3::new(0.0, 1.5, depth)], side, 0.004);
        }
        self.fixed([Vector3::new(0.0, -3.0, 0.0), Vector3::new(12.0, 0.0, 12.0)], PLASTER, 0.004);
    }

    fn posters(&mut self) {
        let place = self.version.place as usize;
        self.room([[WOOD, TILES, CARPET][place / 4 % 3], place % 4, (place + 1) % 4], 2.8, 2.6);
        let share = std::mem::replace(&mut self.version.share, 0.0);
        for x in [-1.1, 0.0, 1.1] {
            self.piece(Vector3::new(x, -1.5, 2.78), Vector3::new(0.8, 1.0, 0.0), 0.0, 0.003);
        }
        self.version.share = share;
        for x in [-1.7, 1.6] {
            self.piece(Vector3::new(x, -0.3, 2.3), Vector3::new(0.5, 0.6, 0.4), 0.3, 0.003);
        }
    }

    fn facade(&mut self) {
        self.fixed([Vector3::zeros(), Vector3::new(30.0, 0.0, 12.0)], TILES, 0.006);
        self.fixed([Vector3::new(0.0, -3.0, 5.0), Vector3::new(9.0, 3.0, 0.0)], BRICK, 0.006);
        for (row, column) in (0..3).flat_map(|row| (-4..=4).map(move |column| (row, column))) {
            let (x, y) = (1.2 * f64::from(column), -1.0 - 1.5 * f64::from(row));
            self.fixed([Vector3::new(x, y, 4.96), Vector3::new(0.42, 0.55, 0.03)], TILES, 0.02);
            self.piece(Vector3::new(x, y, 4.92), Vector3::new(0.7, 0.95, 0.0), 0.0, 0.006);
        }
    }

    fn aisle(&mut self) {
        self.room([TILES, PLASTER, PLASTER], 2.4, 3.4);
        for (board, column) in (0..5).flat_map(|board| (-9..=9).map(move |column| (board, column))) {
            let (x, y) = (0.32 * f64::from(column), -0.25 - 0.5 * f64::from(board));
            if column == 0 {
                self.fixed(
                    [Vector3::new(0.0, y + 0.05, 2.15), Vector3::new(3.2, 0.02, 0.25)],
                    PLASTER,
                    0.004,
                );
            }
            self.piece(Vector3::new(x, y - 0.17, 2.05), Vector3::new(0.26, 0.4, 0.2), 0.02, 0.0025);
        }
    }

    fn office(&mut self) {
        self.room([CARPET, PLASTER, PLASTER], 3.4, 2.8);
        self.fixed([Vector3::new(0.0, -1.7, 3.38), Vector3::new(0.8, 0.5, 0.01)], TILES, 0.01);
        for x in [-1.7, 0.0, 1.7] {
            self.fixed([Vector3::new(x, -0.72, 2.6), Vector3::new(0.7, 0.02, 0.4)], WOOD, 0.004);
            self.piece(Vector3::new(x, -1.0, 2.75), Vector3::new(0.5, 0.4, 0.06), 0.1, 0.002);
            for (dx, dz) in [(-0.5, 2.4), (0.4, 2.45), (0.55, 2.7)] {
                self.piece(Vector3::new(x + dx, -0.83, dz), Vector3::new(0.16, 0.2, 0.16), 0.08, 0.0015);
            }
            self.piece(Vector3::new(x, -0.4, 2.0), Vector3::new(0.45, 0.8, 0.4), 0.2, 0.003);
            self.piece(Vector3::new(x, -1.75, 3.36), Vector3::new(0.5, 0.6, 0.0), 0.2, 0.002);
        }
    }

    fn lobby(&mut self) {
        self.room([TILES, PLASTER, WOOD], 3.2, 2.9);
        for x in [-1.6, 0.0, 1.6] {
            self.fixed([Vector3::new(x, -1.05, 3.18), Vector3::new(0.5, 1.05, 0.02)], WOOD, 0.01);
            self.fixed([Vector3::new(x, -1.05, 3.15), Vector3::new(0.02, 1.0, 0.01)], TILES, 0.01);
            self.piece(Vector3::new(x + 0.8, -1.5, 3.17), Vector3::new(0.35, 0.45, 0.0), 0.08, 0.002);
            self.piece(Vector3::new(x + 0.8, -0.35, 2.9), Vector3::new(0.4, 0.7, 0.3), 0.15, 0.003);
            self.piece(Vector3::new(x, -2.4, 3.17), Vector3::new(0.4, 0.35, 0.0), 0.0, 0.002);
        }
    }

    fn hotel(&mut self) {
        self.room([CARPET, PLASTER, PLASTER], 2.2, 4.0);
        for i in -3..=3 {
            let x = 1.3 * f64::from(i);
            self.fixed([Vector3::new(x, -1.05, 2.18), Vector3::new(0.42, 1.05, 0.02)], WOOD, 0.005);
            self.fixed([Vector3::new(x + 0.32, -1.0, 2.14), Vector3::new(0.05, 0.02, 0.02)], TILES, 0.01);
            self.piece(Vector3::new(x, -1.6, 2.15), Vector3::new(0.16, 0.12, 0.0), 0.0, 0.0012);
            self.piece(Vector3::new(x + 0.65, -1.6, 2.17), Vector3::new(0.3, 0.4, 0.0), 0.05, 0.002);
        }
    }

    fn stairs(&mut self) {
        self.room([TILES, BRICK, PLASTER], 3.6, 2.4);
        for i in 0..8 {
            let up = 0.17 * f64::from(i);
            self.fixed(
                [
                    Vector3::new(-0.8, -0.5 * up - 0.08, 2.0 + 0.2 * f64::from(i)),
                    Vector3::new(0.8, 0.5 * up + 0.08, 0.1),
                ],
                TILES,
                0.006,
            );
        }
        self.fixed([Vector3::new(1.3, -1.05, 3.58), Vector3::new(0.45, 1.05, 0.02)], WOOD, 0.006);
        for (x, y) in [(0.4, -1.6), (1.3, -2.4), (-0.8, -2.2), (2.0, -1.4), (-1.7, -1.9), (0.4, -2.3)] {
            self.piece(Vector3::new(x, y, 3.57), Vector3::new(0.4, 0.4, 0.0), 0.1, 0.002);
        }
        for x in [0.5, 1.9] {
            self.piece(Vector3::new(x, -0.3, 3.0), Vector3::new(0.4, 0.6, 0.4), 0.2, 0.003);
        }
    }

    fn row(&mut self) {
        self.fixed([Vector3::zeros(), Vector3::new(30.0, 0.0, 12.0)], TILES, 0.006);
        for i in -2..=2 {
            let x = 3.2 * f64::from(i);
            self.fixed([Vector3::new(x, -2.2, 6.5), Vector3::new(1.4, 2.2, 1.0)], BRICK, 0.008);
            self.fixed([Vector3::new(x + 0.6, -1.0, 5.47), Vector3::new(0.45, 1.0, 0.03)], WOOD, 0.008);
            self.fixed([Vector3::new(x - 0.6, -1.5, 5.47), Vector3::new(0.5, 0.5, 0.03)], TILES, 0.02);
            self.piece(Vector3::new(x - 0.6, -1.5, 5.42), Vector3::new(0.8, 0.8, 0.0), 0.0, 0.004);
            self.piece(Vector3::new(x - 0.4, -0.5, 4.8), Vector3::new(0.6, 1.0, 0.5), 0.4, 0.004);
            self.piece(Vector3::new(x + 1.3, -0.4, 4.6), Vector3::new(0.8, 0.8, 0.4), 0.4, 0.004);
        }
    }

    /// The place itself has everything at one side, another at the other.
    fn mirrored(&mut self) {
        self.room([WOOD, PLASTER, PLASTER], 3.0, 2.6);
        self.fixed([Vector3::new(-1.5, -1.05, 2.98), Vector3::new(0.45, 1.05, 0.02)], WOOD, 0.006);
        self.fixed([Vector3::new(0.5, -1.6, 2.98), Vector3::new(0.5, 0.5, 0.02)], TILES, 0.01);
        for (x, y, z) in [(0.2, -0.4, 2.4), (1.3, -0.45, 2.3), (-0.6, -0.3, 2.5), (1.9, -0.9, 2.6)] {
            self.piece(Vector3::new(x, y, z), Vector3::new(0.6, 0.8, 0.4), 0.1, 0.003);
        }
        for (x, y) in [(-0.6, -1.6), (1.4, -1.7), (2.1, -1.5)] {
            self.piece(Vector3::new(x, y, 2.97), Vector3::new(0.5, 0.6, 0.0), 0.0, 0.002);
        }
        if self.version.place % 2 == 1 {
            for cuboid in &mut self.world.cuboids {
                let Se3 { rotation, translation } = cuboid.world_from_cuboid;
                let mirrored = Vector3::new(-translation.x, translation.y, translation.z);
                cuboid.world_from_cuboid = Se3::new(rotation.inverse(), mirrored);
            }
        }
    }

    fn hall(&mut self) {
        self.fixed([Vector3::zeros(), Vector3::new(30.0, 0.0, 12.0)], PLASTER, 0.006);
        self.fixed([Vector3::new(0.0, -3.0, 6.5), Vector3::new(9.0, 3.0, 0.0)], PLASTER, 0.006);
        for (board, column) in (0..3).flat_map(|board| (-3..=3).map(move |column| (board, column))) {
            let (x, y) = (1.4 * f64::from(column), -0.1 - 1.4 * f64::from(board));
            if board == 0 {
                self.fixed([Vector3::new(x - 0.7, -2.2, 5.0), Vector3::new(0.05, 2.2, 0.05)], WOOD, 0.006);
            }
            self.fixed([Vector3::new(x, y, 5.2), Vector3::new(0.7, 0.05, 0.5)], WOOD, 0.006);
            self.piece(Vector3::new(x, y - 0.55, 5.1), Vector3::new(1.0, 1.0, 0.8), 0.1, 0.006);
        }
    }
}

/// What a box wears for itself.
struct Wear {
    /// What its grain is drawn from, with the place.
    own: u64,
    /// Size of a texel, metres.
    texel: f64,
    /// Which part of its texture it shows, texels.
    offset: [f32; 2],
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Recording, render};

    const HERE: Version = Version { seed: 1, place: 0, share: 0.2, time: 0, moved: 0.0, grain: 0.0 };

    /// Share of the pixels that differ by more than eight grey levels.
    fn difference(kind: Kind, a: &Version, b: &Version) -> f64 {
        let pose = kind.path(0, 3)[1];
        let images = [a, b].map(|version| render(&kind.world(version), &Recording::SMALL_CAMERA, &pose).0);
        let pixels = images[0].data().iter().zip(images[1].data());
        pixels.clone().filter(|(a, b)| a.abs_diff(**b) > 8).count() as f64 / pixels.len() as f64
    }

    #[test]
    fn what_differs_is_what_was_asked_for() {
        for kind in [&Kind::TUNED[..], &Kind::HELD_OUT[..]].concat() {
            assert_eq!(difference(kind, &HERE, &HERE), 0.0);
            let differing = |share| difference(kind, &HERE, &Version { place: 4, share, ..HERE });
            let (some, all) = (differing(0.2), differing(1.0));
            println!("{kind:?}: {some:.3} {all:.3}");
            assert!(kind == Kind::Empty || some < all && all < 0.7, "{kind:?}: {some} {all}");
            let moved = difference(kind, &HERE, &Version { time: 1, moved: 0.2, ..HERE });
            assert!(moved < 0.3, "{kind:?}: {moved}");
            let grain = difference(kind, &HERE, &Version { grain: 3.0, ..HERE });
            assert!(grain < 0.2, "{kind:?}: {grain}");
        }
    }
}
