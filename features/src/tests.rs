use super::*;
use geometry::GrayImage;
use loopbox_tests::Texture;

/// A window of a texture that begins `x` pixels further right.
fn window(x: usize) -> GrayImage {
    let texture = Texture::procedural(5);
    let pixel = |i: usize| texture.sample((i % 320 + x) as f32, (i / 320) as f32, 1.0) as u8;
    GrayImage::from_vec(320, 240, (0..320 * 240).map(pixel).collect()).unwrap()
}

#[test]
fn a_shifted_image_has_shifted_key_points() {
    let find = |x| sift(&window(x), &SiftParams::default()).unwrap();
    let (first, second) = (find(0), find(12));
    assert!(first.len() > 200, "{}", first.len());
    let inner = |k: &&Keypoint| (60.0..260.0).contains(&k.pixel[0]) && (40.0..200.0).contains(&k.pixel[1]);
    let shifted = |k: &Keypoint| {
        second.keypoints.iter().zip(&second.descriptors).any(|(other, descriptor)| {
            let off = (other.pixel[0] + 12.0 - k.pixel[0]).hypot(other.pixel[1] - k.pixel[1]);
            let own = first.keypoints.iter().position(|f| f == k).unwrap();
            off < 0.2 && squared_distance(descriptor, &first.descriptors[own]) < 1000
        })
    };
    let inside: Vec<&Keypoint> = first.keypoints.iter().filter(inner).collect();
    let found = inside.iter().filter(|k| shifted(k)).count();
    assert!(found as f64 > 0.9 * inside.len() as f64, "{found} of {}", inside.len());
}

#[test]
fn descriptors_have_one_length() {
    for descriptor in sift(&window(0), &SiftParams::default()).unwrap().descriptors {
        let length = f64::from(squared_distance(&descriptor, &[0; 128])).sqrt();
        assert!((length - 256.0).abs() < 4.0, "{length}");
    }
}

#[test]
fn the_strongest_features_come_first_and_no_more_than_asked_for() {
    let all = sift(&window(0), &SiftParams::default()).unwrap();
    let few = sift(&window(0), &SiftParams { max_features: 50, ..SiftParams::default() }).unwrap();
    assert_eq!(few.len(), 50);
    assert!(few.keypoints.iter().all(|k| all.keypoints.contains(k)));
}

#[test]
fn a_flat_image_has_no_features_and_an_empty_one_is_refused() {
    let flat = GrayImage::filled(64, 48, 100);
    assert!(sift(&flat, &SiftParams::default()).unwrap().is_empty());
    assert!(sift(&GrayImage::filled(0, 0, 0), &SiftParams::default()).is_err());
}
