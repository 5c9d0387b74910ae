//! Places with a roof.

use super::{Draw, Drawn, FLOOR};
use crate::lidar::Corners;
use crate::lidar_sites::Site;

/// A box on the floor by its middle, width, depth and height.
fn standing(middle: [f64; 2], size: [f64; 3]) -> Corners {
    on(FLOOR, middle, size)
}

/// A box at a height.
fn on(level: f64, [x, y]: [f64; 2], [wide, deep, tall]: [f64; 3]) -> Corners {
    [[x - 0.5 * wide, y - 0.5 * deep, level], [x + 0.5 * wide, y + 0.5 * deep, level + tall]]
}

/// 26 × 15 m with two rows of columns and partitions; islands of desks on either side of two ways.
pub(super) fn office(of: &mut Draw, things: &mut Drawn) -> Site {
    let (half, ceiling) = ([of.between(12.0, 14.0), of.between(7.0, 7.6)], of.between(1.5, 2.0));
    let mut boxes = vec![[[-half[0], -half[1], FLOOR], [half[0], half[1], ceiling]]];
    // Ways cross from one aisle to the other before the ends: the outermost columns and the rows between the aisles stay clear of that.
    let cross = half[0] - 1.2;
    let pitch = 0.5 * (cross - 0.7) * of.between(0.9, 1.0);
    for k in -2..=2 {
        let x = f64::from(k) * pitch;
        boxes.extend([-2.4, 2.4].map(|y| standing([x, y], [0.4, 0.4, ceiling - FLOOR])));
        // Window pillars, and a partition here and there.
        boxes
            .extend([-half[1] + 0.15, half[1] - 0.15].map(|y| standing([x, y], [0.5, 0.3, ceiling - FLOOR])));
        if of.chance(0.4) {
            boxes.push(standing([x + 0.5 * pitch, 0.0], [0.1, 2.0, 1.5]));
        }
    }
    // Rows of desks stay clear of the ways at y = ±3.7; a thing reaches 1.2 m to either side of its place.
    for (row, reach) in [(-5.8, half[0] - 1.6), (-1.6, cross - 1.6), (1.6, cross - 1.6), (5.8, half[0] - 1.6)]
    {
        let mut x = -reach;
        while x < reach {
            let mut thing = things.thing();
            let (at, y) = (x + thing.between(-0.25, 0.25), row + thing.between(-0.25, 0.25));
            let deep = thing.between(0.7, 0.9);
            if thing.chance(0.6) {
                let (wide, top) = (thing.between(1.2, 1.8), thing.between(0.68, 0.8));
                boxes.push(on(FLOOR + top - 0.05, [at, y], [wide, deep, 0.05]));
                boxes.push(on(FLOOR, [at + 0.4 * wide, y], [0.4, deep, top - 0.05]));
                let screen = [thing.between(0.5, 0.7), 0.06, thing.between(0.35, 0.5)];
                boxes.push(on(FLOOR + top, [at + thing.between(-0.3, 0.3), y], screen));
                let chair = [at + thing.between(-0.5, 0.3), y + thing.between(-0.3, 0.3)];
                boxes.push(standing(chair, [0.5, 0.5, 0.5]));
                boxes.push(standing([chair[0], chair[1] + 0.2], [0.5, 0.08, thing.between(0.8, 1.1)]));
            } else if thing.chance(0.7) {
                let tall = [0.8, 1.2, 1.9][(thing.between(0.0, 2.99)) as usize];
                boxes.push(standing([at, y], [thing.between(0.8, 1.6), thing.between(0.4, 0.5), tall]));
            }
            x += 2.2;
        }
    }
    let end = cross;
    let paths = vec![
        vec![[-end, 3.7], [end, 3.7], [end, -3.7], [0.0, -3.7]],
        vec![[end, 3.7], [-end, 3.7], [-end, -3.7], [2.0, -3.7]],
    ];
    Site { boxes, paths }
}

/// A corridor with doors at even distances on both sides and cabinets along its walls, up to four in 40 m; ways of 34 m from `begin`.
pub(super) fn corridor(of: &mut Draw, things: &mut Drawn, length: f64, begin: f64) -> Site {
    let (half, ceiling) = (of.between(1.1, 1.4), of.between(1.5, 1.9));
    let mut boxes = vec![[[0.0, -half, FLOOR], [length, half, ceiling]]];
    let (pitch, deep) = (of.between(3.6, 5.2), 0.1);
    let mut x = 0.5 * pitch;
    while x + 1.2 < length {
        for side in [-1.0, 1.0] {
            let y = side * (half - 0.5 * deep);
            boxes.push(standing([x, y], [0.12, deep, ceiling - FLOOR]));
            boxes.push(standing([x + 1.0, y], [0.12, deep, ceiling - FLOOR]));
        }
        x += pitch;
    }
    for slot in 0..(length / 10.0) as usize {
        let mut thing = things.thing();
        if thing.chance(0.5) {
            let (deep, side) = (thing.between(0.3, 0.5), if thing.chance(0.5) { 1.0 } else { -1.0 });
            let size = [thing.between(0.6, 1.4), deep, thing.between(0.7, 2.0)];
            let x = 10.0 * slot as f64 + thing.between(1.0, 9.0);
            boxes.push(standing([x, side * (half - 0.5 * deep)], size));
        }
    }
    let paths =
        vec![vec![[begin + 3.0, 0.1], [begin + 37.0, 0.1]], vec![[begin + 37.0, -0.1], [begin + 3.0, -0.1]]];
    Site { boxes, paths }
}

/// A hall with three rows of racks; a pallet stands in `share` of the places.
pub(super) fn racks(of: &mut Draw, things: &mut Drawn, share: f64) -> Site {
    const BAY: f64 = 2.7;
    const DEEP: f64 = 1.1;
    let (pitch, bays) = (of.between(4.4, 5.2), 6 + of.between(0.0, 2.99) as usize);
    let half = 0.5 * BAY * bays as f64;
    let walls = [half + of.between(3.0, 4.0), 1.5 * pitch + of.between(2.0, 3.0)];
    let mut boxes = vec![[[-walls[0], -walls[1], FLOOR], [walls[0], walls[1], of.between(4.5, 6.0)]]];
    for row in -1..=1 {
        let y = f64::from(row) * pitch;
        boxes.extend([0.5, 2.0].map(|shelf| on(shelf - 0.1, [0.0, y], [2.0 * half, DEEP, 0.1])));
        for bay in 0..=bays {
            let x = BAY * bay as f64 - half;
            boxes.push(standing([x, y], [0.1, DEEP, 4.2]));
            for (level, place) in
                [FLOOR, 0.5, 2.0].into_iter().flat_map(|level| [(level, 0.7), (level, 1.95)])
            {
                let mut thing = things.thing();
                if bay < bays && thing.chance(share) {
                    let size =
                        [thing.between(0.7, 1.15), DEEP - thing.between(0.0, 0.4), thing.between(0.4, 1.25)];
                    let at = [x + place + thing.between(-0.05, 0.05), y + thing.between(-0.1, 0.1)];
                    boxes.push(on(level, at, size));
                }
            }
        }
    }
    let (end, y) = (half + 1.5, 0.5 * pitch);
    let paths = vec![
        vec![[-end, -y], [end, -y], [end, y], [0.0, y]],
        vec![[end, -y], [-end, -y], [-end, y], [2.0, y]],
    ];
    Site { boxes, paths }
}

/// A hotel's corridor of 36 m: doors in niches on both sides, lamps between them; things stand along the walls.
pub(super) fn hotel(of: &mut Draw, things: &mut Drawn) -> Site {
    let (half, ceiling, length) = (of.between(1.0, 1.2), of.between(1.3, 1.6), 36.0);
    let mut boxes = vec![[[0.0, -half - 0.35, FLOOR], [length, half + 0.35, ceiling]]];
    let pitch = of.between(3.5, 4.3);
    let mut x = 0.0;
    while x < length {
        // Between the niches the wall stands out.
        let wide = f64::min(pitch - 1.3, length - x);
        boxes
            .extend([-1.0, 1.0].map(|side| {
                standing([x + 0.5 * wide, side * (half + 0.175)], [wide, 0.35, ceiling - FLOOR])
            }));
        boxes.extend(
            [-1.0, 1.0].map(|side| on(0.6, [x + 0.5 * wide, side * (half - 0.06)], [0.2, 0.12, 0.3])),
        );
        for side in [-1.0, 1.0] {
            let mut thing = things.thing();
            if thing.chance(0.45) {
                let kinds = [[1.0, 0.45, 1.1], [0.8, 0.35, 0.8], [0.35, 0.35, 1.3], [0.5, 0.45, 0.9]];
                let [w, d, h] = kinds[thing.between(0.0, 3.99) as usize];
                let [w, d, h] = [w, d, h].map(|v: f64| v * thing.between(0.85, 1.15));
                let at = x + 0.3 + 0.5 * w + thing.between(0.0, f64::max(wide - w - 0.3, 0.01));
                boxes.push(standing([at, side * (half - 0.5 * d)], [w, d, h]));
            }
        }
        x += pitch;
    }
    let paths = vec![vec![[2.0, 0.05], [34.0, 0.05]], vec![[34.0, -0.05], [2.0, -0.05]]];
    Site { boxes, paths }
}

/// A storey of a stairwell, 7 × 3.4 m: flights up and down, doors, a lift; people leave things there.
pub(super) fn stairwell(of: &mut Draw, things: &mut Drawn) -> Site {
    let (half, ceiling) = ([of.between(4.4, 5.0), of.between(2.3, 2.6)], of.between(1.5, 1.8));
    let mut boxes = vec![[[-half[0], -half[1], FLOOR], [half[0], half[1], ceiling]]];
    // The flight up rises along the northern wall; what is below the one above hangs from the ceiling.
    for step in 0..9 {
        let x = half[0] - 2.6 + 0.28 * f64::from(step);
        boxes.push([[x, half[1] - 1.2, FLOOR], [x + 0.28, half[1], FLOOR + 0.18 * f64::from(step + 1)]]);
        boxes
            .push([[-x - 0.28, half[1] - 1.2, ceiling - 0.17 * f64::from(step + 1)], [-x, half[1], ceiling]]);
    }
    for (x, wide) in [(-2.6, 1.0), (0.0, 1.1), (2.4, 1.0)] {
        boxes.extend([-0.5, 0.5].map(|end| standing([x + end * wide, -half[1] + 0.06], [0.1, 0.12, 2.1])));
    }
    boxes.push(on(FLOOR + 0.9, [0.3, half[1] - 1.25], [2.0 * half[0] - 6.0, 0.06, 0.06]));
    let places = [[-1.3, -1.0], [1.25, -1.0], [3.6, -1.0], [-3.9, -1.0], [-0.8, 1.0], [0.6, 1.0]];
    for [x, side] in places {
        let mut thing = things.thing();
        if thing.chance(0.6) {
            let kinds = [[1.1, 0.35, 0.9], [0.6, 0.5, 1.0], [0.4, 0.4, 1.3], [0.7, 0.4, 0.4]];
            let [w, d, h] = kinds[thing.between(0.0, 3.99) as usize];
            let [w, d, h] = [w, d, h].map(|v: f64| v * thing.between(0.8, 1.2));
            let at = [x + thing.between(-0.2, 0.2), side * (half[1] - 0.5 * d - 0.02)];
            boxes.push(standing(at, [w, d, h]));
        }
    }
    let end = half[0] - 1.3;
    let paths = vec![vec![[-end, 0.0], [end, 0.2], [0.5, 0.3]], vec![[end, 0.0], [-end, 0.1], [0.0, 0.3]]];
    Site { boxes, paths }
}

/// An aisle of a shop, 18 m between shelves of metre-wide bays; every facing holds goods of its own.
pub(super) fn aisle(of: &mut Draw, things: &mut Drawn) -> Site {
    let (half, length, ceiling) = (of.between(1.0, 1.3), 18.0, of.between(2.2, 3.0));
    let deep = of.between(0.45, 0.6);
    let mut boxes = vec![[[-3.0, -half - 4.0, FLOOR], [length + 3.0, half + 4.0, ceiling]]];
    let boards = [0.15, 0.55, 0.95, 1.35, 1.75];
    for side in [-1.0, 1.0] {
        let y = side * (half + 0.5 * deep);
        boxes.push(standing([0.5 * length, side * (half + deep + 0.02)], [length, 0.04, 2.0]));
        boxes.extend(boards.map(|board| on(FLOOR + board - 0.03, [0.5 * length, y], [length, deep, 0.03])));
        for bay in 0..=length as usize {
            boxes.push(standing([bay as f64, y], [0.04, deep, 2.0]));
            for board in boards.into_iter().filter(|_| bay < length as usize) {
                for place in 0..3 {
                    let mut thing = things.thing();
                    if thing.chance(0.9) {
                        let (back, wide) = (thing.between(0.0, 0.3), thing.between(0.2, 0.31));
                        let at = [bay as f64 + 0.19 + 0.315 * f64::from(place), y + side * 0.5 * back];
                        let size = [wide, deep - back, thing.between(0.12, 0.34)];
                        boxes.push(on(FLOOR + board, at, size));
                    }
                }
            }
        }
    }
    let paths = vec![vec![[-1.5, 0.1], [length + 1.5, 0.1]], vec![[length + 1.0, -0.1], [-1.0, -0.1]]];
    Site { boxes, paths }
}
