//! Sites in which a sensor does not see all of its motion: tunnels, alone and after a hall, and fields; and such as look alike
//! in which it does: corridors with ends, streets, halls.

use crate::lidar::Corners;
use crate::lidar_paths::{Carried, Carrier};
use crate::lidar_sensors::Sensor;
use crate::lidar_stairs;
use geometry::Random;

/// A sensor carried through a world.
#[derive(Clone, Debug)]
pub struct Drive {
    /// What it is called.
    pub name: String,
    /// The world, the outermost box first.
    pub boxes: Vec<Corners>,
    /// The sensor.
    pub sensor: Sensor,
    /// How it is carried.
    pub path: Carried,
}

impl Drive {
    /// Scans of the drive.
    pub fn scans(&self) -> usize {
        (self.path.duration() / crate::lidar::PERIOD) as usize
    }
}

/// Numbers drawn for a site.
pub(crate) struct Draw(pub Random);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(Random::new(seed.wrapping_mul(0x1000_0001).wrapping_add(0x0b5c)))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }
}

/// A tunnel's walls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walls {
    /// Nothing stands out.
    Smooth,
    /// Ribs at even distances.
    Ribbed,
    /// Niches, boxes and signs at distances that are drawn.
    Furnished,
}

/// A tunnel of a length between two portals, `hall` metres of hall before it and as many after it where that is more than 0. The sensor is
/// at height 0, a metre above the floor, and drives from the middle of the first hall to that of the second.
pub fn tunnel(seed: u64, length: f64, walls: Walls, hall: f64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    let mut of = Draw::new(seed);
    let (half, top) = (of.between(1.8, 3.5), of.between(2.0, 4.0));
    let wide = if hall > 0.0 { hall * 0.6 } else { half };
    // Alone it goes on beyond what is driven, farther than sensors see.
    let (begin, end) = if hall > 0.0 { (-hall, length + hall) } else { (-150.0, length + 150.0) };
    let mut boxes = vec![[[begin, -wide, -1.0], [end, wide, top]]];
    if hall > 0.0 {
        boxes.push([[0.0, half, -1.0], [length, wide, top]]);
        boxes.push([[0.0, -wide, -1.0], [length, -half, top]]);
        for (from, to) in [(-hall, -1.0), (length + 1.0, length + hall)] {
            for _ in 0..7 {
                let (x, side) = (of.between(from, to - 1.0), of.between(0.0, 1.0) < 0.5);
                let y = of.between(1.6, wide - 0.8) * if side { 1.0 } else { -1.0 };
                let size = [of.between(0.3, 1.0), of.between(0.3, 0.8), of.between(0.5, 2.8)];
                boxes.push([[x, y, -1.0], [x + size[0], y + size[1], -1.0 + size[2]]]);
            }
        }
    }
    let mut x = if hall > 0.0 { 1.5 } else { begin + 1.0 };
    while walls != Walls::Smooth && x < if hall > 0.0 { length - 1.0 } else { end - 1.0 } {
        match walls {
            Walls::Ribbed => {
                boxes.push([[x, half - 0.15, -1.0], [x + 0.3, half, top]]);
                boxes.push([[x, -half, -1.0], [x + 0.3, -half + 0.15, top]]);
                x += 5.0;
            }
            _ => {
                let (deep, long, low) = (of.between(0.15, 0.5), of.between(0.3, 1.5), of.between(-1.0, 1.0));
                let y = if of.between(0.0, 1.0) < 0.5 { [half - deep, half] } else { [-half, -half + deep] };
                boxes.push([[x, y[0], low], [x + long, y[1], low + of.between(0.4, 1.0)]]);
                x += of.between(1.5, 5.0);
            }
        }
    }
    let reach = 0.5 * hall;
    (boxes, vec![[-reach, 0.0, 0.0], [length + reach, 0.0, 0.0]])
}

/// A field with things on it within `radius` metres of the begin: `things` of them. A way of 40 m with a bend.
pub fn field(seed: u64, things: usize, radius: f64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    let mut of = Draw::new(seed ^ 0xf1e1d);
    let mut boxes = vec![[[-500.0, -500.0, -1.2], [500.0, 500.0, 400.0]]];
    while boxes.len() <= things {
        let [x, y] = [of.between(-radius, radius), of.between(-radius, radius)];
        let size = [of.between(0.3, 3.0), of.between(0.3, 3.0), of.between(1.0, 6.0)];
        if y.abs() > 3.0 && (x - 25.0).abs() > 3.0 {
            boxes.push([[x, y, -1.2], [x + size[0], y + size[1], -1.2 + size[2]]]);
        }
    }
    (boxes, vec![[0.0; 3], [25.0, 0.0, 0.0], [25.0, 15.0, 0.0]])
}

/// A corridor with ends, smooth between doors.
pub fn corridor(seed: u64, length: f64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    let mut of = Draw::new(seed ^ 0xc0441);
    let (half, top) = (of.between(0.9, 1.5), of.between(1.4, 2.0));
    let mut boxes = vec![[[0.0, -half, -1.0], [length, half, top]]];
    let mut x = of.between(1.0, 4.0);
    while x < length - 2.0 {
        let wall = if of.between(0.0, 1.0) < 0.5 { [half - 0.08, half] } else { [-half, -half + 0.08] };
        boxes.push([[x, wall[0], -1.0], [x + 0.1, wall[1], 1.1]]);
        boxes.push([[x + 1.0, wall[0], -1.0], [x + 1.1, wall[1], 1.1]]);
        x += of.between(2.5, 5.0);
    }
    (boxes, vec![[1.5, 0.0, 0.0], [length - 1.5, 0.0, 0.0]])
}

/// A street between houses, with cars and poles along it.
pub fn street(seed: u64, length: f64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    let mut of = Draw::new(seed ^ 0x57ee7);
    let mut boxes = vec![[[-300.0, -300.0, -1.7], [length + 300.0, 300.0, 300.0]]];
    for side in [-1.0, 1.0] {
        let mut x = -40.0;
        while x < length + 40.0 {
            let (wide, back) = (of.between(7.0, 16.0), of.between(7.0, 10.0));
            let y = if side > 0.0 { [back, back + 12.0] } else { [-back - 12.0, -back] };
            boxes.push([[x, y[0], -1.7], [x + wide, y[1], of.between(4.0, 14.0)]]);
            x += wide + of.between(0.0, 5.0);
        }
        let mut x = -30.0;
        while x < length + 30.0 {
            let near = of.between(3.5, 4.5);
            let (long, tall) = (of.between(3.6, 4.8), of.between(-0.3, 0.2));
            let y = if side > 0.0 { [near, near + 1.8] } else { [-near - 1.8, -near] };
            boxes.push([[x, y[0], -1.5], [x + long, y[1], tall]]);
            boxes.push([[x + long + 1.0, y[0], -1.7], [x + long + 1.15, y[0] + 0.15, 4.0]]);
            x += of.between(7.0, 15.0);
        }
    }
    (boxes, vec![[0.0; 3], [length, 0.0, 0.0]])
}

/// A ring of two halls, a smooth tunnel and a furnished way back: the sensor comes to where it began.
pub fn tunnel_in_a_ring(seed: u64, length: f64) -> (Vec<Corners>, Vec<[f64; 3]>) {
    let (mut boxes, _) = tunnel(seed, length, Walls::Smooth, 14.0);
    let [least, most] = boxes[0];
    let (half, wide, back) = (boxes[1][0][1], most[1], most[1] + 16.0);
    boxes[0] = [least, [most[0], back, most[2]]];
    // The tunnel's northern side is as thick as to leave a way of 4 m along the northern wall.
    boxes[1] = [[0.0, half, -1.0], [length, back - 4.0, most[2]]];
    let mut of = Draw::new(seed ^ 0x417);
    let mut x = 2.0;
    while x < length - 2.0 {
        let (deep, long) = (of.between(0.2, 0.9), of.between(0.4, 1.6));
        let y =
            if of.between(0.0, 1.0) < 0.5 { [back - deep, back] } else { [back - 4.0, back - 4.0 + deep] };
        boxes.push([[x, y[0], -1.0], [x + long, y[1], of.between(-0.4, most[2])]]);
        x += of.between(1.5, 4.0);
    }
    for (x, y) in
        [(-13.0, wide + 3.0), (-12.0, wide + 9.0), (length + 9.0, wide + 4.0), (length + 11.0, wide + 10.0)]
    {
        boxes
            .push([[x, y, -1.0], [x + of.between(0.5, 1.5), y + of.between(0.5, 2.0), of.between(0.0, 2.0)]]);
    }
    let lane = back - 2.0;
    let path = vec![
        [-7.0, 0.0, 0.0],
        [length + 7.0, 0.0, 0.0],
        [length + 7.0, lane, 0.0],
        [-7.0, lane, 0.0],
        [-7.0, 0.0, 0.0],
        [-4.0, 0.0, 0.0],
    ];
    (boxes, path)
}

/// Drives of every kind: lot 0 is there to set limits on, lot 1 to measure by.
pub fn drives(lot: u64) -> Vec<Drive> {
    let mut all = Vec::new();
    let mut add = |name: String, site: (Vec<Corners>, Vec<[f64; 3]>), sensor, pace, carrier| {
        all.push(Drive { name, boxes: site.0, sensor, path: Carried::along(&site.1, pace, carrier) });
    };
    let seed = 100 * (lot + 1);
    use Carrier::{BackPack, Drone, Hand, Wheels};
    use Sensor::{Avia, Mid360, Os0, Vlp16};
    for (k, length) in [30.0, 86.0, 140.0, 200.0].into_iter().enumerate() {
        let length = length + 7.0 * lot as f64;
        let sensor = if k == 1 { Os0 } else { Vlp16 };
        add(
            format!("tunnel {length}, hall before"),
            tunnel(seed + k as u64, length, Walls::Smooth, 14.0),
            sensor,
            1.5,
            Wheels,
        );
    }
    add("tunnel 60 m driven, alone".into(), tunnel(seed + 4, 60.0, Walls::Smooth, 0.0), Vlp16, 1.5, Wheels);
    add("tunnel 40 m walked, alone".into(), tunnel(seed + 5, 40.0, Walls::Smooth, 0.0), Mid360, 1.2, Hand);
    add(
        "tunnel 80 m, hall before, by hand".into(),
        tunnel(seed + 6, 80.0, Walls::Smooth, 12.0),
        Mid360,
        1.2,
        Hand,
    );
    add(
        "tunnel 90 m, hall before, drone".into(),
        tunnel(seed + 7, 90.0, Walls::Smooth, 12.0),
        Os0,
        2.5,
        Drone,
    );
    add("field, bare".into(), field(seed + 8, 0, 0.0), Vlp16, 1.5, Wheels);
    add("field, bare, by hand".into(), field(seed + 9, 0, 0.0), Mid360, 1.2, Hand);
    add("field, things at its begin".into(), field(seed + 10, 8, 12.0), Os0, 1.5, Wheels);
    add("tunnel in a ring, 86 m".into(), tunnel_in_a_ring(seed + 11, 86.0), Vlp16, 1.5, Wheels);
    add("tunnel in a ring, 60 m".into(), tunnel_in_a_ring(seed + 12, 60.0), Os0, 1.5, Wheels);
    // Determined.
    add("tunnel 60 m, furnished".into(), tunnel(seed + 20, 60.0, Walls::Furnished, 0.0), Vlp16, 1.5, Wheels);
    add("tunnel 60 m, ribbed".into(), tunnel(seed + 21, 60.0, Walls::Ribbed, 0.0), Vlp16, 1.5, Wheels);
    add(
        "tunnel 50 m, furnished, hall before".into(),
        tunnel(seed + 22, 50.0, Walls::Furnished, 14.0),
        Os0,
        1.5,
        Hand,
    );
    add("field with things".into(), field(seed + 23, 25, 40.0), Vlp16, 1.5, Wheels);
    add("field with things, by hand".into(), field(seed + 24, 40, 40.0), Mid360, 1.2, Hand);
    for (k, sensor) in [Vlp16, Os0, Mid360, Vlp16, Os0, Mid360].into_iter().enumerate() {
        let carrier = if k < 3 { Wheels } else { Hand };
        let length = 15.0 + 5.0 * k as f64;
        add(format!("corridor {length} m"), corridor(seed + 30 + k as u64, length), sensor, 1.3, carrier);
    }
    for (k, sensor) in [Vlp16, Os0, Mid360, Avia].into_iter().enumerate() {
        let carrier = if k < 2 { Wheels } else { BackPack };
        add(
            "street".into(),
            street(seed + 40 + k as u64, 60.0),
            sensor,
            if k < 2 { 6.0 } else { 1.5 },
            carrier,
        );
    }
    for (k, sensor) in [Vlp16, Os0, Mid360, Avia].into_iter().enumerate() {
        let site = crate::lidar_sites::hall(seed + 50 + k as u64);
        let corners = site.paths[0].iter().map(|c| [c[0], c[1], 0.0]).collect();
        add("hall".into(), (site.boxes, corners), sensor, 1.4, if k < 2 { Wheels } else { Hand });
    }
    for (k, sensor) in [Vlp16, Os0, Mid360].into_iter().enumerate() {
        let site = crate::lidar_sites::office(seed + 60 + k as u64, seed);
        let corners = site.paths[1].iter().map(|c| [c[0], c[1], 0.0]).collect();
        add("office".into(), (site.boxes, corners), sensor, 1.2, Hand);
    }
    for k in 0..5u64 {
        for sensor in [Vlp16, Os0, Mid360] {
            let carrier = [Hand, BackPack, Hand, Wheels, Drone][k as usize];
            let (name, site) = if carrier == Drone {
                ("shaft", lidar_stairs::shaft(seed + k))
            } else {
                ("stairs", lidar_stairs::stairs(seed + k))
            };
            add(format!("{name} {k}"), site, sensor, 0.9, carrier);
        }
    }
    all
}

/// Drives that come back to where they were, in halls, offices and warehouses, and there and back through tunnels and corridors; lots as of
/// [`drives`].
pub fn returns(lot: u64) -> Vec<Drive> {
    use crate::lidar_sites::{Site, hall, office, warehouse};
    use Carrier::{Hand, Wheels};
    use Sensor::{Mid360, Os0, Vlp16};
    let seed = 1000 * (lot + 1);
    let mut all = Vec::new();
    let mut add = |name: String, boxes, path: &[[f64; 3]], sensor, pace, carrier| {
        all.push(Drive { name, boxes, sensor, path: Carried::along(path, pace, carrier) });
    };
    // A step aside, so that the turn takes time.
    let there_and_back = |path: &[[f64; 3]]| -> Vec<[f64; 3]> {
        let [before, end] = [path[path.len() - 2], path[path.len() - 1]];
        let along = [end[0] - before[0], end[1] - before[1]];
        let aside = 0.9 / along[0].hypot(along[1]);
        let beside = [end[0] - aside * along[1], end[1] + aside * along[0], end[2]];
        path.iter().chain([&beside]).chain(path.iter().rev().skip(1)).copied().collect()
    };
    let kinds: [(&str, Walls, f64, f64); 4] = [
        ("smooth tunnel, there and back", Walls::Smooth, 60.0, 14.0),
        ("ribbed tunnel, there and back", Walls::Ribbed, 40.0, 0.0),
        ("furnished tunnel, there and back", Walls::Furnished, 40.0, 0.0),
        ("furnished tunnel and halls, there and back", Walls::Furnished, 30.0, 14.0),
    ];
    for (k, (name, walls, length, halls)) in kinds.into_iter().enumerate() {
        let (boxes, path) = tunnel(seed + k as u64, length, walls, halls);
        let sensor = [Os0, Vlp16, Mid360, Vlp16][(k + lot as usize) % 4];
        add(name.into(), boxes, &there_and_back(&path), sensor, 1.5, Wheels);
    }
    for (k, sensor) in [Vlp16, Os0, Mid360].into_iter().enumerate() {
        let (boxes, path) = corridor(seed + 10 + k as u64, 24.0);
        add("corridor 24 m, there and back".into(), boxes, &there_and_back(&path), sensor, 1.3, Hand);
    }
    type Built = fn(u64, u64) -> Site;
    let sites: [(&str, Built); 3] =
        [("hall twice", |plan, _| hall(plan)), ("office twice", office), ("warehouse twice", warehouse)];
    for (k, (name, site)) in sites.into_iter().enumerate() {
        for (l, sensor) in [Vlp16, Os0, Mid360].into_iter().enumerate() {
            let site = site(seed + 20 + k as u64, seed + l as u64);
            let path: Vec<[f64; 3]> = site.paths[0].iter().map(|c| [c[0], c[1], 0.0]).collect();
            add(
                name.into(),
                site.boxes,
                &there_and_back(&path),
                sensor,
                1.4,
                if l < 2 { Wheels } else { Hand },
            );
        }
    }
    all
}
