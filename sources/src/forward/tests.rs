use super::*;

/// `count` stamps from `first` on, `step` apart.
fn steady(first: f64, step: f64, count: usize) -> Vec<f64> {
    (0..count).map(|i| first + i as f64 * step).collect()
}

/// How many stamps count, whether time goes forward, and the faults.
fn checked(stamps: &[f64]) -> (usize, Faults) {
    let (of_each, faults) = check_stamps(stamps);
    let times: Vec<f64> = of_each
        .iter()
        .filter_map(|one| if let StampVerdict::At(time) = one { Some(*time) } else { None })
        .collect();
    assert!(times.windows(2).all(|pair| pair[1] > pair[0]), "time goes forward: {times:?}");
    (times.len(), faults)
}

#[test]
fn good_stamps_stay_as_they_are_to_the_last_bit() {
    for (first, step) in [(0.0, 0.1), (1_403_636_579.763_555_5, 0.05), (-3.0, 1.0 / 30.0)] {
        let mut stamps = steady(first, step, 200);
        // Frames are missing, one pause is of an hour, and two frames changed places.
        stamps.drain(50..57);
        stamps[100..].iter_mut().for_each(|stamp| *stamp += 3600.0);
        let (of_each, faults) = check_stamps(&stamps);
        assert!(of_each.iter().zip(&stamps).all(|(one, stamp)| *one == StampVerdict::At(*stamp)));
        assert_eq!(faults, Faults::default());
        stamps.swap(120, 121);
        assert_eq!(checked(&stamps), (stamps.len() - 1, Faults { off: 1, ..Faults::default() }));
    }
}

#[test]
fn one_stamp_that_lies_off_is_left_out_itself() {
    for place in [0, 1, 2, 10, 60, 117, 118, 119] {
        for wrong in [1e4, 2e9, -5.0, 0.0, f64::MAX] {
            let mut stamps = steady(100.0, 0.1, 120);
            stamps[place] = wrong;
            let (counted, faults) = checked(&stamps);
            assert_eq!((counted, faults.off, faults.sets), (119, 1, 0), "{wrong} at {place}");
        }
    }
    let mut two = steady(100.0, 0.1, 120);
    (two[40], two[41]) = (7e3, 7e3 + 0.1);
    assert_eq!(checked(&two).0, 118);
    let mut not = steady(100.0, 0.1, 120);
    (not[0], not[50]) = (f64::NAN, f64::INFINITY);
    assert_eq!(checked(&not), (118, Faults { none: 2, ..Faults::default() }));
}

#[test]
fn a_clock_that_was_set_back_continues() {
    // Set back to long ago, by as much as a recording that is played again, and by a little.
    for back in [1.7e9, 6.0, 1.0] {
        let mut stamps = steady(1.7e9, 0.1, 60);
        stamps.extend(steady(1.7e9 + 6.0 - back, 0.1, 60));
        let (counted, faults) = checked(&stamps);
        assert_eq!((counted, faults.sets, faults.off), (120, 1, 0), "by {back}");
        let (place, by) = faults.first_set.unwrap();
        assert_eq!(place, 60);
        assert!((by + back).abs() < 1e-3, "{by}");
    }
    let mut thrice = steady(5.0, 0.1, 20);
    (0..3).for_each(|_| thrice.extend(steady(0.0, 0.1, 20)));
    assert_eq!((checked(&thrice).0, checked(&thrice).1.sets), (80, 3));
}

#[test]
fn a_day_passes_in_no_recording() {
    // A host without a clock of its own starts in 1970, or in the year its system was made.
    for start in [12.0, 1.5e9] {
        let mut stamps = steady(start, 0.1, 30);
        stamps.extend(steady(1.76e9, 0.1, 60));
        let (of_each, faults) = check_stamps(&stamps);
        assert_eq!((faults.sets, faults.off), (1, 0));
        let StampVerdict::At(last) = of_each[89] else { panic!("the last one counts") };
        assert!((last - start - 8.9).abs() < 1e-3, "{last}");
    }
    // Pictures once an hour, and those of an hour's pause, keep their times.
    let hourly = steady(0.0, 3600.0, 50);
    assert_eq!(checked(&hourly), (50, Faults::default()));
}

#[test]
fn repeated_stamps_and_those_of_two_clocks_count_once() {
    let twice: Vec<f64> = steady(1.0, 0.1, 40).into_iter().flat_map(|stamp| [stamp, stamp]).collect();
    assert_eq!(checked(&twice), (40, Faults { repeated: 40, ..Faults::default() }));
    assert_eq!(checked(&[3.0; 20]), (1, Faults { repeated: 19, ..Faults::default() }));
    let (a, b) = (steady(1e3, 0.1, 40), steady(5.0, 0.1, 40));
    let two: Vec<f64> = a.into_iter().zip(b).flat_map(|(a, b)| [a, b]).collect();
    assert_eq!(checked(&two).0, 40);
}

#[test]
fn any_stamps_give_a_monotone_time() {
    let mut random = geometry::Random::new(3);
    let odd = [0.0, -0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 1e-300, 1.7e9];
    for _ in 0..20_000 {
        let count = random.bits() % 40;
        let stamps: Vec<f64> = (0..count)
            .map(|i| match random.bits() % 5 {
                0 => odd[random.bits() as usize % odd.len()],
                1 => (random.bits() % 1000) as f64 * 0.01,
                _ => i as f64 * 0.1,
            })
            .collect();
        let (counted, faults) = checked(&stamps);
        assert_eq!(counted as u64 + faults.off + faults.repeated + faults.none, count);
    }
}
