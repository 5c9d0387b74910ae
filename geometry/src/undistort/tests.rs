use super::*;
use crate::{Distortion, Fov, KannalaBrandt, RadTan};

fn camera(fx: f64, fy: f64, cx: f64, cy: f64, distortion: Distortion) -> Camera {
    Camera::new(Pinhole { width: 640, height: 480, fx, fy, cx, cy }, distortion).unwrap()
}

fn radtan(terms: &[f64]) -> Distortion {
    Distortion::RadTan(RadTan::new(terms).unwrap())
}

fn kinect() -> Camera {
    let terms = [0.262383, -0.953104, -0.005358, 0.002628, 1.163314];
    camera(517.306408, 516.469215, 318.64304, 255.313989, radtan(&terms))
}

/// Mild, barrel, folding within the image, fisheye of more than 180°, and ATAN cameras.
fn cameras() -> Vec<Camera> {
    let fisheye = |terms| Distortion::KannalaBrandt(KannalaBrandt::new(terms).unwrap());
    vec![
        kinect(),
        camera(400.0, 398.0, 320.0, 240.0, radtan(&[-0.28340811, 0.07395907, 0.00019359, 1.76e-5])),
        camera(300.0, 300.0, 330.0, 230.0, radtan(&[-0.3, 0.0, 0.0, 0.0])),
        camera(190.0, 190.0, 319.5, 239.5, fisheye(&[-0.0034, 0.0007, -0.0021, 0.0002])),
        camera(340.0, 450.0, 310.0, 250.0, Distortion::Fov(Fov::new(&[0.9281]).unwrap())),
    ]
}

/// A smooth scene seen by a camera: intensity depends on the ray alone.
fn scene(ray: &Vector3<f64>) -> f64 {
    let ray = ray.normalize();
    127.5 + 60.0 * (9.0 * ray.x).sin() + 60.0 * (7.0 * ray.y + 3.0 * ray.x).cos()
}

#[test]
fn the_valid_crop_is_valid_everywhere_and_not_wasteful() {
    for camera in cameras() {
        let undistorter = Undistorter::new(&camera, Crop::Valid).unwrap();
        assert!(undistorter.valid().data().iter().all(|&valid| valid), "{camera:?}");
        let (from, to) = (camera.intrinsics(), undistorter.pinhole());
        assert_eq!((from.width, from.height), (to.width, to.height));
        assert!((from.fx / from.fy - to.fx / to.fy).abs() < 1e-9);
        // One per cent more of the scene would show something unseen, unless the bound is reached.
        let wider = Pinhole { fx: to.fx * 0.985, fy: to.fy * 0.985, ..*to };
        let wider = Undistorter::new(&camera, Crop::Explicit(wider)).unwrap();
        let bounded = to.fx < 0.51 * from.fx;
        assert!(bounded || wider.valid().data().iter().any(|&valid| !valid), "{camera:?} {to:?}");
    }
}

#[test]
fn the_kinect_keeps_its_field_of_view() {
    let pinhole = Crop::Valid.pinhole_of(&kinect());
    assert!((pinhole.fx / 517.3 - 1.0).abs() < 0.06, "{pinhole:?}");
    assert!((pinhole.cx - 318.6).abs() < 15.0 && (pinhole.cy - 255.3).abs() < 15.0, "{pinhole:?}");
}

#[test]
fn undistorted_images_show_what_the_pinhole_would_see() {
    // Without the folding lens: where it folds, no source pixel beyond has a ray to draw.
    for camera in [0, 1, 3, 4].map(|i| cameras()[i]) {
        let mut image = GrayImage::filled(640, 480, 0);
        for y in 0..480 {
            for x in 0..640 {
                if let Some(ray) =
                    camera.unproject(&Vector2::new(x as f64, y as f64)).filter(|ray| ray.z > 0.1)
                {
                    image.set(x, y, scene(&ray).round() as u8);
                }
            }
        }
        let undistorter = Undistorter::new(&camera, Crop::Valid).unwrap();
        let output = undistorter.undistort(&image).unwrap();
        let mut worst = 0.0f64;
        for y in 0..480 {
            for x in 0..640 {
                let truth = scene(&undistorter.pinhole().unproject(x as f64, y as f64));
                worst = worst.max((f64::from(output.get(x, y)) - truth).abs());
            }
        }
        assert!(worst < 3.0, "{worst} {camera:?}");
    }
}

#[test]
fn a_pinhole_passes_through_bit_equal() {
    let camera = camera(420.0, 420.0, 319.5, 239.5, Distortion::None);
    let image =
        GrayImage::from_vec(640, 480, (0..640 * 480).map(|i| (i * 31 % 251) as u8).collect()).unwrap();
    for crop in [Crop::Valid, Crop::KeepFocal, Crop::Explicit(*camera.intrinsics())] {
        let undistorter = Undistorter::new(&camera, crop).unwrap();
        assert!(undistorter.is_identity());
        assert_eq!(undistorter.pinhole(), camera.intrinsics());
        assert_eq!(undistorter.undistort(&image).unwrap(), image);
    }
    let no_terms = Camera::new(*camera.intrinsics(), radtan(&[0.0; 5])).unwrap();
    assert!(Undistorter::new(&no_terms, Crop::Valid).unwrap().is_identity());
}

#[test]
fn the_table_alone_is_exact_for_whole_pixels() {
    // A pinhole shifted by (3, 2) pixels and cut to 200×100 copies pixels, the last row and column too.
    let camera = camera(420.0, 420.0, 319.5, 239.5, Distortion::None);
    let image =
        GrayImage::from_vec(640, 480, (0..640 * 480).map(|i| (i * 31 % 251) as u8).collect()).unwrap();
    let corner =
        Pinhole { width: 200, height: 100, cx: 319.5 - 440.0, cy: 239.5 - 380.0, ..*camera.intrinsics() };
    let undistorter = Undistorter::new(&camera, Crop::Explicit(corner)).unwrap();
    assert!(!undistorter.is_identity());
    let output = undistorter.undistort(&image).unwrap();
    for (x, y) in [(0, 0), (199, 0), (0, 99), (199, 99), (57, 33)] {
        assert_eq!(output.get(x, y), image.get(x + 440, y + 380));
    }
}

#[test]
fn keeping_the_focal_length_repeats_the_edge_and_says_so() {
    // Barrel distortion the other way round: the corners of the output lie outside the source.
    let camera = camera(400.0, 400.0, 319.5, 239.5, radtan(&[0.2, 0.0, 0.0, 0.0]));
    let mut image = GrayImage::filled(640, 480, 200);
    image.set(0, 0, 40);
    let undistorter = Undistorter::new(&camera, Crop::KeepFocal).unwrap();
    assert_eq!(undistorter.pinhole(), camera.intrinsics());
    assert!(!undistorter.valid().get(0, 0) && undistorter.valid().get(320, 240));
    assert_eq!(undistorter.undistort(&image).unwrap().get(0, 0), 40);
}

#[test]
fn rays_beyond_the_model_take_the_last_pixel_it_knows() {
    let camera = cameras()[2];
    let wide = Pinhole { fx: 60.0, fy: 60.0, ..*camera.intrinsics() };
    let undistorter = Undistorter::new(&camera, Crop::Explicit(wide)).unwrap();
    assert!(!undistorter.valid().get(0, 0) && undistorter.valid().get(330, 230));
    let output = undistorter.undistort(&GrayImage::filled(640, 480, 77)).unwrap();
    assert!(output.data().iter().all(|&value| value == 77));
}

#[test]
fn another_size_is_refused_and_the_output_kept() {
    let undistorter = Undistorter::new(&kinect(), Crop::Valid).unwrap();
    let mut output = GrayImage::filled(2, 2, 9);
    let error = undistorter.undistort_into(&GrayImage::filled(320, 240, 0), &mut output).unwrap_err();
    assert_eq!(error, ImageSizeError { found: (320, 240), expected: (640, 480) });
    assert!(error.to_string().contains("320×240"));
    assert_eq!(output, GrayImage::filled(2, 2, 9));
}

#[test]
fn an_explicit_camera_without_size_is_refused() {
    let none = Pinhole { width: 0, ..*kinect().intrinsics() };
    assert!(Undistorter::new(&kinect(), Crop::Explicit(none)).is_err());
}

#[test]
fn interpolation_is_the_rounded_bilinear_mean() {
    for (right, below) in [(0u32, 0u32), (256, 256), (256, 0), (37, 201), (128, 128), (255, 1)] {
        for (top, bottom) in [([0u8, 255u8], [255u8, 0u8]), ([255, 255], [255, 255]), ([3, 90], [200, 17])] {
            let (a, b) = (f64::from(right) / 256.0, f64::from(below) / 256.0);
            let mix = |row: [u8; 2]| f64::from(row[0]) * (1.0 - a) + f64::from(row[1]) * a;
            let exact = mix(top) * (1.0 - b) + mix(bottom) * b;
            assert_eq!(interpolate(top, bottom, right, below), (exact + 0.5).floor() as u8);
        }
    }
}

/// A rectified car camera whose rectification left a little distortion: wide images are not cut to a strip.
#[test]
fn a_wide_image_keeps_its_view() {
    for terms in [[0.0174, -0.0077, 0.0, 0.0], [0.018, -0.009, 0.0, 0.0], [-0.02, 0.01, 0.0, 0.0]] {
        let intrinsics = Pinhole { width: 1226, height: 370, fx: 705.0, fy: 705.0, cx: 601.1, cy: 181.6 };
        let camera = Camera::new(intrinsics, Distortion::RadTan(RadTan::new(&terms).unwrap())).unwrap();
        let pinhole = Crop::Valid.pinhole_of(&camera);
        assert!((pinhole.fx / 705.0 - 1.0).abs() < 0.05, "{pinhole:?}");
        assert!((pinhole.cx - 601.1).abs() < 15.0 && (pinhole.cy - 181.6).abs() < 15.0, "{pinhole:?}");
    }
}
