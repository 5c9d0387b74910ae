use super::*;
use crate::test_support::Numbers;
use place_recog::features::{Keypoint, squared_distance};
use proptest::prelude::*;

fn features(descriptors: Vec<Descriptor>) -> Features {
    let keypoint = Keypoint { pixel: [0.0, 0.0], size: 1.0, angle: 0.0 };
    Features { keypoints: vec![keypoint; descriptors.len()], descriptors }
}

fn random(count: usize, numbers: &mut Numbers) -> Vec<Descriptor> {
    (0..count).map(|_| std::array::from_fn(|_| numbers.uniform(0.0, 256.0) as u8)).collect()
}

fn disturbed(descriptor: &Descriptor, by: f64, numbers: &mut Numbers) -> Descriptor {
    descriptor.map(|v| (f64::from(v) + by * numbers.normal()).clamp(0.0, 255.0) as u8)
}

/// The same by the plain definition.
fn plain(source: &[Descriptor], target: &[Descriptor], max_ratio: f32) -> Vec<FeatureMatch> {
    let two_nearest = |of: &Descriptor, among: &[Descriptor]| {
        let mut all: Vec<(u32, usize)> =
            among.iter().enumerate().map(|(i, d)| (squared_distance(of, d), i)).collect();
        all.sort();
        (all[0], all.get(1).map_or(u32::MAX, |second| second.0))
    };
    let distinct = |first: u32, second: u32| {
        second == u32::MAX
            || first < second && f64::from(first) <= f64::from(max_ratio).powi(2) * f64::from(second)
    };
    let mut matches = Vec::new();
    for (i, descriptor) in source.iter().enumerate() {
        let ((distance, j), second) = two_nearest(descriptor, target);
        let ((_, back), back_second) = two_nearest(&target[j], source);
        if back == i && distinct(distance, second) && distinct(distance, back_second) {
            matches.push(FeatureMatch { source: i as u32, target: j as u32, squared_distance: distance });
        }
    }
    matches
}

#[test]
fn finds_disturbed_copies_in_another_order() {
    let mut numbers = Numbers::new(1);
    let source = random(100, &mut numbers);
    let mut target: Vec<_> = source.iter().rev().map(|d| disturbed(d, 8.0, &mut numbers)).collect();
    target.extend(random(50, &mut numbers));
    let matches = match_features(&features(source), &features(target), &MatchParams::default());
    assert_eq!(matches.len(), 100);
    assert!(matches.iter().all(|m| m.source + m.target == 99));
}

#[test]
fn twins_match_nothing() {
    let mut numbers = Numbers::new(2);
    let source = random(3, &mut numbers);
    let target = vec![source[0], source[0], source[1], source[2]];
    let matches = match_features(&features(source), &features(target), &MatchParams::default());
    assert_eq!(matches.iter().map(|m| m.source).collect::<Vec<_>>(), [1, 2]);
}

/// The largest distances there can be are told apart by one.
#[test]
fn distances_are_exact() {
    let white = [255u8; 128];
    let mut grey = white;
    grey[17] = 254;
    let matches = match_features(
        &features(vec![white, [0; 128]]),
        &features(vec![[0; 128], grey, white]),
        &MatchParams { max_ratio: 1.0 },
    );
    let distances: Vec<_> = matches.iter().map(|m| (m.source, m.target, m.squared_distance)).collect();
    assert_eq!(distances, [(0, 2, 0), (1, 0, 0)]);
    let far = match_features(&features(vec![white]), &features(vec![[0; 128]]), &MatchParams::default());
    assert_eq!(far[0].squared_distance, 128 * 255 * 255);
}

#[test]
fn nothing_matches_nothing() {
    let mut numbers = Numbers::new(3);
    let (none, some) = (Features::default(), features(random(4, &mut numbers)));
    let params = MatchParams::default();
    assert!(match_features(&none, &some, &params).is_empty());
    assert!(match_features(&some, &none, &params).is_empty());
    let one = features(vec![some.descriptors[0]]);
    assert_eq!(match_features(&one, &one, &params).len(), 1);
}

proptest! {
    #[test]
    fn agrees_with_the_plain_definition(
        seed in 0u64..1000, of_source in 1usize..90, of_target in 1usize..90, by in 5.0..60.0, ratio in 0.5f32..0.99
    ) {
        let mut numbers = Numbers::new(seed);
        let source = random(of_source, &mut numbers);
        let mut target = random(of_target, &mut numbers);
        for (i, descriptor) in target.iter_mut().enumerate().take(of_source / 2) {
            *descriptor = disturbed(&source[(7 * i) % of_source], by, &mut numbers);
        }
        let expected = plain(&source, &target, ratio);
        let found = match_features(&features(source), &features(target), &MatchParams { max_ratio: ratio });
        prop_assert_eq!(found, expected);
    }
}
