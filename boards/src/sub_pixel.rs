//! Corners to a fraction of a pixel.

use geometry::GrayImage;
use nalgebra::{Matrix2, Vector2};

/// Rounds after which a corner stays where it is.
const ROUNDS: usize = 60;
/// A step below this ends the search, pixels.
const SMALL_STEP: f64 = 1e-4;

/// The saddle points and corners of the image near `corners`; looks `radius` pixels around each. One that would go
/// farther than that stays where it was.
///
/// At a corner every gradient around it is at right angles to the way from the corner to it (Förstner and Gülch 1987, as
/// OpenCV's `cornerSubPix` has it): the place where that holds best is taken, and the window moved there.
pub fn refined(image: &GrayImage, corners: &[Vector2<f64>], radius: usize) -> Vec<Vector2<f64>> {
    let window = Window::new(radius);
    corners.iter().map(|corner| window.refined(image, *corner).unwrap_or(*corner)).collect()
}

/// The saddle point or corner of the image near a place; `None` where there is none within `radius` pixels.
pub fn corner_near(image: &GrayImage, rough: Vector2<f64>, radius: usize) -> Option<Vector2<f64>> {
    Window::new(radius).refined(image, rough)
}

/// The pixels around a corner, with how much each counts.
struct Window {
    radius: i32,
    /// For each row and column of the window, from the outside to the middle and out again.
    weights: Vec<f64>,
}

impl Window {
    fn new(radius: usize) -> Self {
        let radius = radius.max(1) as i32;
        let weight = |i: i32| (-f64::from(i * i) / f64::from(radius * radius)).exp();
        Self { radius, weights: (-radius..=radius).map(weight).collect() }
    }

    fn refined(&self, image: &GrayImage, rough: Vector2<f64>) -> Option<Vector2<f64>> {
        let mut at = rough;
        for _ in 0..ROUNDS {
            let step = self.step(image, at)?;
            at += step;
            if !image.contains(at.x as f32, at.y as f32, 0.0) || step.norm() < SMALL_STEP {
                break;
            }
        }
        let moved = at - rough;
        (moved.amax() <= f64::from(self.radius)).then_some(at)
    }

    /// From `at` to where the gradients around it point from; `None` where they say nothing.
    fn step(&self, image: &GrayImage, at: Vector2<f64>) -> Option<Vector2<f64>> {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for (dy, weight_y) in (-self.radius..=self.radius).zip(&self.weights) {
            for (dx, weight_x) in (-self.radius..=self.radius).zip(&self.weights) {
                let offset = Vector2::new(f64::from(dx), f64::from(dy));
                let level = |x: f64, y: f64| level(image, at + offset + Vector2::new(x, y));
                let gradient =
                    Vector2::new(level(1.0, 0.0) - level(-1.0, 0.0), level(0.0, 1.0) - level(0.0, -1.0));
                let outer = gradient * gradient.transpose() * (weight_x * weight_y);
                normal += outer;
                right += outer * offset;
            }
        }
        // Without gradients, or with those of one edge alone, there is no corner.
        if normal.determinant() <= 1e-9 * normal.trace().powi(2) {
            return None;
        }
        Some(normal.try_inverse()? * right)
    }
}

/// Grey level between pixels; beyond the image that of its edge.
fn level(image: &GrayImage, at: Vector2<f64>) -> f64 {
    let inside = |value: f64, size: usize| value.clamp(0.0, size as f64 - 1.001) as f32;
    f64::from(image.bilinear(inside(at.x, image.width()), inside(at.y, image.height())))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four squares that meet at a place, each pixel the mean of its area.
    fn saddle(place: Vector2<f64>, angle: f64) -> GrayImage {
        let (u, v) = (Vector2::new(angle.cos(), angle.sin()), Vector2::new(-angle.sin(), angle.cos()));
        let mut image = GrayImage::filled(40, 40, 0);
        for (i, pixel) in image.data_mut().iter_mut().enumerate() {
            let mut sum = 0.0;
            for k in 0..64 {
                let sub = |k: usize| (k as f64 + 0.5) / 8.0 - 0.5;
                let offset = Vector2::new((i % 40) as f64 + sub(k % 8), (i / 40) as f64 + sub(k / 8)) - place;
                sum += if offset.dot(&u) * offset.dot(&v) > 0.0 { 30.0 } else { 220.0 };
            }
            *pixel = (sum / 64.0_f64).round() as u8;
        }
        image
    }

    #[test]
    fn a_saddle_is_found_to_a_twentieth_of_a_pixel() {
        for (x, y, angle) in [(20.0, 20.0, 0.0), (19.3, 20.45, 0.2), (20.8, 18.9, 0.7)] {
            let place = Vector2::new(x, y);
            let image = saddle(place, angle);
            for rough in [Vector2::new(1.0, -0.7), Vector2::new(-1.2, 0.4)] {
                let found = refined(&image, &[place + rough], 5)[0];
                assert!((found - place).norm() < 0.05, "{found} for {place}");
            }
        }
    }

    #[test]
    fn where_there_is_no_corner_nothing_moves() {
        let mut edge = GrayImage::filled(40, 40, 0);
        edge.data_mut().iter_mut().enumerate().for_each(|(i, p)| *p = if i % 40 < 20 { 30 } else { 220 });
        let rough = Vector2::new(18.0, 15.0);
        assert_eq!(refined(&edge, &[rough], 5)[0], rough);
        assert_eq!(corner_near(&edge, rough, 5), None);
        assert_eq!(refined(&GrayImage::filled(40, 40, 0), &[rough], 5)[0], rough);
    }
}
