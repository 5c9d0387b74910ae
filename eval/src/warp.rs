//! True inverse depth for views that have none of their own, from one that has.

use geometry::{Image, Pinhole, Se3};
use nalgebra::{Matrix3, Vector3};

/// Inverse depth seen from a target camera, computed from that of a source camera; 0 where none is known.
///
/// Each source pixel carries the plane of its surface (from the inverse depths beside it, and inverse depth
/// is affine in the pixels of a plane), which is met with the ray of the target pixel it falls on, so that
/// the result is exact on planes. The nearest surface wins; pixels that no source pixel falls on stay empty.
pub fn warp_inverse_depth(source: &Image<f32>, camera: &Pinhole, target_from_source: &Se3) -> Image<f32> {
    let mut target = Image::filled(source.width(), source.height(), 0.0f32);
    let intrinsics = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
    for y in 0..source.height() {
        for x in 0..source.width() {
            let inverse_depth = f64::from(source.get(x, y));
            if inverse_depth <= 0.0 {
                continue;
            }
            let point = camera.unproject(x as f64, y as f64) / inverse_depth;
            let moved = *target_from_source * point;
            if moved.z <= 0.0 {
                continue;
            }
            let pixel = camera.project(&moved).map(f64::round);
            if !target.contains(pixel.x as f32, pixel.y as f32, 0.0) {
                continue;
            }
            let (dx, dy) = slopes(source, x, y);
            let offset = inverse_depth - dx * x as f64 - dy * y as f64;
            // normal · point = 1 for the points of the plane, first in the source frame.
            let normal =
                target_from_source.rotation * (intrinsics.transpose() * Vector3::new(dx, dy, offset));
            let ray = camera.unproject(pixel.x, pixel.y);
            let found = (normal.dot(&ray) / (1.0 + normal.dot(&target_from_source.translation))) as f32;
            let (tx, ty) = (pixel.x as usize, pixel.y as usize);
            if found.is_finite() && found > target.get(tx, ty) {
                target.set(tx, ty, found);
            }
        }
    }
    target
}

/// Change of inverse depth per pixel along x and y. The smaller of the two one-sided differences stays on
/// the pixel's own surface at the edge of an object.
fn slopes(image: &Image<f32>, x: usize, y: usize) -> (f64, f64) {
    let at = |x: usize, y: usize| Some(image.get(x, y)).filter(|&d| d > 0.0);
    let here = image.get(x, y);
    let least = |before: Option<f32>, after: Option<f32>| {
        let sides = [before.map(|d| here - d), after.map(|d| d - here)];
        sides.into_iter().flatten().min_by(|a, b| a.abs().total_cmp(&b.abs())).map_or(0.0, f64::from)
    };
    let left = x.checked_sub(1).and_then(|x| at(x, y));
    let right = (x + 1 < image.width()).then(|| at(x + 1, y)).flatten();
    let above = y.checked_sub(1).and_then(|y| at(x, y));
    let below = (y + 1 < image.height()).then(|| at(x, y + 1)).flatten();
    (least(left, right), least(above, below))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 50.0, fy: 50.0, cx: 31.5, cy: 23.5 };

    /// A wall at z = 4 and, right of x = 0, a tilted plane in front of it, seen from `camera_from_world`.
    fn render(camera_from_world: &Se3) -> Image<f32> {
        let world_from_camera = camera_from_world.inverse();
        let mut image = Image::filled(CAMERA.width, CAMERA.height, 0.0);
        for y in 0..CAMERA.height {
            for x in 0..CAMERA.width {
                let ray = world_from_camera.rotation * CAMERA.unproject(x as f64, y as f64);
                let origin = world_from_camera.translation;
                let meet = |normal: Vector3<f64>| (1.0 - normal.dot(&origin)) / normal.dot(&ray);
                let mut depth = meet(Vector3::new(0.0, 0.0, 0.25));
                let front = meet(Vector3::new(0.1, 0.2, 0.5));
                if (origin + ray * front).x > 0.0 {
                    depth = depth.min(front);
                }
                image.set(x, y, (1.0 / depth) as f32);
            }
        }
        image
    }

    #[test]
    fn a_warped_view_is_the_rendered_view() {
        let target_from_world = Se3::exp(&Vector6::new(-0.15, 0.05, 0.1, 0.02, -0.03, 0.05));
        let warped = warp_inverse_depth(&render(&Se3::identity()), &CAMERA, &target_from_world);
        let truth = render(&target_from_world);
        let pairs = || warped.data().iter().zip(truth.data()).filter(|(w, _)| **w > 0.0);
        let wrong = pairs().filter(|(w, t)| (*w / *t - 1.0).abs() > 1e-4).count();
        assert!(pairs().count() > 64 * 48 * 3 / 4, "{}", pairs().count());
        // Only along the edge of the front plane, where a pixel may fall on either side.
        assert!(wrong < 48 * 3, "{wrong} of {}", pairs().count());
    }
}
