//! Places for a spinning LiDAR that are built alike, what stands about in them drawn apart: doubles share the plan and nothing
//! else, and the same place seen again has a share of its things moved.
//!
//! A plan is drawn from one number and has what is built in: walls, doors, columns, racks, kerbs. [`Things`] are drawn from
//! another. The sensor is at height 0, a metre above the floor; metres.

mod indoors;
mod outdoors;

use crate::lidar_sites::Site;
use geometry::Random;

/// Height of the floor, metres.
const FLOOR: f64 = -1.0;

/// What stands about in a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Things {
    /// The number that they are drawn from.
    pub seed: u64,
    /// The share of them that was drawn again since, 0–1.
    pub moved: f64,
    /// The number from which those were drawn.
    pub since: u64,
}

impl Things {
    /// Those of a number, none of them moved.
    pub fn new(seed: u64) -> Self {
        Self { seed, moved: 0.0, since: 0 }
    }

    /// The same with a share of them moved.
    pub fn moved(self, share: f64, since: u64) -> Self {
        Self { moved: share, since, ..self }
    }
}

/// Kinds of places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A floor of desks between columns and partitions; all furniture is things.
    Office,
    /// A corridor of 40 m with doors at even distances and up to four cabinets.
    Corridor,
    /// Two stretches of one corridor of 160 m; which one, the number of the things says.
    LongCorridor,
    /// A hall with racks; pallets are things.
    Racks,
    /// A hall with racks, which are empty where the number of the things is odd.
    EmptyRacks,
    /// A hotel's corridor: doors in niches; carts, tables and plants are things.
    Hotel,
    /// A storey of a car park: columns and beams; cars are things.
    CarPark,
    /// A storey of a stairwell: flights and doors; what people leave there is things.
    Stairwell,
    /// An aisle of a shop: shelves are built in, goods are things.
    Aisle,
    /// A street of houses that are built alike: cars, bins, hedges and sheds are things.
    Houses,
}

impl Kind {
    /// All of them; limits may be looked at on the first five, the others are held out.
    pub const ALL: [Self; 10] = [
        Self::Office,
        Self::Corridor,
        Self::LongCorridor,
        Self::Racks,
        Self::EmptyRacks,
        Self::Hotel,
        Self::CarPark,
        Self::Stairwell,
        Self::Aisle,
        Self::Houses,
    ];

    /// Whether it is held out: nothing may be set by what is seen on it.
    pub fn is_held_out(self) -> bool {
        matches!(self, Self::Hotel | Self::CarPark | Self::Stairwell | Self::Aisle | Self::Houses)
    }

    /// Its name, for files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Office => "office floors",
            Self::Corridor => "corridors of 40 m",
            Self::LongCorridor => "stretches of a corridor of 160 m",
            Self::Racks => "rack halls, other goods",
            Self::EmptyRacks => "rack halls, empty and full",
            Self::Hotel => "hotel corridors",
            Self::CarPark => "car parks",
            Self::Stairwell => "stairwells",
            Self::Aisle => "shop aisles",
            Self::Houses => "rows of houses",
        }
    }

    /// A place of this kind: its plan drawn from a number, its things from others.
    pub fn site(self, plan: u64, things: Things) -> Site {
        let mut draw = Drawn { things, next: 0 };
        let mut of = Draw::new(plan.wrapping_mul(31).wrapping_add(self as u64));
        match self {
            Self::Office => indoors::office(&mut of, &mut draw),
            Self::Corridor => indoors::corridor(&mut of, &mut draw, 40.0, 0.0),
            Self::LongCorridor => {
                // The stretches hold the same corridor; a way begins in one or in the other.
                let begin = 56.0 * (things.seed % 2) as f64;
                let mut all = Drawn { things: Things { seed: plan, ..things }, next: 0 };
                indoors::corridor(&mut of, &mut all, 160.0, begin)
            }
            Self::Racks => indoors::racks(&mut of, &mut draw, 0.7),
            Self::EmptyRacks => {
                let share = if things.seed % 2 == 1 { 0.0 } else { 0.7 };
                indoors::racks(&mut of, &mut draw, share)
            }
            Self::Hotel => indoors::hotel(&mut of, &mut draw),
            Self::CarPark => outdoors::car_park(&mut of, &mut draw),
            Self::Stairwell => indoors::stairwell(&mut of, &mut draw),
            Self::Aisle => indoors::aisle(&mut of, &mut draw),
            Self::Houses => outdoors::houses(&mut of, &mut draw),
        }
    }
}

/// Numbers.
struct Draw(Random);

impl Draw {
    fn new(seed: u64) -> Self {
        Self(Random::new(seed.wrapping_mul(0x1000_0001).wrapping_add(0xd0b1e)))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        f64::from(self.0.uniform(low as f32, high as f32))
    }

    fn chance(&mut self, share: f64) -> bool {
        self.between(0.0, 1.0) < share
    }
}

/// Things one after the other, each drawn from numbers of its own.
struct Drawn {
    things: Things,
    next: u64,
}

impl Drawn {
    /// The numbers of the next thing.
    fn thing(&mut self) -> Draw {
        self.next += 1;
        let of = |seed: u64| Draw::new(seed.wrapping_mul(0x9e37_79b9).wrapping_add(self.next * 0x51ed));
        let Things { seed, moved, since } = self.things;
        let mut again = of(since ^ 0x00a9_a142);
        if again.chance(moved) { again } else { of(seed) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lidar::walk;

    #[test]
    fn paths_hit_nothing_whatever_the_obstacles() {
        for (kind, number) in Kind::ALL.into_iter().flat_map(|kind| (0..30).map(move |n| (kind, n))) {
            let site = kind.site(number % 10, Things::new(number).moved(0.5, 9));
            for path in &site.paths {
                let (pose, duration) = walk(path);
                for step in 0..=(10.0 * duration) as usize {
                    let at = pose(0.1 * step as f64).translation;
                    for (i, [low, high]) in site.boxes.iter().enumerate() {
                        let outside = |axis: usize| (low[axis] - at[axis]).max(at[axis] - high[axis]);
                        let flat = outside(0).max(outside(1));
                        let apart = if i == 0 { -flat } else { flat };
                        let is_obstacle = i == 0 || (low[2] < 0.3 && high[2] > FLOOR + 0.3);
                        assert!(
                            !is_obstacle || apart > 0.25,
                            "{kind:?} {number}: {apart:.2} m from {low:?} at {at:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_share_of_the_things_is_moved_and_the_plan_stays() {
        for kind in Kind::ALL {
            let first = kind.site(1, Things::new(4));
            assert_eq!(first, kind.site(1, Things::new(4).moved(0.0, 7)));
            let changed = |share: f64| {
                let other = kind.site(1, Things::new(4).moved(share, 7));
                other.boxes.iter().filter(|b| !first.boxes.contains(b)).count()
            };
            let (some, all) = (changed(0.3), changed(1.0));
            assert!(some <= all && all > 0, "{kind:?}: {some}, {all} of {}", first.boxes.len());
            let built_in =
                first.boxes.iter().filter(|b| kind.site(1, Things::new(4).moved(1.0, 7)).boxes.contains(b));
            assert!(built_in.count() > 5, "{kind:?}");
        }
    }
}
