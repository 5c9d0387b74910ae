use super::*;

/// A different textured image for each seed, shifted by pixels.
fn image(seed: u32, shift: f32, gain: f32, offset: f32) -> GrayImage {
    let mut image = GrayImage::filled(320, 240, 0);
    let s = seed as f32;
    for y in 0..240 {
        for x in 0..320 {
            let (u, v) = (x as f32 + shift, y as f32);
            let value = (u * (0.02 + 0.003 * (s % 5.0)) + s).sin()
                + (v * (0.03 + 0.002 * (s % 7.0)) - 2.0 * s).sin()
                + (0.011 * (u + v) * (1.0 + 0.1 * (s % 3.0)) + 0.7 * s).cos();
            image.set(x, y, (128.0 + gain * 35.0 * value + offset).clamp(0.0, 255.0) as u8);
        }
    }
    image
}

fn filled(count: u32) -> ThumbnailIndex {
    let mut index = ThumbnailIndex::default();
    for seed in 0..count {
        index.add(KeyframeId(seed), &image(seed, 0.0, 1.0, 0.0));
    }
    index
}

#[test]
fn finds_the_same_view_shifted_and_in_other_light() {
    let index = filled(60);
    for seed in [0, 7, 31, 59] {
        let found = index.query(&image(seed, 25.0, 0.6, 20.0), 3);
        assert_eq!(found[0].keyframe, KeyframeId(seed), "{found:?}");
        assert!(found[0].score > 0.9, "{found:?}");
        assert!(found.windows(2).all(|pair| pair[0].score >= pair[1].score));
    }
    let exact = index.query(&image(7, 0.0, 1.0, 0.0), 1);
    assert!((exact[0].score - 1.0).abs() < 1e-3);
}

#[test]
fn a_keyframe_added_twice_is_replaced() {
    let mut index = filled(3);
    index.add(KeyframeId(1), &image(40, 0.0, 1.0, 0.0));
    assert_eq!(index.len(), 3);
    assert_eq!(index.query(&image(40, 0.0, 1.0, 0.0), 1)[0].keyframe, KeyframeId(1));
}

#[test]
fn nothing_is_found_without_contrast_or_keyframes() {
    assert!(ThumbnailIndex::default().query(&image(1, 0.0, 1.0, 0.0), 5).is_empty());
    let mut index = ThumbnailIndex::default();
    index.add(KeyframeId(0), &GrayImage::filled(320, 240, 80));
    assert!(index.query(&GrayImage::filled(320, 240, 0), 5).is_empty());
    assert!(index.query(&image(1, 0.0, 1.0, 0.0), 5).is_empty());
    assert!(filled(4).query(&GrayImage::filled(0, 0, 0), 5).is_empty());
    assert!(filled(4).query(&image(1, 0.0, 1.0, 0.0), 0).is_empty());
}

#[test]
fn images_smaller_than_a_thumbnail_are_taken() {
    let mut index = ThumbnailIndex::default();
    let tiny = GrayImage::from_vec(4, 3, (0..12).map(|v| v * 20).collect()).unwrap();
    index.add(KeyframeId(3), &tiny);
    assert_eq!(index.query(&tiny, 1)[0].keyframe, KeyframeId(3));
}

/// Smooth images of random cells, some of them nearly the same.
fn blotches(seed: u64) -> GrayImage {
    let (mut one, mut other) = (geometry::Random::new(seed / 3), geometry::Random::new(seed));
    let cells: Vec<f32> =
        (0..80).map(|_| 200.0 * one.below(256) as f32 / 256.0 + 0.2 * other.below(256) as f32).collect();
    let mut image = GrayImage::filled(160, 120, 0);
    for y in 0..120 {
        for x in 0..160 {
            image.set(x, y, cells[y / 15 * 10 + x / 16].min(255.0) as u8);
        }
    }
    image
}

#[test]
fn the_best_are_those_of_all_and_most_are_not_looked_at() {
    let mut index = ThumbnailIndex::default();
    (0..600).for_each(|seed| index.add(KeyframeId(seed), &blotches(u64::from(seed))));
    let mut likely = 0;
    for seed in (0..600).step_by(37) {
        let query = Thumbnail::new(&blotches(seed + 1));
        let all = index.ranked(std::slice::from_ref(&query), 0..600);
        let bound =
            |&(score, keyframe): &(f32, usize)| (score, query.coarse().bound(&index.coarse[keyframe]));
        assert!(all.iter().map(bound).all(|(score, bound)| bound >= score));
        for count in [0, 1, 20, 599, 600, 700] {
            assert_eq!(index.best(&query, 0..600, count), all[..count.min(600)]);
        }
        likely += all.iter().map(bound).filter(|(_, bound)| *bound >= all[19].0).count();
    }
    assert!(likely < 17 * 350, "of 600 some {} may be among the 20 best", likely / 17);
}
