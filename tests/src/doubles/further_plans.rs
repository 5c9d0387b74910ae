//! How places of further kinds are built, on none of which any limit was set.

use super::stuffs::{
    BOOKS, BRICK, CLOTH, CONCRETE, DARK, LAWN, LETTERS, PICTURES, PLASTER, STEEL, STUFFS, TILES, WHITE, WOOD,
};
use super::{Built, Wear};
use crate::Texture;
use nalgebra::Vector3;

/// Tones of cars.
const PAINTS: [usize; 4] = [WHITE, PLASTER, STEEL, DARK];

impl Built {
    /// A box of a stuff from one corner to the opposite one, which all places have.
    fn block(
        &mut self,
        [x0, x1]: [f64; 2],
        [y0, y1]: [f64; 2],
        [z0, z1]: [f64; 2],
        stuff: usize,
        texel: f64,
    ) {
        let centre = 0.5 * Vector3::new(x0 + x1, y0 + y1, z0 + z1);
        let half = 0.5 * Vector3::new(x1 - x0, y1 - y0, z1 - z0);
        self.fixed([centre, half], stuff, texel);
    }

    /// A print that hangs in all places alike.
    pub(super) fn print(&mut self, centre: Vector3<f64>, size: Vector3<f64>, texel: f64) {
        let share = std::mem::replace(&mut self.version.share, 0.0);
        self.piece(centre, size, 0.0, texel);
        self.version.share = share;
    }

    /// A thing of exactly this size that is mounted straight, and wears another part of one of these.
    fn mounted(&mut self, centre: Vector3<f64>, size: Vector3<f64>, textures: &[Texture], texel: f64) {
        let mut random = self.thing();
        let texture = &textures[random.index(textures.len())];
        let offset = [0, 1].map(|_| 32.0 * random.index(32) as f32);
        let own = random.bits();
        self.add([centre, 0.5 * size], 0.0, texture, Wear { own, texel, offset });
    }

    /// Letters or numbers that differ, on a plate of this width and height.
    fn lettered(&mut self, centre: Vector3<f64>, [width, height]: [f64; 2], texel: f64) {
        self.mounted(centre, Vector3::new(width, height, 0.0), &STUFFS[LETTERS..=LETTERS], texel);
    }

    pub(super) fn carriage(&mut self) {
        self.block([-9.0, 9.0], [0.0, 0.0], [-2.0, 1.6], STEEL, 0.004);
        self.block([-9.0, 9.0], [-0.85, 0.0], [1.5, 1.6], PLASTER, 0.004);
        self.block([-9.0, 9.0], [-2.5, -1.75], [1.5, 1.6], PLASTER, 0.004);
        self.block([-9.0, 9.0], [-2.5, -2.4], [-2.0, 1.6], PLASTER, 0.004);
        self.block([-9.0, 9.0], [-1.95, -1.92], [1.15, 1.5], STEEL, 0.004);
        for bay in -2..=2 {
            let x = 1.9 * f64::from(bay);
            self.bay(x);
            self.piece(Vector3::new(x + 0.3, -2.1, 1.3), Vector3::new(0.6, 0.3, 0.3), 0.3, 0.002);
            self.piece(Vector3::new(x - 0.1, -0.86, 1.2), Vector3::new(0.25, 0.25, 0.2), 0.2, 0.0015);
            self.piece(Vector3::new(x + 0.55, -0.65, 1.1), Vector3::new(0.35, 0.5, 0.3), 0.1, 0.002);
            self.piece(Vector3::new(x - 0.93, -1.45, 1.46), Vector3::new(0.18, 0.7, 0.04), 0.03, 0.002);
        }
        self.station();
    }

    /// Two benches that face each other, a table between them, and the window's posts.
    fn bay(&mut self, x: f64) {
        self.block([x - 1.05, x - 0.8], [-1.75, -0.85], [1.5, 1.58], STEEL, 0.004);
        self.block([x - 1.02, x - 0.88], [-1.25, 0.0], [0.55, 1.45], CLOTH, 0.0015);
        for side in [-1.0, 1.0] {
            let ends = [x + 0.45 * side - 0.28, x + 0.45 * side + 0.28];
            self.block(ends, [-0.45, -0.3], [0.55, 1.45], CLOTH, 0.0015);
            for z in [0.57, 1.02] {
                let back = x + 0.95 * side;
                self.block([back - 0.1, back + 0.1], [-1.32, -1.12], [z + 0.06, z + 0.36], PLASTER, 0.002);
            }
        }
        self.block([x - 0.25, x + 0.25], [-0.74, -0.71], [0.9, 1.5], WOOD, 0.003);
        self.print(Vector3::new(x, -1.85, 1.49), Vector3::new(0.7, 0.14, 0.0), 0.0012);
        self.print(Vector3::new(x - 0.93, -1.0, 1.49), Vector3::new(0.16, 0.2, 0.0), 0.0012);
    }

    /// What is behind a carriage's windows: a platform with columns, and the station's wall.
    fn station(&mut self) {
        self.block([-14.0, 14.0], [0.0, 0.1], [2.0, 6.0], STEEL, 0.006);
        self.block([-14.0, 14.0], [-4.0, 0.0], [6.0, 6.1], TILES, 0.003);
        for i in -3..=3 {
            let x = 2.8 * f64::from(i);
            self.block([x + 0.9, x + 1.2], [-4.0, 0.0], [4.0, 4.3], STEEL, 0.004);
            self.piece(Vector3::new(x, -1.5, 5.98), Vector3::new(1.6, 1.2, 0.0), 0.1, 0.003);
            self.piece(Vector3::new(x + 0.4, -0.6, 4.8), Vector3::new(0.6, 1.2, 0.4), 0.4, 0.003);
        }
    }

    pub(super) fn garage(&mut self) {
        self.block([-14.0, 14.0], [0.0, 0.0], [-4.0, 10.0], STEEL, 0.006);
        self.block([-14.0, 14.0], [-2.7, -2.7], [-4.0, 10.0], CONCRETE, 0.006);
        self.block([-14.0, 14.0], [-2.7, 0.0], [10.0, 10.1], CONCRETE, 0.006);
        self.block([-14.0, 14.0], [-2.35, -2.25], [2.9, 3.2], STEEL, 0.004);
        for z in [4.0, 9.3] {
            self.block([-14.0, 14.0], [-2.7, -2.4], [z - 0.15, z + 0.15], PLASTER, 0.006);
        }
        for i in -2..=2 {
            let x = 5.0 * f64::from(i) + 2.3;
            for z in [4.0, 9.3] {
                self.pillar(x, z);
            }
            self.block([x - 2.7, x - 1.7], [-2.55, -2.5], [2.0, 2.12], TILES, 0.01);
            self.block([x - 2.7, x - 1.7], [-2.55, -2.5], [6.5, 6.62], TILES, 0.01);
            self.piece(Vector3::new(x - 2.2, -1.6, 9.98), Vector3::new(0.9, 0.6, 0.0), 0.3, 0.003);
        }
        for i in -3..=3 {
            let x = 2.5 * f64::from(i);
            self.block([x + 1.15, x + 1.25], [-0.005, 0.0], [4.2, 8.8], TILES, 0.006);
            self.car(x, 6.4);
        }
    }

    /// A pillar with a dark band and a number.
    fn pillar(&mut self, x: f64, z: f64) {
        self.block([x - 0.2, x + 0.2], [-2.7, 0.0], [z - 0.2, z + 0.2], CONCRETE, 0.006);
        self.block([x - 0.21, x + 0.21], [-0.7, -0.1], [z - 0.21, z + 0.21], DARK, 0.006);
        self.block([x - 0.212, x + 0.212], [-0.5, -0.3], [z - 0.212, z + 0.212], TILES, 0.01);
        self.lettered(Vector3::new(x, -1.7, z - 0.205), [0.26, 0.26], 0.008);
    }

    /// A car of one of four makes and paints, or an empty bay.
    fn car(&mut self, x: f64, z: f64) {
        let mut random = self.thing();
        let paint = PAINTS[random.index(PAINTS.len())];
        let [wide, low, high] =
            [[0.84, 0.85, 1.45], [0.9, 0.8, 1.4], [0.92, 0.95, 1.7], [0.8, 0.75, 1.5]][random.index(4)];
        let (x, z) = (x + f64::from(random.uniform(-0.15, 0.15)), z + f64::from(random.uniform(-0.3, 0.3)));
        let is_empty = random.unit() < 0.2;
        let (own, offset) = (random.bits(), [0, 1].map(|_| random.uniform(0.0, 1024.0)));
        if is_empty {
            return;
        }
        let mut part = |[x0, x1]: [f64; 2], [y0, y1]: [f64; 2], [z0, z1]: [f64; 2], texture: &Texture| {
            let centre = Vector3::new(x + 0.5 * (x0 + x1), -0.5 * (y0 + y1), z + 0.5 * (z0 + z1));
            let half = 0.5 * Vector3::new(x1 - x0, y1 - y0, z1 - z0);
            self.add([centre, half], 0.0, texture, Wear { own, texel: 0.002, offset });
        };
        part([-wide, wide], [0.25, low], [-2.1, 2.1], &STUFFS[paint]);
        part([-wide + 0.1, wide - 0.1], [low, high], [-1.3, 1.3], &STUFFS[DARK]);
        part([-wide + 0.08, wide - 0.08], [high, high + 0.05], [-1.1, 1.1], &STUFFS[paint]);
        for side in [-1.0, 1.0] {
            let ends = |a: f64, b: f64| if side < 0.0 { [-b, -a] } else { [a, b] };
            part(ends(wide - 0.35, wide - 0.05), [0.6, 0.72], [-2.13, -2.1], &STUFFS[WHITE]);
            part(ends(wide - 0.25, wide - 0.02), [0.0, 0.6], [-1.8, -1.2], &STUFFS[DARK]);
        }
        part([-0.45, 0.45], [0.55, 0.66], [-2.12, -2.1], &STUFFS[DARK]);
        part([-0.26, 0.26], [0.38, 0.5], [-2.13, -2.1], &STUFFS[LETTERS]);
    }

    pub(super) fn lectures(&mut self) {
        self.block([-6.0, 6.0], [0.0, 0.0], [-4.0, 2.0], WOOD, 0.004);
        self.block([-6.0, 6.0], [-4.6, -4.6], [-4.0, 8.0], PLASTER, 0.006);
        self.block([-6.0, 6.0], [-4.6, 0.0], [8.0, 8.1], PLASTER, 0.006);
        for x in [-4.6, 4.6] {
            self.block([x - 0.05, x + 0.05], [-4.6, 0.0], [-4.0, 8.0], CONCRETE, 0.006);
            self.block([0.75 * x - 0.45, 0.75 * x + 0.45], [-3.8, -1.7], [7.95, 8.0], WOOD, 0.006);
        }
        for tier in 0..6 {
            let (z, ground) = (2.2 + 0.95 * f64::from(tier), -0.28 * f64::from(tier));
            self.tier(z, ground);
            for i in 0..4 {
                let x = -2.7 + 1.8 * f64::from(i) + 0.3 * f64::from(tier % 3);
                self.piece(Vector3::new(x, ground - 0.92, z + 0.2), Vector3::new(0.3, 0.3, 0.2), 0.25, 0.002);
            }
        }
        for x in [-1.6, 0.0, 1.6] {
            self.piece(Vector3::new(x, -3.2, 7.98), Vector3::new(0.8, 0.7, 0.0), 0.1, 0.003);
        }
    }

    /// A step, a desk along it, and the backs and seats of eleven chairs.
    fn tier(&mut self, z: f64, ground: f64) {
        self.block([-4.6, 4.6], [ground, 0.3], [z - 0.1, z + 1.0], PLASTER, 0.006);
        self.block([-3.6, 3.6], [ground - 0.72, ground - 0.12], [z, z + 0.03], WOOD, 0.004);
        self.block([-3.6, 3.6], [ground - 0.77, ground - 0.72], [z - 0.03, z + 0.35], PLASTER, 0.004);
        for seat in -5..=5 {
            let x = 0.62 * f64::from(seat);
            let (left, right) = (x - 0.24, x + 0.24);
            self.block([left, right], [ground - 0.98, ground - 0.5], [z + 0.7, z + 0.74], WOOD, 0.003);
            self.block([left, right], [ground - 0.85, ground - 0.45], [z + 0.62, z + 0.66], STEEL, 0.003);
        }
    }

    pub(super) fn library(&mut self) {
        self.room([WOOD, PLASTER, PLASTER], 6.2, 4.0);
        self.block([-1.2, 1.2], [-2.3, -1.0], [6.1, 6.2], TILES, 0.02);
        for stack in -2..=2 {
            let x = 1.3 * f64::from(stack);
            self.block([x - 0.02, x + 0.02], [-2.2, 0.0], [1.65, 5.4], STEEL, 0.004);
            self.block([x - 0.27, x + 0.27], [-2.25, 0.0], [1.6, 1.64], WOOD, 0.004);
            self.block([x - 0.1, x + 0.1], [-1.75, -1.5], [1.57, 1.6], TILES, 0.004);
            self.lettered(Vector3::new(x, -1.62, 1.56), [0.17, 0.2], 0.0015);
            self.piece(Vector3::new(x + 0.65, -0.2, 3.6), Vector3::new(0.4, 0.4, 0.4), 0.15, 0.002);
            for board in 0..6 {
                let y = -0.1 - 0.36 * f64::from(board);
                self.block([x - 0.25, x + 0.25], [y, y + 0.025], [1.64, 5.4], STEEL, 0.004);
                self.books(x, y);
            }
        }
    }

    /// Books on a board, on the sides of a stack that a camera before the middle sees.
    fn books(&mut self, x: f64, y: f64) {
        for side in [-1.0, 1.0].into_iter().filter(|side| x * side < 0.5) {
            for section in 0..3 {
                let centre = Vector3::new(x + 0.13 * side, y - 0.13, 2.28 + 1.25 * f64::from(section));
                self.mounted(centre, Vector3::new(0.2, 0.26, 1.1), &STUFFS[BOOKS..=BOOKS], 0.002);
            }
        }
    }

    pub(super) fn lockers(&mut self) {
        self.room([TILES, TILES, TILES], 1.9, 4.5);
        self.block([-4.0, 4.0], [-2.0, 0.0], [1.35, 1.9], DARK, 0.004);
        for column in -9..=9 {
            let x = 0.32 * f64::from(column);
            for top in [-1.98, -1.02] {
                self.door(x, top);
            }
            if column % 3 == 0 {
                self.piece(Vector3::new(x - 0.02, -0.6, 1.3), Vector3::new(0.12, 0.12, 0.0), 0.06, 0.001);
                self.piece(Vector3::new(x - 0.34, -1.3, 1.3), Vector3::new(0.12, 0.16, 0.0), 0.06, 0.001);
                self.piece(Vector3::new(x, -2.15, 1.6), Vector3::new(0.45, 0.3, 0.3), 0.15, 0.002);
            }
        }
        for x in [-1.5, 1.5] {
            self.print(Vector3::new(x, -2.5, 1.89), Vector3::new(0.7, 0.4, 0.0), 0.002);
        }
    }

    /// A locker's door: slots for air, a knob, a number.
    fn door(&mut self, x: f64, top: f64) {
        self.block([x - 0.15, x + 0.15], [top, top + 0.93], [1.32, 1.35], STEEL, 0.004);
        for slot in 0..3 {
            let y = top + 0.1 + 0.05 * f64::from(slot);
            self.block([x - 0.08, x + 0.08], [y, y + 0.015], [1.318, 1.32], DARK, 0.004);
        }
        self.block([x + 0.09, x + 0.13], [top + 0.48, top + 0.54], [1.28, 1.32], TILES, 0.01);
        self.lettered(Vector3::new(x, top + 0.32, 1.317), [0.09, 0.05], 0.0015);
    }

    pub(super) fn graves(&mut self) {
        self.block([-30.0, 30.0], [0.0, 0.0], [-6.0, 20.0], LAWN, 0.006);
        self.block([-16.0, 16.0], [-1.3, 0.0], [10.5, 10.9], BRICK, 0.006);
        self.block([-16.0, 16.0], [-1.4, -1.3], [10.45, 10.95], PLASTER, 0.006);
        self.block([-0.9, 0.9], [-0.4, 0.0], [9.3, 10.3], PLASTER, 0.006);
        self.block([-0.2, 0.2], [-4.4, -0.4], [9.6, 10.0], PLASTER, 0.006);
        self.block([-0.9, 0.9], [-3.6, -3.2], [9.6, 10.0], PLASTER, 0.006);
        for (row, column) in (0..4).flat_map(|row| (-6..=6).map(move |column| (row, column))) {
            let (x, z) = (1.05 * f64::from(column), 3.2 + 1.7 * f64::from(row));
            self.block([x - 0.2, x + 0.2], [-0.85, 0.0], [z, z + 0.08], TILES, 0.05);
            self.lettered(Vector3::new(x, -0.52, z - 0.002), [0.28, 0.42], 0.0015);
            if (row + column) % 3 == 0 {
                self.piece(Vector3::new(x, -0.15, z - 0.25), Vector3::new(0.35, 0.3, 0.25), 0.1, 0.002);
            }
        }
        for i in -3..=3 {
            let x = 3.7 * f64::from(i);
            self.piece(Vector3::new(x, -2.5, 13.0), Vector3::new(2.6, 5.0, 2.0), 0.8, 0.008);
        }
    }

    pub(super) fn tunnel(&mut self) {
        self.block([-3.0, 3.0], [0.0, 0.0], [-4.0, 14.0], PLASTER, 0.006);
        self.block([-1.7, 1.7], [-2.6, 0.0], [14.0, 14.1], STEEL, 0.006);
        self.block([-0.6, 0.6], [-2.1, 0.0], [13.9, 14.0], DARK, 0.006);
        for ring in 0..11 {
            self.ring(1.5 * f64::from(ring) - 1.5);
        }
        for (side, y) in [-1.0, 1.0].into_iter().flat_map(|side| [-0.7, -1.2, -1.7].map(|y| (side, y))) {
            let ends = |a: f64, b: f64| if side < 0.0 { [-b, -a] } else { [a, b] };
            self.block(ends(1.32, 1.6), [y - 0.02, y], [-3.0, 14.0], STEEL, 0.004);
            for (i, stuff) in [DARK, DARK, TILES, STEEL].into_iter().enumerate() {
                let x = 1.36 + 0.06 * i as f64;
                self.block(ends(x, x + 0.045), [y - 0.065, y - 0.02], [-3.0, 14.0], stuff, 0.004);
            }
        }
        for i in 0..8 {
            let (side, z) = ([-1.0, 1.0][i % 2], 1.9 + 1.4 * i as f64);
            let cabinet = Vector3::new(1.5 * side, -2.1, z);
            self.mounted(cabinet, Vector3::new(0.16, 0.3, 0.4), &PICTURES[..], 0.0015);
            self.piece(Vector3::new(1.2 * side, -0.2, z + 0.7), Vector3::new(0.4, 0.4, 0.4), 0.1, 0.002);
        }
        for z in [3.7, 8.2] {
            self.piece(Vector3::new(0.5, -2.3, z), Vector3::new(0.5, 0.25, 0.02), 0.0, 0.002);
        }
    }

    /// A ring of a tunnel: its walls and its ceiling, a rib where it ends, posts of the trays, a lamp in every other one.
    fn ring(&mut self, z: f64) {
        let length = [z, z + 1.5];
        self.block([-1.7, 1.7], [-2.7, -2.6], length, CONCRETE, 0.004);
        for x in [-1.65, 1.65] {
            self.block([x - 0.05, x + 0.05], [-2.6, 0.0], length, CONCRETE, 0.004);
            self.block([x - 0.09, x + 0.09], [-2.6, 0.0], [z, z + 0.06], STEEL, 0.004);
            self.block([x - 0.1, x + 0.1], [-1.8, -0.5], [z + 0.75, z + 0.79], STEEL, 0.004);
        }
        self.block([-1.6, 1.6], [-2.6, -2.54], [z, z + 0.06], STEEL, 0.004);
        self.block([-0.06, 0.06], [-2.6, -2.52], [z + 0.4, z + 1.1], TILES, 0.01);
    }
}
