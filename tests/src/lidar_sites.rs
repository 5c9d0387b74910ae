//! Sites for a spinning LiDAR that repeat themselves: aisles, corridors and halls on a floor plan, and what stands about
//! in them, each drawn from a number of its own. Two sites of one plan are two floors of a building: alike, and not the same.

use crate::lidar::Corners;
use geometry::Random;

/// A site, and ways through it.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    /// What there is, the outermost box first; the sensor is at height 0, a metre above the floor.
    pub boxes: Vec<Corners>,
    /// Corners of ways for [`walk`](crate::lidar::walk), which hit nothing.
    pub paths: Vec<Vec<[f64; 2]>>,
}

/// Height of the floor, metres.
const FLOOR: f64 = -1.0;

impl Site {
    /// The site as a mirror shows it.
    pub fn mirrored(&self) -> Self {
        let flip = |&[least, most]: &Corners| [[least[0], -most[1], least[2]], [most[0], -least[1], most[2]]];
        let path = |path: &Vec<[f64; 2]>| path.iter().map(|&[x, y]| [x, -y]).collect();
        Self { boxes: self.boxes.iter().map(flip).collect(), paths: self.paths.iter().map(path).collect() }
    }
}

/// Numbers of a plan or of what stands about.
struct Draw(Random);

impl Draw {
    fn new(seed: u64) -> Self {
        Self(Random::new(seed.wrapping_mul(0x1000_0001).wrapping_add(77)))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        f64::from(self.0.uniform(low as f32, high as f32))
    }

    fn chance(&mut self, share: f64) -> bool {
        self.between(0.0, 1.0) < share
    }
}

/// A warehouse with four rows of racks that are built alike, in aisles of one width; pallets stand in seven of ten places,
/// and some things along the walls.
pub fn warehouse(plan: u64, stock: u64) -> Site {
    const BAY: f64 = 2.7;
    const DEPTH: f64 = 1.1;
    let mut of = Draw::new(plan);
    let (pitch, bays) = (of.between(4.6, 5.6), 6 + (of.between(0.0, 2.99) as usize));
    let (half, high) = (0.5 * BAY * bays as f64, of.between(5.0, 7.5));
    let walls = [half + of.between(3.5, 5.5), 2.0 * pitch + of.between(2.0, 4.0)];
    let mut lies = Draw::new(stock ^ 0x5eed);
    let mut boxes = vec![[[-walls[0], -walls[1], FLOOR], [walls[0], walls[1], high]]];
    for row in 0..4 {
        let y = (f64::from(row) - 1.5) * pitch;
        let (near, far) = (y - 0.5 * DEPTH, y + 0.5 * DEPTH);
        for shelf in [0.5, 2.0] {
            boxes.push([[-half, near, shelf - 0.1], [half, far, shelf]]);
        }
        for bay in 0..=bays {
            let x = -half + BAY * bay as f64;
            boxes.push([[x - 0.05, near, FLOOR], [x + 0.05, far, 3.2]]);
            for level in [FLOOR, 0.5, 2.0] {
                for place in 0..2 {
                    if bay < bays && lies.chance(0.7) {
                        let (width, tall) = (lies.between(0.7, 1.15), lies.between(0.4, 1.3));
                        let left = x + 0.1 + 1.25 * f64::from(place) + lies.between(0.0, 0.1);
                        let back = lies.between(0.0, 0.3);
                        boxes.push([[left, near + back, level], [left + width, far - back, level + tall]]);
                    }
                }
            }
        }
    }
    for _ in 0..8 {
        let (x, side) = (lies.between(-walls[0] + 1.0, walls[0] - 2.5), lies.chance(0.5));
        let [deep, wide, tall] =
            [lies.between(0.4, 1.0), lies.between(0.5, 1.5), FLOOR + lies.between(0.5, 2.5)];
        let (least, most) = if side { (walls[1] - deep, walls[1]) } else { (-walls[1], -walls[1] + deep) };
        boxes.push([[x, least, FLOOR], [x + wide, most, tall]]);
    }
    let end = half + 1.6;
    let paths = vec![
        vec![[-end, -pitch], [end, -pitch], [end, 0.0], [-2.0, 0.0]],
        vec![[end, pitch], [-end, pitch], [-end, 0.0], [2.0, 0.0]],
    ];
    Site { boxes, paths }
}

/// A floor of six blocks of rooms with corridors between them; door frames stand at even distances, cabinets here and there
/// along the walls.
pub fn office(plan: u64, stock: u64) -> Site {
    const WIDE: f64 = 2.2;
    let mut of = Draw::new(plan ^ 0x0ff1ce);
    let (block, ceiling) = ([of.between(9.0, 13.0), of.between(6.5, 9.0)], of.between(1.5, 2.2));
    let door = of.between(2.2, 3.4);
    let pitch = [block[0] + WIDE, block[1] + WIDE];
    let shell = [1.5 * block[0] + 2.0 * WIDE, block[1] + 1.5 * WIDE];
    let mut lies = Draw::new(stock ^ 0xcab);
    let mut boxes = vec![[[-shell[0], -shell[1], FLOOR], [shell[0], shell[1], ceiling]]];
    for (column, row) in (-1..=1).flat_map(|column| [-0.5, 0.5].map(|row| (f64::from(column), row))) {
        let centre = [column * pitch[0], row * pitch[1]];
        let [west, east] = [centre[0] - 0.5 * block[0], centre[0] + 0.5 * block[0]];
        let [south, north] = [centre[1] - 0.5 * block[1], centre[1] + 0.5 * block[1]];
        boxes.push([[west, south, FLOOR], [east, north, ceiling]]);
        for wall in [south, north] {
            let out = if wall == south { -1.0 } else { 1.0 };
            let mut along = |x: f64, wide: f64, deep: f64, top: f64| {
                let reach = wall + out * deep;
                boxes.push([[x, wall.min(reach), FLOOR], [x + wide, wall.max(reach), top]]);
            };
            let mut x = west + 0.8;
            while x + 1.2 < east {
                along(x, 0.15, 0.12, ceiling);
                along(x + 1.0, 0.15, 0.12, ceiling);
                if lies.chance(0.4) {
                    let (deep, top) = (lies.between(0.25, 0.5), lies.between(-0.4, 1.0));
                    along(x + 1.25, lies.between(0.5, 0.9), deep, top);
                }
                x += door;
            }
        }
    }
    let (x, y) = (0.5 * pitch[0], pitch[1]);
    let paths = vec![
        vec![[-x - 0.8 * block[0], 0.0], [x, 0.0], [x, y], [0.0, y]],
        vec![[x, -y], [-x, -y], [-x, 0.0], [x + 0.4 * block[0], 0.0]],
    ];
    Site { boxes, paths }
}

/// A hall with things that stand about anywhere but on its ways.
pub fn hall(seed: u64) -> Site {
    let mut of = Draw::new(seed ^ 0x4a11);
    let walls = [of.between(14.0, 22.0), of.between(9.0, 14.0), of.between(3.0, 7.0)];
    let (x, y) = (walls[0] - 4.0, walls[1] - 3.5);
    let paths = vec![vec![[-x, y], [x, y], [x, -y]], vec![[x, -y], [-x, -y], [-x, 0.5 * y]]];
    let mut boxes = vec![[[-walls[0], -walls[1], FLOOR], [walls[0], walls[1], walls[2]]]];
    // Ways run along a rectangle: what lies within or without stays clear of it.
    const CLEAR: f64 = 1.0;
    while boxes.len() < 18 {
        let size = [of.between(0.4, 4.0), of.between(0.4, 2.5), of.between(0.6, walls[2] - FLOOR)];
        let low = [0, 1].map(|i| of.between(-walls[i], walls[i] - size[i]));
        let high = [0, 1].map(|i| low[i] + size[i]);
        let within = high[0] < x - CLEAR && low[0] > CLEAR - x && high[1] < y - CLEAR && low[1] > CLEAR - y;
        let without =
            low[0] > x + CLEAR || high[0] < -x - CLEAR || low[1] > y + CLEAR || high[1] < -y - CLEAR;
        if within || without {
            boxes.push([[low[0], low[1], FLOOR], [high[0], high[1], FLOOR + size[2]]]);
        }
    }
    Site { boxes, paths }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lidar::walk;

    /// How near a way comes to anything, metres.
    fn clearance(site: &Site, path: &[[f64; 2]]) -> f64 {
        let (pose, duration) = walk(path);
        let mut least = f64::INFINITY;
        for step in 0..=(10.0 * duration) as usize {
            let at = pose(0.1 * step as f64).translation;
            for (i, [low, high]) in site.boxes.iter().enumerate() {
                let outside = |axis: usize| (low[axis] - at[axis]).max(at[axis] - high[axis]);
                // Above the sensor's head and below its feet nothing is in its way.
                let apart = if i == 0 { -outside(0).max(outside(1)) } else { outside(0).max(outside(1)) };
                if i == 0 || (low[2] < 0.3 && high[2] > -1.0) {
                    least = least.min(apart);
                }
            }
        }
        least
    }

    #[test]
    fn paths_hit_nothing_and_sites_are_what_their_numbers_say() {
        for seed in 0..30 {
            for site in [warehouse(seed, seed), office(seed, seed), hall(seed)] {
                for site in [site.mirrored(), site] {
                    for path in &site.paths {
                        assert!(clearance(&site, path) > 0.4, "{seed}: {path:?}");
                    }
                }
            }
        }
        assert_eq!(warehouse(1, 2), warehouse(1, 2));
        assert_eq!(office(1, 2).boxes[0], office(1, 3).boxes[0], "one plan");
        assert_ne!(office(1, 2), office(1, 3));
        assert_eq!(hall(3).mirrored().mirrored(), hall(3));
    }
}
