//! Buildings whose storeys hang together by stairs, and shafts.

use crate::lidar::Corners;
use crate::lidar_open::Draw;

/// A corridor a storey, and stairs with two flights between each two; the sensor is carried 1.3 m above the ground from one corridor up to
/// the highest one.
pub fn stairs(seed: u64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    const EYE: f64 = 1.3;
    const SLAB: f64 = 0.22;
    let mut of = Draw::new(seed ^ 0x57a1);
    let storeys = 3 + of.0.below(2) as usize;
    let steps = 8 + of.0.below(2) as usize;
    let (high, deep) = (of.between(0.16, 0.185), of.between(0.26, 0.3));
    let (stair_width, well, long) = (of.between(1.15, 1.4), of.between(0.15, 0.5), of.between(9.0, 14.0));
    let landing = of.between(1.2, 1.5);
    let wide = 2.0 * stair_width + well;
    let half = high * (steps + 1) as f64;
    let storey = 2.0 * half;
    let (rotation, end) = (landing + deep * steps as f64, 2.0 * landing + deep * steps as f64);
    let mut boxes = vec![[[-long, 0.0, 0.0], [end, wide, storey * storeys as f64 + 2.6]]];
    let door = 0.5 * wide - 0.5;
    for k in 0..=storeys {
        let floor = storey * k as f64;
        let ceiling = floor + storey - SLAB;
        // Between corridor and stairs a wall with a door.
        boxes.push([[-0.15, 0.0, floor], [0.0, door, ceiling]]);
        boxes.push([[-0.15, door + 1.0, floor], [0.0, wide, ceiling]]);
        boxes.push([[-0.15, door, floor + 2.05], [0.0, door + 1.0, ceiling]]);
        for _ in 0..5 {
            let x = of.between(-long + 0.5, -1.5);
            let out = of.between(0.08, 0.45);
            let y = if of.between(0.0, 1.0) < 0.5 { [0.0, out] } else { [wide - out, wide] };
            boxes.push([[x, y[0], floor], [x + of.between(0.2, 1.0), y[1], floor + of.between(0.7, 2.1)]]);
        }
        if k > 0 {
            boxes.push([[-long, 0.0, floor - SLAB], [0.0, wide, floor]]);
            boxes.push([[0.0, 0.0, floor - SLAB], [landing, wide, floor]]);
        }
        if k == storeys {
            continue;
        }
        boxes.push([[rotation, 0.0, floor + half - SLAB], [end, wide, floor + half]]);
        for step in 0..steps {
            let (rise, run) = (high * (step + 1) as f64, deep * step as f64);
            boxes.push([
                [landing + run, 0.0, floor + rise - 0.3],
                [landing + run + deep, stair_width, floor + rise],
            ]);
            let top = floor + half + rise;
            boxes.push([[rotation - run - deep, wide - stair_width, top - 0.3], [rotation - run, wide, top]]);
        }
    }
    let middle = [0.5 * stair_width, wide - 0.5 * stair_width];
    let (near, far) = (0.5 * landing, rotation + 0.5 * landing);
    let mut path = vec![[-long + 2.0, 0.5 * wide, EYE], [0.0, 0.5 * wide, EYE]];
    for k in 0..storeys {
        let floor = storey * k as f64 + EYE;
        path.extend([[near, middle[0], floor], [landing, middle[0], floor]]);
        path.extend([[rotation, middle[0], floor + half], [far, middle[0], floor + half]]);
        path.extend([[far, middle[1], floor + half], [rotation, middle[1], floor + half]]);
        path.extend([[landing, middle[1], floor + storey], [near, middle[1], floor + storey]]);
    }
    let top = storey * storeys as f64 + EYE;
    path.extend([[0.0, 0.5 * wide, top], [-long + 2.0, 0.5 * wide, top]]);
    (boxes, path)
}

/// A shaft with ledges and openings, up which a drone flies, looking around where it stops.
pub fn shaft(seed: u64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    let mut of = Draw::new(seed ^ 0x54af7);
    let (wide, long, high) = (of.between(2.2, 3.5), of.between(2.5, 4.0), of.between(12.0, 20.0));
    let mut boxes = vec![[[0.0, 0.0, 0.0], [long, wide, high]]];
    let mut z = 1.5;
    while z < high - 1.0 {
        let (out, tall) = (of.between(0.1, 0.5), of.between(0.1, 0.4));
        let (from, to) = (of.between(0.0, 0.5), of.between(0.6, 1.0));
        let ledge = match of.0.below(4) {
            0 => [[0.0, from * wide, z], [out, to * wide, z + tall]],
            1 => [[long - out, from * wide, z], [long, to * wide, z + tall]],
            2 => [[from * long, 0.0, z], [to * long, out, z + tall]],
            _ => [[from * long, wide - out, z], [to * long, wide, z + tall]],
        };
        boxes.push(ledge);
        z += of.between(0.6, 1.6);
    }
    // Around the middle as it rises: a drone looks where it goes.
    let corner = |k: usize| {
        let around = std::f64::consts::FRAC_PI_2 * k as f64;
        let z = 1.0 + (high - 2.5) * k as f64 / 8.0;
        [0.5 * long + 0.5 * around.cos(), 0.5 * wide + 0.5 * around.sin(), z]
    };
    (boxes, (0..=8).map(corner).collect())
}
