use super::{depth, digest::Digest, image};
use crate::test_support::{Random, agent, map};
use geometry::{GrayImage, Pinhole};
use map::{Keyframe, KeyframeId, SemiDense};
use place_recog::{Vocabulary, WordBag, WordId};

const CAMERA: Pinhole = Pinhole { width: 96, height: 64, fx: 90.0, fy: 90.0, cx: 47.5, cy: 31.5 };

/// Depths along lines, as those of edges are: two surfaces with noise.
fn lines() -> SemiDense {
    let mut numbers = Random::new(5);
    let mut depth = SemiDense::default();
    for y in 0..CAMERA.height {
        for x in 0..CAMERA.width {
            let near = (x + y / 3) % 16 < 3;
            if near || y % 20 == 7 {
                let surface = if x < 50 { 0.2 + 0.001 * y as f64 } else { 0.9 };
                depth.pixel.push((y * CAMERA.width + x) as u32);
                depth.inverse_depth.push((surface * (1.0 + 0.004 * numbers.unit())) as f32);
                depth.variance.push((surface * surface * 1e-4 * (0.5 + numbers.unit())) as f32);
            }
        }
    }
    depth
}

#[test]
fn depth_comes_back_up_to_what_is_rounded_and_is_few_bytes() {
    let depth = lines();
    let bytes = depth::encode(&depth, &CAMERA);
    assert!(bytes.len() < 2 * depth.len(), "{} bytes for {} depths", bytes.len(), depth.len());
    let again = depth::decode(&bytes, &CAMERA).unwrap();
    assert_eq!(again.pixel, depth.pixel);
    for ((_, d, v), (_, found, variance)) in depth.iter().zip(again.iter()) {
        assert!((found / d).ln().abs() <= 0.00251, "{d} {found}");
        assert!((variance / v).log2().abs() <= 0.51, "{v} {variance}");
    }
    // What was rounded once is not rounded again.
    assert_eq!(depth::encode(&again, &CAMERA), bytes);
}

#[test]
fn depths_that_are_none_are_left_out() {
    let mut depth = lines();
    (depth.inverse_depth[3], depth.variance[5], depth.variance[6]) = (f32::NAN, f32::INFINITY, 0.0);
    (depth.inverse_depth[8], depth.inverse_depth[9]) = (1e-38, f32::MAX);
    *depth.pixel.last_mut().unwrap() = u32::MAX;
    let again = depth::decode(&depth::encode(&depth, &CAMERA), &CAMERA).unwrap();
    assert_eq!(again.len(), depth.len() - 5);
    assert_eq!((again.pixel[3], again.variance[4]), (depth.pixel[4], 0.0));
    let none = depth::decode(&depth::encode(&SemiDense::default(), &CAMERA), &CAMERA).unwrap();
    assert!(none.is_empty());
}

#[test]
fn an_image_comes_back_nearly_and_only_in_the_cameras_size() {
    let wave = |i: usize| {
        (128.0 + 60.0 * ((i % 96) as f64 / 7.0).sin() + 40.0 * ((i / 96) as f64 / 9.0).cos()) as u8
    };
    let image = GrayImage::from_vec(96, 64, (0..96 * 64).map(wave).collect()).unwrap();
    let bytes = image::encode(&image).unwrap();
    let again = image::decode(&bytes, &CAMERA).unwrap();
    let apart = image.data().iter().zip(again.data()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(apart < Some(8), "{apart:?}");
    let other = Pinhole { width: 64, height: 96, ..CAMERA };
    assert!(image::decode(&bytes, &other).unwrap_err().contains("96×64"));
}

fn digest() -> (Digest, Keyframe) {
    let map = map(agent(3), 2);
    let keyframe = map.keyframes.values().next_back().unwrap().clone();
    let words = WordBag::new([7, 7, 300, 2000, 2000, 2000].map(WordId));
    (Digest::of(&keyframe, words, &[KeyframeId(1), KeyframeId(1), KeyframeId(9)]), keyframe)
}

#[test]
fn a_digest_comes_back() {
    let (digest, keyframe) = digest();
    assert_eq!(digest.linked, [KeyframeId(1)]);
    assert!(digest.samples.len() > 40);
    let bytes = digest.to_bytes(keyframe.id);
    let again = Digest::from_bytes(&bytes, keyframe.id, &Vocabulary::shipped()).unwrap();
    for ((pixel, d), (at, found)) in digest.samples.iter().zip(&again.samples) {
        assert!(pixel == at && (found / d).ln().abs() <= 0.00251);
    }
    assert_eq!(Digest { samples: digest.samples.clone(), ..again.clone() }, digest);
    assert_eq!(again.to_bytes(keyframe.id), bytes);
}

#[test]
fn words_that_the_vocabulary_does_not_have_are_refused() {
    let (digest, keyframe) = digest();
    let vocabulary = Vocabulary::shipped();
    let last = vocabulary.len() as u32 - 1;
    let with =
        |word: u32| Digest { words: WordBag::new([WordId(word)]), ..digest.clone() }.to_bytes(keyframe.id);
    assert!(Digest::from_bytes(&with(last), keyframe.id, &vocabulary).is_ok());
    assert!(Digest::from_bytes(&with(last + 1), keyframe.id, &vocabulary).is_err());
}

#[test]
fn changed_bytes_never_panic_and_cut_ones_are_refused() {
    let (digest, keyframe) = digest();
    let vocabulary = Vocabulary::shipped();
    let (coded, written) = (depth::encode(&lines(), &CAMERA), digest.to_bytes(keyframe.id));
    let picture = image::encode(&GrayImage::filled(96, 64, 9)).unwrap();
    for end in 0..written.len() {
        assert!(Digest::from_bytes(&written[..end], keyframe.id, &vocabulary).is_err());
    }
    for end in (0..coded.len()).step_by(7) {
        assert!(depth::decode(&coded[..end], &CAMERA).is_err());
    }
    let longer = [&coded[..], &[0]].concat();
    assert!(depth::decode(&longer, &CAMERA).is_err());
    let mut numbers = Random::new(8);
    for round in 0..600 {
        let mut changed = [&coded, &written, &picture][round % 3].clone();
        for _ in 0..=numbers.below(3) {
            let at = numbers.index(changed.len());
            changed[at] = numbers.below(256) as u8;
        }
        match round % 3 {
            0 => drop(depth::decode(&changed, &CAMERA)),
            1 => drop(Digest::from_bytes(&changed, keyframe.id, &vocabulary)),
            _ => drop(image::decode(&changed, &CAMERA)),
        }
    }
}
