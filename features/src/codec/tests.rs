use super::*;
use crate::{SiftParams, sift, squared_distance};
use geometry::GrayImage;
use loopbox_tests::Texture;
use proptest::prelude::*;

fn found() -> Features {
    static FOUND: LazyLock<Features> = LazyLock::new(|| {
        let texture = Texture::procedural(5);
        let pixel = |i: usize| texture.sample((i % 320) as f32, (i / 320) as f32, 1.0) as u8;
        let image = GrayImage::from_vec(320, 240, (0..320 * 240).map(pixel).collect()).unwrap();
        sift(&image, &SiftParams::default()).unwrap()
    });
    FOUND.clone()
}

#[test]
fn features_are_read_as_they_were_but_for_rounding() {
    let features = found();
    let bytes = encode(&features);
    let read = decode(&bytes).unwrap();
    assert_eq!(read.len(), features.len());
    for (read, found) in read.keypoints.iter().zip(&features.keypoints) {
        assert!((read.pixel[0] - found.pixel[0]).abs() <= 1.0 / 32.0);
        assert!((read.pixel[1] - found.pixel[1]).abs() <= 1.0 / 32.0);
        assert!((read.size / found.size).log2().abs() <= 1.001 / 16.0);
        let direction_step = (read.angle - found.angle) / std::f32::consts::TAU;
        assert!((direction_step - direction_step.round()).abs() <= 1.001 / 512.0);
    }
    // Another view of the same point is about 8000 away.
    let apart = read.descriptors.iter().zip(&features.descriptors).map(|(a, b)| squared_distance(a, b));
    let mean = apart.sum::<u32>() / features.len() as u32;
    assert!(mean < 2200, "{mean}");
    let each = bytes.len() / features.len();
    assert!(each < 26, "{each} bytes a feature");
}

#[test]
fn what_was_read_is_written_nearly_as_it_was() {
    let read = decode(&encode(&found())).unwrap();
    let again = decode(&encode(&read)).unwrap();
    assert_eq!(again.keypoints, read.keypoints);
}

#[test]
fn no_features_are_written_and_read() {
    assert_eq!(decode(&encode(&Features::default())), Ok(Features::default()));
}

#[test]
fn strange_values_are_written_and_read() {
    let strange = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0, 1e9, 70000.0];
    let mut features = Features::default();
    for a in strange {
        for b in strange {
            features.keypoints.push(Keypoint { pixel: [a, b], size: b, angle: a });
            features.descriptors.push([255; 128]);
        }
    }
    assert_eq!(decode(&encode(&features)).unwrap().len(), features.len());
}

#[test]
fn damage_is_reported() {
    let bytes = encode(&found());
    assert!(matches!(decode(&bytes[..bytes.len() - 1]), Err(CodecError::Truncated { .. })));
    assert!(matches!(decode(&bytes[..5]), Err(CodecError::Truncated { .. })));
    assert!(matches!(decode(&[]), Err(CodecError::Truncated { .. })));
    let longer: Vec<u8> = bytes.iter().copied().chain([0]).collect();
    assert_eq!(decode(&longer), Err(CodecError::Damaged));
    let mut newer = bytes.clone();
    newer[0] = 9;
    assert_eq!(decode(&newer), Err(CodecError::OtherVersion { found: 9, expected: VERSION }));
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..4000), head in any::<bool>()) {
        let mut bytes = bytes;
        if head && bytes.len() > 4 {
            bytes[0] = VERSION;
            bytes[1] %= FINEST + 1;
            bytes[3] = 0;
        }
        if let Ok(features) = decode(&bytes) {
            prop_assert_eq!(features.keypoints.len(), features.descriptors.len());
        }
    }

    #[test]
    fn changed_bytes_are_read_or_refused(at in 0usize..5000, change in 1u8..) {
        let mut bytes = encode(&found());
        let at = at % bytes.len();
        bytes[at] ^= change;
        let _ = decode(&bytes);
    }
}
