use super::*;
use proptest::prelude::*;

/// Matches of views at places along a path: fewer the further apart.
fn overlap(a: f64, b: f64) -> usize {
    (400.0 * (-(a - b).powi(2) / 4.0).exp()) as usize
}

fn pair(centre: (usize, usize), lengths: (usize, usize), sign: f64) -> Pairing {
    let place = |j: usize| centre.0 as f64 + sign * (j as f64 - centre.1 as f64);
    let count = |i: usize, j: usize| overlap(i as f64, place(j));
    pair_neighbours(centre, lengths, count, &PairingParams::default()).unwrap()
}

#[test]
fn tells_the_direction_and_pairs_the_neighbours() {
    let same = pair((4, 7), (10, 10), 1.0);
    assert_eq!(same.travel, Travel::Same);
    assert_eq!(same.pairs, [Some((3, 6)), Some((4, 7)), Some((5, 8))]);
    let opposite = pair((4, 7), (10, 10), -1.0);
    assert_eq!(opposite.travel, Travel::Opposite);
    assert_eq!(opposite.pairs, [Some((3, 8)), Some((4, 7)), Some((5, 6))]);
}

#[test]
fn the_ends_of_the_lists_leave_pairs_out() {
    let same = pair((0, 7), (10, 10), 1.0);
    assert_eq!(same.travel, Travel::Same);
    assert_eq!(same.pairs, [None, Some((0, 7)), Some((1, 8))]);
    let opposite = pair((4, 0), (10, 10), -1.0);
    assert_eq!(opposite.travel, Travel::Opposite);
    assert_eq!(opposite.pairs, [Some((3, 1)), Some((4, 0)), None]);
}

#[test]
fn two_ends_leave_nothing_to_compare() {
    let corner = pair((0, 0), (10, 10), 1.0);
    assert_eq!(corner.travel, Travel::Unknown);
    assert_eq!(corner.pairs, [None, Some((0, 0)), None]);
    assert_eq!(pair((0, 3), (1, 9), 1.0).travel, Travel::Unknown);
    let count = |_, _| panic!("there is nothing to compare");
    assert!(pair_neighbours((0, 0), (1, 1), count, &PairingParams::default()).is_some());
}

#[test]
fn a_centre_outside_the_lists_has_no_pairs() {
    for centre in [(10, 0), (0, 10), (usize::MAX, 0)] {
        assert_eq!(pair_neighbours(centre, (10, 10), |_, _| 1, &PairingParams::default()), None);
    }
}

#[test]
fn a_difference_within_the_noise_decides_nothing() {
    let params = PairingParams::default();
    // 100 − 70 = 2.3 deviations; 100 − 58 = 3.3.
    assert_eq!(decide(100, 70, &params), Travel::Unknown);
    assert_eq!(decide(100, 58, &params), Travel::Same);
    assert_eq!(decide(58, 100, &params), Travel::Opposite);
    // Many deviations, but both match nearly alike.
    assert_eq!(decide(20_000, 18_500, &params), Travel::Unknown);
    assert_eq!(decide(0, 0, &params), Travel::Unknown);
}

proptest! {
    /// The direction of the exchanged agents is the same.
    #[test]
    fn exchanged_agents_travel_in_the_same_direction(i in 0usize..5, j in 0usize..5, counts in prop::collection::vec(0usize..200, 25)) {
        let params = PairingParams::default();
        let there = pair_neighbours((i, j), (5, 5), |a, b| counts[5 * a + b], &params).unwrap();
        let back = pair_neighbours((j, i), (5, 5), |b, a| counts[5 * a + b], &params).unwrap();
        prop_assert_eq!(there.travel, back.travel);
    }
}
