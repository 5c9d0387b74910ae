use super::*;
use geometry::Pyramid;

fn textured(dx: f32, dy: f32, gain: f32, offset: f32) -> GrayImage {
    let mut image = GrayImage::filled(96, 80, 0);
    for y in 0..80 {
        for x in 0..96 {
            let (u, v) = (x as f32 - dx, y as f32 - dy);
            let value = 110.0 + 40.0 * (0.35 * u + 0.1 * v).sin() + 35.0 * (0.27 * v - 0.12 * u).cos();
            image.set(x, y, (gain * value + offset).round() as u8);
        }
    }
    image
}

#[test]
fn finds_a_shift_under_a_brightness_change() {
    let host = Pyramid::new(textured(0.0, 0.0, 1.0, 0.0), 1);
    let view = Pyramid::new(textured(1.37, -0.81, 1.1, -12.0), 1);
    let template = Template::cut(&host, [40.0, 36.0], &Warp::identity()).unwrap();
    let found = template.align(&view, [40.0, 36.0], 5.0, 20).unwrap();
    assert!((found.pixel[0] - 41.37).abs() < 0.03, "{found:?}");
    assert!((found.pixel[1] - 35.19).abs() < 0.03, "{found:?}");
    assert!(found.rmse < 1.5 && found.unexplained < 0.01, "{found:?}");
}

#[test]
fn refuses_a_flat_patch_and_one_outside() {
    let flat = Pyramid::new(GrayImage::filled(64, 64, 90), 1);
    let template = Template::cut(&flat, [30.0, 30.0], &Warp::identity()).unwrap();
    assert!(template.align(&flat, [30.0, 30.0], 5.0, 10).is_none());
    assert!(Template::cut(&flat, [2.0, 30.0], &Warp::identity()).is_none());
}
