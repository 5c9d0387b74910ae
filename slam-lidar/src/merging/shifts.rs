//! Small things that stand otherwise: surfaces that two maps saw from the same side and of which the one's rays return a few centimetres
//! before or beyond the other's.
//!
//! None of them is larger than what maps err by, so that each by itself says nothing; how many there are does. They are counted by
//! places, cubes of half a metre of which a map holds a surface that all of its own views put at one depth: what hangs together in one
//! is one fact. Held against that is how often a map differs from itself, the rays of its even views from those of its odd ones,
//! by the likelihood ratio of a rate of its own against that of one place ([`ln_rate_ratio`]).

use super::own_depth::{Look, OwnDepth, depth_along, looks};
use super::robot_map::RobotMap;
use super::surfel::Surfel;
use geometry::Se3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the median of three errs by, of what one errs by: order statistics of the normal law (David and Nagaraja, "Order
/// Statistics", 2003).
const MEDIAN_OF_THREE: f32 = 0.67;
/// What ranges err by at least, standard deviation in metres: makers say 2 to 3 cm (VLP-16: 3 cm). Near surfaces agree better, and
/// poses err by more on far ones.
const NOISE: f32 = 0.02;
/// Depths differ from so many standard deviations on, as a surfel is absent from so many on.
const DEVIATIONS: f32 = 4.0;
/// Edge of a place, cells.
const PLACE: i32 = 2;

/// Places that two sets of rays saw from the same side, and those where they differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counted {
    /// Places where some surface is shifted.
    pub shifted: usize,
    /// Places compared.
    pub of: usize,
}

impl std::ops::Add for Counted {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { shifted: self.shifted + other.shifted, of: self.of + other.of }
    }
}

/// Places by whether some surface in them is shifted by more than `limit`, metres.
fn counted(shifts: impl Iterator<Item = ([i32; 3], f32)>, limit: f32) -> Counted {
    let mut places: BTreeMap<[i32; 3], bool> = BTreeMap::new();
    for (cell, shift) in shifts {
        *places.entry(cell.map(|c| c.div_euclid(PLACE))).or_default() |= shift.abs() > limit;
    }
    Counted { shifted: places.values().filter(|shifted| **shifted).count(), of: places.len() }
}

/// What is shifted between two maps at a pose, and between halves of either map's views, counted alike; `deviation` is what rays end off
/// the surfels that they cross, standard deviation in metres.
pub(super) fn shifts(a: &RobotMap, b: &RobotMap, a_from_b: &Se3, deviation: f32) -> [Counted; 2] {
    let limit = DEVIATIONS * MEDIAN_OF_THREE * deviation.max(NOISE);
    let back = a_from_b.inverse();
    let one = |target: &RobotMap, source: &RobotMap, forth: &Se3, back: &Se3| {
        let shift = |(surfel, own): (&Surfel, &OwnDepth)| {
            let depth = own.depth?;
            let moved = surfel.moved(forth);
            let seen: Vec<Look> =
                looks([surfel, &moved], &target.surfels.views, &target.poses, back).collect();
            Some((surfel.cell, depth_along(seen.iter(), &own.directions)? - depth))
        };
        let found: Vec<([i32; 3], f32)> =
            source.surfels.all.par_iter().zip(source.own_depths()).filter_map(shift).collect();
        counted(found.into_iter(), limit)
    };
    let own = |map: &RobotMap, half: usize| {
        let cells = map.surfels.all.iter().zip(map.own_depths());
        counted(cells.filter_map(|(surfel, own)| Some((surfel.cell, own.halves[half]?))), limit)
    };
    let within = [a, b].map(|map| own(map, 0) + own(map, 1));
    [one(a, b, a_from_b, &back) + one(b, a, &back, a_from_b), within[0] + within[1]]
}

/// What two visits to one place differ in beyond what a map differs from itself, share of the places: other ways look along other
/// lines. Of the right pairs of shop aisles and office floors that it was set on it is 0.005 in the mean where nothing moved, and 0.01
/// at most where 300 places are compared.
const VISITS: f64 = 0.01;

/// `ln p(between | a rate of its own) − ln p(between | the rate of one place)`, where more is shifted between maps than in one place,
/// else 0: binomial laws, the one at its likeliest rate, the other at that within the maps and `VISITS`. Of one place twice of this
/// exceeds `x` in half as many pairs as χ² of one degree of freedom does (Wilks 1938).
pub fn ln_rate_ratio(between: Counted, within: Counted) -> f64 {
    let (shifted, of) = (between.shifted as f64, between.of.max(1) as f64);
    // Half a place more: of none that are shifted it is not known that none ever is.
    let same = ((within.shifted as f64 + 0.5) / (within.of as f64 + 1.0) + VISITS).min(1.0);
    let rate = shifted / of;
    if rate <= same {
        return 0.0;
    }
    let kept = if rate < 1.0 { (of - shifted) * ((1.0 - rate) / (1.0 - same)).ln() } else { 0.0 };
    shifted * (rate / same).ln() + kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(shifted: usize, of: usize) -> Counted {
        Counted { shifted, of }
    }

    /// Ten of a hundred against one and a half of 151 and a hundredth.
    #[test]
    fn the_ratio_is_that_of_two_binomial_laws() {
        let ln = |p: f64| 10.0 * f64::ln(p) + 90.0 * f64::ln(1.0 - p);
        let expected = ln(0.1) - ln(1.5 / 150.0 + 0.01);
        assert!((ln_rate_ratio(counted(10, 100), counted(1, 149)) - expected).abs() < 1e-9);
    }

    #[test]
    fn as_much_as_within_maps_or_nothing_counted_says_nothing() {
        for (between, within) in [
            ((0, 0), (0, 0)),
            ((0, 90), (0, 0)),
            ((1, 100), (1, 100)),
            ((0, 50), (9, 90)),
            ((9, 90), (10, 100)),
            ((9, 20), (0, 0)),
        ] {
            let found = ln_rate_ratio(counted(between.0, between.1), counted(within.0, within.1));
            assert_eq!(found, 0.0, "{between:?} {within:?}");
        }
        assert!(ln_rate_ratio(counted(5, 5), counted(0, 100)).is_finite());
        // With more that is shifted the ratio never falls.
        let ratios: Vec<f64> = (0..=80).map(|k| ln_rate_ratio(counted(k, 80), counted(2, 200))).collect();
        assert!(ratios.windows(2).all(|pair| pair[0] <= pair[1]));
    }
}
