use super::*;
use proptest::prelude::*;

const SIZE: (usize, usize) = (640, 480);

fn camera(distortion: Distortion) -> Camera {
    let (width, height) = SIZE;
    let intrinsics = Pinhole { width, height, fx: 420.0, fy: 415.0, cx: 322.5, cy: 236.25 };
    Camera::new(intrinsics, distortion).unwrap()
}

fn radtan(terms: &[f64]) -> Distortion {
    Distortion::RadTan(RadTan::new(terms).unwrap())
}

/// Lenses as people have them: mild and strong, each model, each number of terms.
fn lenses() -> Vec<Distortion> {
    vec![
        Distortion::None,
        radtan(&[-0.28340811, 0.07395907, 0.00019359, 1.76e-5]),
        radtan(&[0.262383, -0.953104, -0.005358, 0.002628, 1.163314]),
        radtan(&[-0.4, 0.15, 0.001, -0.002, -0.02]),
        radtan(&[-0.3, 0.0, 0.0, 0.0]),
        radtan(&[16.1, 17.6, 1e-4, -4e-5, 0.94, 16.5, 23.6, 5.6]),
        Distortion::KannalaBrandt(KannalaBrandt::new(&[-0.0034, 0.0007, -0.0021, 0.0002]).unwrap()),
        Distortion::KannalaBrandt(KannalaBrandt::new(&[0.35, -0.2, 0.1, -0.05]).unwrap()),
        Distortion::Fov(Fov::new(&[0.9281]).unwrap()),
        Distortion::Fov(Fov::new(&[1e-4]).unwrap()),
    ]
}

/// Any lens of [`lenses`], or a random mild radial-tangential one.
fn any_camera() -> impl Strategy<Value = Camera> {
    let known = (0..lenses().len()).prop_map(|i| camera(lenses()[i]));
    let random = (-0.3..0.3, -0.2..0.2, -0.01..0.01, -0.01..0.01, -0.1..0.1)
        .prop_map(|(k1, k2, p1, p2, k3)| camera(radtan(&[k1, k2, p1, p2, k3])));
    prop_oneof![3 => known, 1 => random]
}

fn any_point() -> impl Strategy<Value = Vector3<f64>> {
    // Log-uniform radius, so that points near the axis are common.
    (-12.0..1.5f64, 0.0..6.3f64, 0.1..30.0f64).prop_map(|(log_radius, angle, depth)| {
        let radius = log_radius.exp();
        Vector3::new(radius * angle.cos(), radius * angle.sin(), 1.0) * depth
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn a_projected_point_unprojects_to_its_ray(camera in any_camera(), point in any_point()) {
        if let Some(pixel) = camera.project(&point) {
            // Far outside the picture a pixel step is below the rounding of the coordinate.
            if (pixel - Vector2::new(320.0, 240.0)).norm() < 2e3 {
                let ray = camera.unproject(&pixel).ok_or(TestCaseError::fail("no ray"))?;
                prop_assert!((ray.norm() - 1.0).abs() < 1e-12);
                let again = camera.project(&ray).ok_or(TestCaseError::fail("ray does not project"))?;
                prop_assert!((again - pixel).norm() < 1e-6, "{:?} {:?}", again, pixel);
            }
        }
    }

    #[test]
    fn every_ray_of_a_pixel_projects_to_it(camera in any_camera(), x in -100.0..740.0, y in -100.0..580.0) {
        let pixel = Vector2::new(x, y);
        if let Some(ray) = camera.unproject(&pixel) {
            let again = camera.project(&ray).ok_or(TestCaseError::fail("ray does not project"))?;
            prop_assert!((again - pixel).norm() < 1e-6, "{:?} {:?}", again, pixel);
        }
    }

    #[test]
    fn jacobian_agrees_with_differences(camera in any_camera(), point in any_point()) {
        let Some((pixel, jacobian)) = camera.project_with_jacobian(&point) else { return Ok(()) };
        prop_assume!((pixel - Vector2::new(320.0, 240.0)).norm() < 2e3);
        let step = 1e-5 * point.z;
        for axis in 0..3 {
            let delta = Vector3::ith(axis, step);
            let (Some(up), Some(down)) = (camera.project(&(point + delta)), camera.project(&(point - delta)))
            else { return Ok(()) };
            let numeric = (up - down) / (2.0 * step);
            let error = (numeric - jacobian.column(axis)).norm() * point.z;
            prop_assert!(error < 1e-4 * (1.0 + jacobian.norm() * point.z), "axis {}: {}", axis, error);
        }
    }

    #[test]
    fn no_input_gives_nonsense(camera in any_camera(), x in any::<f64>(), y in any::<f64>(), z in any::<f64>()) {
        if let Some(pixel) = camera.project(&Vector3::new(x, y, z)) {
            prop_assert!(pixel.x.is_finite() && pixel.y.is_finite());
        }
        if let Some(ray) = camera.unproject(&Vector2::new(x, y)) {
            prop_assert!((ray.norm() - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn radtan_matches_values_worked_by_hand() {
    // x = 0.5, y = 0.25, u = 0.3125: f = 1 + 0.1·0.3125 = 1.03125;
    // x' = 0.515625 + 2·0.01·0.125 + 0.02·(0.3125 + 0.5) = 0.534375,
    // y' = 0.2578125 + 0.01·(0.3125 + 0.125) + 2·0.02·0.125 = 0.2671875.
    let pixel = camera(radtan(&[0.1, 0.0, 0.01, 0.02])).project(&Vector3::new(1.0, 0.5, 2.0)).unwrap();
    assert!((pixel - Vector2::new(420.0 * 0.534375 + 322.5, 415.0 * 0.2671875 + 236.25)).norm() < 1e-10);
}

#[test]
fn radtan_is_refused_where_it_folds() {
    // r (1 − 0.3 r²) grows up to r² = 1 / 0.9, where it reaches 2/3 of r.
    let lens = RadTan::new(&[-0.3, 0.0, 0.0, 0.0]).unwrap();
    let limit = (1.0f64 / 0.9).sqrt();
    assert!((lens.max_radius() - limit).abs() < 1e-9);
    let camera = camera(Distortion::RadTan(lens));
    assert!(camera.project(&Vector3::new(0.99 * limit, 0.0, 1.0)).is_some());
    assert!(camera.project(&Vector3::new(1.01 * limit, 0.0, 1.0)).is_none());
    let edge = 322.5 + 420.0 * limit * 2.0 / 3.0;
    assert!(camera.unproject(&Vector2::new(edge - 0.1, 236.25)).is_some());
    assert!(camera.unproject(&Vector2::new(edge + 0.1, 236.25)).is_none());
}

#[test]
fn rational_radtan_is_refused_beyond_its_pole() {
    let lens = RadTan::new(&[0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0]).unwrap();
    assert!(lens.max_radius() <= 1.0);
    assert!(camera(Distortion::RadTan(lens)).project(&Vector3::new(1.2, 0.0, 1.0)).is_none());
}

#[test]
fn a_fisheye_sees_sideways_and_a_pinhole_does_not_see_behind() {
    let fisheye = camera(lenses()[6]);
    let pixel = fisheye.project(&Vector3::new(1.0, 0.0, -0.05)).unwrap();
    assert!(fisheye.unproject(&pixel).unwrap().z < 0.0);
    for lens in [0, 1, 8] {
        assert_eq!(camera(lenses()[lens]).project(&Vector3::new(0.1, 0.0, -1.0)), None);
        assert_eq!(camera(lenses()[lens]).project(&Vector3::new(0.1, 0.0, 0.0)), None);
    }
    assert_eq!(fisheye.project(&Vector3::zeros()), None);
    assert_eq!(fisheye.project(&Vector3::new(0.0, 0.0, -1.0)), None);
}

#[test]
fn every_image_pixel_of_a_usual_lens_has_a_ray() {
    for lens in [0, 1, 2, 6, 8, 9].map(|i| lenses()[i]) {
        for (x, y) in [(0.0, 0.0), (639.0, 0.0), (0.0, 479.0), (639.0, 479.0), (322.5, 236.25)] {
            assert!(camera(lens).unproject(&Vector2::new(x, y)).is_some(), "{lens:?} {x} {y}");
        }
    }
}

#[test]
fn wrong_numbers_are_refused_with_their_name() {
    let good = *camera(Distortion::None).intrinsics();
    let bad = |pinhole: Pinhole| Camera::new(pinhole, Distortion::None).unwrap_err().to_string();
    assert!(bad(Pinhole { width: 0, ..good }).contains("0×480"));
    assert!(bad(Pinhole { fx: -420.0, ..good }).contains("fx = -420"));
    assert!(bad(Pinhole { fy: f64::NAN, ..good }).contains("fy = NaN"));
    assert!(bad(Pinhole { cx: 700.0, ..good }).contains("cx = 700"));
    assert!(bad(Pinhole { cy: f64::NAN, ..good }).contains("cy = NaN"));
    assert!(RadTan::new(&[0.0; 6]).unwrap_err().to_string().contains("not 6"));
    assert!(RadTan::new(&[0.0, f64::NAN, 0.0, 0.0]).unwrap_err().to_string().contains("term 1"));
    let huge = RadTan::new(&[1e300, 0.0, 0.0, 0.0, 0.0, 1e300, 0.0, 0.0]);
    assert!(huge.unwrap_err().to_string().contains("at most 1e12"), "its polynomials overflow");
    assert!(KannalaBrandt::new(&[0.0; 5]).is_err());
    assert!(Fov::new(&[0.0]).is_err());
    assert!(Fov::new(&[3.2]).is_err());
}

#[test]
fn radtan_keeps_its_terms() {
    for terms in [&[0.1, 0.2, 0.3, 0.4][..], &[0.1, 0.2, 0.3, 0.4, 0.5], &[1., 2., 3., 4., 5., 6., 7., 8.]] {
        assert_eq!(RadTan::new(terms).unwrap().terms(), terms);
    }
}
