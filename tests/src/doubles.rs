//! Doubles: places that share what is made in numbers, the plan, posters, frames, goods, and differ in a share of their things,
//! each surface with a grain of its own or without; and the same places again after a share of their things has moved.

mod further_plans;
mod plans;
mod stuffs;

use crate::trajectory::look;
use crate::{Cuboid, Grain, Texture, World};
use geometry::{Random, Se3};
use nalgebra::{UnitQuaternion, Vector3};
use stuffs::{PICTURES, PLASTER, STUFFS, TILES};

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
    /// Rooms of one wallpaper, whose faint pattern looks like wear and repeats.
    Papered,
    /// Arches of a viaduct, each a workshop's front.
    Arches,
    /// A train's carriage, seen from its aisle: seats of one cloth, tables, and a station behind the windows.
    Carriage,
    /// A car park under ground: pillars, beams and bays to 10 m, in which cars of few makes stand.
    Garage,
    /// A lecture hall: rising rows of folding seats behind long desks, few things on them.
    Lectures,
    /// A library's stacks, seen from their ends: books on either side of the aisles between them.
    Library,
    /// A changing room: two rows of lockers close by, which little but their numbers tells from others.
    Lockers,
    /// A war cemetery: equal stones in rows on a lawn, each with an inscription.
    Graves,
    /// A tunnel of equal rings for cables on trays, seen along it to 14 m.
    Tunnel,
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

impl Version {
    /// The first place of a design as it was first seen, with this grain.
    pub const fn first(seed: u64, grain: f32) -> Self {
        Self { seed, place: 0, share: 0.0, time: 0, moved: 0.0, grain }
    }
}

impl Kind {
    /// The kinds that limits may be set on.
    pub const TUNED: [Self; 6] =
        [Self::Posters, Self::Facade, Self::Aisle, Self::Office, Self::Empty, Self::Hall];
    /// The kinds that are shown only.
    pub const HELD_OUT: [Self; 14] = [
        Self::Lobby,
        Self::Hotel,
        Self::Stairs,
        Self::Row,
        Self::Mirrored,
        Self::Papered,
        Self::Arches,
        Self::Carriage,
        Self::Garage,
        Self::Lectures,
        Self::Library,
        Self::Lockers,
        Self::Graves,
        Self::Tunnel,
    ];

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
            Self::Papered => built.papered(),
            Self::Arches => built.arches(),
            Self::Carriage => built.carriage(),
            Self::Garage => built.garage(),
            Self::Lectures => built.lectures(),
            Self::Library => built.library(),
            Self::Lockers => built.lockers(),
            Self::Graves => built.graves(),
            Self::Tunnel => built.tunnel(),
        }
        built.world
    }

    /// A way of `count` frames past a place, number `pass` of those past it: each from elsewhere, in either direction, and each
    /// past the middle.
    pub fn path(self, pass: u64, count: usize) -> Vec<Se3> {
        let mut random = Random::new(0xd0b1 + pass.wrapping_mul(7919));
        let mut uniform = |low, high| f64::from(random.uniform(low, high));
        let is_large = matches!(self, Self::Facade | Self::Row | Self::Hall | Self::Graves);
        let reach = if is_large { 1.6 } else { 1.0 };
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
