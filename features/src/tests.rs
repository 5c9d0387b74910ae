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

/// A soft, bright spot on grey.
fn spot(x: f32, y: f32) -> GrayImage {
    let value = |i: usize| {
        let square = ((i % 160) as f32 - x).powi(2) + ((i / 160) as f32 - y).powi(2);
        (60.0 + 150.0 * (-square / 72.0).exp()).round() as u8
    };
    GrayImage::from_vec(160, 120, (0..160 * 120).map(value).collect()).unwrap()
}

#[test]
fn a_key_point_lies_on_its_spot() {
    for halvings in 0..3 {
        let features = sift(&spot(80.3, 61.7), &SiftParams { halvings, ..SiftParams::default() }).unwrap();
        assert!(!features.is_empty());
        for keypoint in features.keypoints {
            let off = (keypoint.pixel[0] - 80.3).hypot(keypoint.pixel[1] - 61.7);
            assert!(off < 0.1, "{off} with {halvings} halvings: {:?}", keypoint.pixel);
        }
    }
}

#[cfg(feature = "opencv-sift")]
#[test]
fn opencv_finds_the_same_features_in_the_same_places() {
    let params = SiftParams::default();
    let (own, theirs) = (sift(&window(0), &params).unwrap(), OpenCvSift(params).extract(&window(0)).unwrap());
    let mut mean = [0.0; 2];
    let mut count = 0.0;
    for (keypoint, descriptor) in own.keypoints.iter().zip(&own.descriptors) {
        let nearest =
            theirs.descriptors.iter().enumerate().min_by_key(|(_, d)| squared_distance(d, descriptor));
        let (nearest, other) = nearest.unwrap();
        if squared_distance(other, descriptor) < 4000 {
            let other = theirs.keypoints[nearest];
            for (axis, sum) in mean.iter_mut().enumerate() {
                *sum += other.pixel[axis] - keypoint.pixel[axis];
            }
            count += 1.0;
        }
    }
    assert!(count > 0.6 * own.len() as f32, "{count} of {} and {}", own.len(), theirs.len());
    for sum in mean {
        assert!((sum / count).abs() < 0.1, "{} pixels apart", sum / count);
    }
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

/// Each pixel's value through a function of it and a normally distributed number.
fn changed(image: &GrayImage, change: impl Fn(f64, f64) -> f64) -> GrayImage {
    let mut random = geometry::Random::new(7);
    let mut pixel = |&v: &u8| change(f64::from(v), random.normal()).round().clamp(0.0, 255.0) as u8;
    let pixels = image.data().iter().map(&mut pixel).collect();
    GrayImage::from_vec(image.width(), image.height(), pixels).unwrap()
}

/// The share of the features of one image that another has within 1.5 pixels, looking alike.
fn found_again(of: &Features, among: &Features) -> f64 {
    let is_there = |(keypoint, descriptor): &(&Keypoint, &Descriptor)| {
        among.keypoints.iter().zip(&among.descriptors).any(|(other, other_descriptor)| {
            let off = (other.pixel[0] - keypoint.pixel[0]).hypot(other.pixel[1] - keypoint.pixel[1]);
            off < 1.5 && squared_distance(descriptor, other_descriptor) < 90 * 90
        })
    };
    let count = of.keypoints.iter().zip(&of.descriptors).filter(is_there).count();
    count as f64 / of.len().max(1) as f64
}

#[test]
fn a_dark_or_hazy_image_keeps_most_of_its_features() {
    let strongest = SiftParams { max_features: 150, ..SiftParams::default() };
    let bright = sift(&window(0), &strongest).unwrap();
    let dark = changed(&window(0), |v, normal| 0.06 * v + 0.5 * normal);
    let hazy = changed(&window(0), |v, normal| 150.0 + 0.1 * v + 0.5 * normal);
    for image in [dark, hazy] {
        let features = sift(&image, &SiftParams::default()).unwrap();
        let kept = found_again(&bright, &features);
        assert!(kept > 0.6, "{kept} of the strongest, of {} features", features.len());
        // Not so by one contrast for all images.
        let fixed = SiftParams { least_features: 0, ..SiftParams::default() };
        assert!(found_again(&bright, &sift(&image, &fixed).unwrap()) < 0.2);
    }
}

#[test]
fn an_image_with_features_enough_has_those_of_the_contrast_alone() {
    let fixed = SiftParams { least_features: 0, ..SiftParams::default() };
    let all = sift(&window(0), &fixed).unwrap();
    let enough = SiftParams { least_features: 150, ..SiftParams::default() };
    assert!(all.len() > 200);
    assert_eq!(sift(&window(0), &enough).unwrap(), all);
    // Where they are few, weaker ones come behind.
    let few = sift(&window(0), &SiftParams { contrast: 0.1, ..fixed }).unwrap();
    let more = sift(&window(0), &SiftParams { contrast: 0.1, ..enough }).unwrap();
    assert!(few.len() < 120 && (150..220).contains(&more.len()), "{} and {}", few.len(), more.len());
    assert_eq!(more.keypoints[..few.len()], few.keypoints[..]);
    assert_eq!(more.keypoints[..], all.keypoints[..more.len()]);
}

#[test]
fn noise_has_no_features() {
    for (level, noise) in [(100.0, 0.3), (100.0, 1.0), (100.0, 4.0), (3.0, 1.0)] {
        let image = changed(&GrayImage::filled(640, 480, 0), |_, normal| level + noise * normal);
        let features = sift(&image, &SiftParams::default()).unwrap();
        assert!(features.len() < 10, "{} features of noise of {noise} grey levels", features.len());
    }
}
