//! Corners to a fraction of a pixel.

use nalgebra::Vector2;
use opencv::core::{Mat, Point2f, Size, TermCriteria, TermCriteria_EPS, TermCriteria_MAX_ITER, Vector};
use opencv::imgproc::corner_sub_pix;

/// The saddle points of the image near `corners`; looks `radius` pixels around each.
///
/// # Errors
/// When OpenCV fails, as it does for corners outside the image.
pub fn refined(image: &Mat, corners: &[Vector2<f64>], radius: i32) -> opencv::Result<Vec<Vector2<f64>>> {
    let points = corners.iter().map(|corner| Point2f::new(corner.x as f32, corner.y as f32));
    let mut points: Vector<Point2f> = points.collect();
    let end = TermCriteria { typ: TermCriteria_EPS + TermCriteria_MAX_ITER, max_count: 60, epsilon: 1e-4 };
    corner_sub_pix(image, &mut points, Size::new(radius, radius), Size::new(-1, -1), end)?;
    Ok(points.iter().map(|point| vector(&point)).collect())
}

/// A point of OpenCV's.
pub fn vector(point: &Point2f) -> Vector2<f64> {
    Vector2::new(f64::from(point.x), f64::from(point.y))
}
