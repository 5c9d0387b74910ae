//! How places of each kind are built.

use super::Built;
use super::stuffs::{BRICK, CARPET, PAPER, PLASTER, TILES, WOOD};
use geometry::Se3;
use nalgebra::Vector3;

impl Built {
    pub(super) fn posters(&mut self) {
        let place = self.version.place as usize;
        self.room([[WOOD, TILES, CARPET][place / 4 % 3], place % 4, (place + 1) % 4], 2.8, 2.6);
        for x in [-1.1, 0.0, 1.1] {
            self.print(Vector3::new(x, -1.5, 2.78), Vector3::new(0.8, 1.0, 0.0), 0.003);
        }
        for x in [-1.7, 1.6] {
            self.piece(Vector3::new(x, -0.3, 2.3), Vector3::new(0.5, 0.6, 0.4), 0.3, 0.003);
        }
    }

    pub(super) fn facade(&mut self) {
        self.fixed([Vector3::zeros(), Vector3::new(30.0, 0.0, 12.0)], TILES, 0.006);
        self.fixed([Vector3::new(0.0, -3.0, 5.0), Vector3::new(9.0, 3.0, 0.0)], BRICK, 0.006);
        for (row, column) in (0..3).flat_map(|row| (-4..=4).map(move |column| (row, column))) {
            let (x, y) = (1.2 * f64::from(column), -1.0 - 1.5 * f64::from(row));
            self.fixed([Vector3::new(x, y, 4.96), Vector3::new(0.42, 0.55, 0.03)], TILES, 0.02);
            self.piece(Vector3::new(x, y, 4.92), Vector3::new(0.7, 0.95, 0.0), 0.0, 0.006);
        }
    }

    pub(super) fn aisle(&mut self) {
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

    pub(super) fn office(&mut self) {
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

    pub(super) fn lobby(&mut self) {
        self.room([TILES, PLASTER, WOOD], 3.2, 2.9);
        for x in [-1.6, 0.0, 1.6] {
            self.fixed([Vector3::new(x, -1.05, 3.18), Vector3::new(0.5, 1.05, 0.02)], WOOD, 0.01);
            self.fixed([Vector3::new(x, -1.05, 3.15), Vector3::new(0.02, 1.0, 0.01)], TILES, 0.01);
            self.piece(Vector3::new(x + 0.8, -1.5, 3.17), Vector3::new(0.35, 0.45, 0.0), 0.08, 0.002);
            self.piece(Vector3::new(x + 0.8, -0.35, 2.9), Vector3::new(0.4, 0.7, 0.3), 0.15, 0.003);
            self.piece(Vector3::new(x, -2.4, 3.17), Vector3::new(0.4, 0.35, 0.0), 0.0, 0.002);
        }
    }

    pub(super) fn hotel(&mut self) {
        self.room([CARPET, PLASTER, PLASTER], 2.2, 4.0);
        for i in -3..=3 {
            let x = 1.3 * f64::from(i);
            self.fixed([Vector3::new(x, -1.05, 2.18), Vector3::new(0.42, 1.05, 0.02)], WOOD, 0.005);
            self.fixed([Vector3::new(x + 0.32, -1.0, 2.14), Vector3::new(0.05, 0.02, 0.02)], TILES, 0.01);
            self.piece(Vector3::new(x, -1.6, 2.15), Vector3::new(0.16, 0.12, 0.0), 0.0, 0.0012);
            self.piece(Vector3::new(x + 0.65, -1.6, 2.17), Vector3::new(0.3, 0.4, 0.0), 0.05, 0.002);
        }
    }

    pub(super) fn stairs(&mut self) {
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

    pub(super) fn row(&mut self) {
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
    pub(super) fn mirrored(&mut self) {
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

    pub(super) fn hall(&mut self) {
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
    pub(super) fn papered(&mut self) {
        self.room([WOOD, PAPER, PAPER], 2.6, 2.4);
        self.fixed([Vector3::new(-1.4, -1.05, 2.58), Vector3::new(0.45, 1.05, 0.02)], WOOD, 0.005);
        self.fixed([Vector3::new(0.6, -0.85, 2.4), Vector3::new(0.5, 0.03, 0.2)], TILES, 0.01);
        self.piece(Vector3::new(0.6, -1.6, 2.58), Vector3::new(0.6, 0.8, 0.0), 0.0, 0.003);
        for x in [0.3, 0.6, 0.9] {
            self.piece(Vector3::new(x, -0.98, 2.4), Vector3::new(0.14, 0.22, 0.14), 0.05, 0.0015);
        }
        for (x, y) in [(-0.5, -1.5), (1.6, -1.6), (1.6, -1.0)] {
            self.piece(Vector3::new(x, y, 2.57), Vector3::new(0.3, 0.4, 0.0), 0.05, 0.002);
        }
        self.piece(Vector3::new(1.7, -0.3, 2.2), Vector3::new(0.4, 0.6, 0.4), 0.2, 0.003);
    }

    pub(super) fn arches(&mut self) {
        self.fixed([Vector3::zeros(), Vector3::new(30.0, 0.0, 12.0)], TILES, 0.006);
        self.fixed([Vector3::new(0.0, -2.0, 7.5), Vector3::new(14.0, 2.0, 0.0)], PLASTER, 0.006);
        self.fixed([Vector3::new(0.0, -4.2, 6.5), Vector3::new(14.0, 1.2, 0.9)], BRICK, 0.006);
        for i in -3..=3 {
            let x = 3.0 * f64::from(i);
            self.fixed([Vector3::new(x + 1.5, -1.6, 6.3), Vector3::new(0.5, 1.6, 0.8)], BRICK, 0.006);
            self.fixed([Vector3::new(x, -1.1, 7.4), Vector3::new(0.8, 1.1, 0.05)], WOOD, 0.006);
            self.piece(Vector3::new(x, -2.5, 7.4), Vector3::new(1.6, 0.5, 0.0), 0.1, 0.004);
            self.piece(Vector3::new(x + 0.3, -0.5, 6.9), Vector3::new(0.6, 1.0, 0.4), 0.4, 0.004);
        }
    }
}
