//! Places with cars.

use super::{Draw, Drawn, FLOOR};
use crate::lidar::Corners;
use crate::lidar_sites::Site;

/// A car whose front looks along y, by its middle: a body and a cabin.
fn car(thing: &mut Draw, [x, y]: [f64; 2], is_along_x: bool) -> [Corners; 2] {
    let (length, wide) = (thing.between(3.7, 4.8), thing.between(1.65, 1.9));
    let (bonnet, roof) = (thing.between(0.75, 1.0), thing.between(1.35, 1.75));
    let (front, back) = (thing.between(0.8, 1.3), thing.between(0.1, 0.9));
    let part = |along: [f64; 2], wide: f64, heights: [f64; 2]| {
        let (low, high) = ([along[0], -0.5 * wide], [along[1], 0.5 * wide]);
        let order = |v: [f64; 2]| if is_along_x { v } else { [v[1], v[0]] };
        let (low, high) = (order(low), order(high));
        [[x + low[0], y + low[1], FLOOR + heights[0]], [x + high[0], y + high[1], FLOOR + heights[1]]]
    };
    let half = 0.5 * length;
    [
        part([-half, half], wide, [0.25, bonnet]),
        part([-half + front, half - back], wide - 0.25, [bonnet, roof]),
    ]
}

/// A storey of a car park, 41 × 32 m: columns, beams below the ceiling; cars in six tenths of the bays.
pub(super) fn car_park(of: &mut Draw, things: &mut Drawn) -> Site {
    let (half, ceiling) = ([of.between(19.0, 21.0), 16.0], of.between(1.3, 1.6));
    let mut boxes = vec![[[-half[0], -half[1], FLOOR], [half[0], half[1], ceiling]]];
    let pitch = of.between(7.4, 8.0);
    for k in -2..=2 {
        let x = f64::from(k) * pitch;
        for y in [-10.8, 0.0, 10.8] {
            boxes.push([[x - 0.2, y - 0.3, FLOOR], [x + 0.2, y + 0.3, ceiling]]);
        }
        boxes.push([[x - 0.2, -half[1], ceiling - 0.3], [x + 0.2, half[1], ceiling]]);
        // Three bays between two columns, on both sides of two lanes.
        for (bay, y) in (0..3).flat_map(|bay| [-13.3, -2.7, 2.7, 13.3].map(|y| (bay, y))) {
            let mut thing = things.thing();
            let at = [
                x + 0.5 * pitch + 2.4 * f64::from(bay - 1) + thing.between(-0.2, 0.2),
                y + thing.between(-0.3, 0.3),
            ];
            if thing.chance(0.6) && at[0] < half[0] - 1.2 {
                boxes.extend(car(&mut thing, at, false));
            }
        }
    }
    let (end, lane) = (half[0] - 2.0, 8.0);
    let paths = vec![vec![[-end, lane], [end - 2.0, lane]], vec![[end - 4.0, lane], [-end + 1.0, lane]]];
    Site { boxes, paths }
}

/// A street of 60 m with houses on both sides that are built alike; cars, bins, hedges and sheds are things.
pub(super) fn houses(of: &mut Draw, things: &mut Drawn) -> Site {
    let (wide, set_back) = (of.between(6.0, 7.5), of.between(8.0, 9.5));
    let (eaves, porch) = (of.between(4.5, 5.5), of.between(0.8, 1.4));
    // What the sensor does not reach is sky.
    let mut boxes = vec![[[-300.0, -300.0, FLOOR], [300.0, 300.0, 300.0]]];
    for number in 0..(60.0 / wide) as usize {
        let x = wide * number as f64;
        for side in [-1.0, 1.0] {
            let place = |from: f64, to: f64, near: f64, far: f64, top: f64| {
                let (near, far) = (side * near, side * far);
                [[x + from, near.min(far), FLOOR], [x + to, near.max(far), FLOOR + top]]
            };
            boxes.push(place(0.0, wide, set_back, set_back + 8.0, eaves + 1.0));
            boxes.push(place(0.8, 2.4, set_back - porch, set_back, 2.4));
            boxes.push(place(3.4, 5.2, set_back - 0.4, set_back, 2.6));
            boxes.push(place(0.0, 0.15, 5.2, set_back, 0.9));
            let mut hedge = things.thing();
            if hedge.chance(0.5) {
                let (from, tall) = (hedge.between(0.3, 1.5), hedge.between(0.6, 1.8));
                boxes.push(place(
                    from,
                    from + hedge.between(1.0, 3.5),
                    5.0,
                    5.0 + hedge.between(0.4, 0.8),
                    tall,
                ));
            }
            let mut bin = things.thing();
            if bin.chance(0.6) {
                let at = bin.between(2.5, wide - 0.8);
                boxes.push(place(at, at + bin.between(0.5, 0.7), 6.2, 6.9, bin.between(0.9, 1.2)));
            }
            let mut shed = things.thing();
            if shed.chance(0.2) {
                boxes.push(place(4.2, 5.8, 6.9, 7.0 + shed.between(0.3, 0.6), shed.between(1.2, 2.0)));
            }
            let mut parked = things.thing();
            if parked.chance(0.5) {
                let at =
                    [x + 0.5 * wide + parked.between(-0.6, 0.6), side * (3.6 + parked.between(-0.15, 0.15))];
                boxes.extend(car(&mut parked, at, true));
            }
        }
    }
    let paths = vec![vec![[8.0, -0.8], [44.0, -0.8]], vec![[50.0, 0.8], [14.0, 0.8]]];
    Site { boxes, paths }
}
