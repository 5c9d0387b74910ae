//! How far two cameras are apart, in pixels.

use geometry::{Camera, Distortion, Pinhole, RadTan};
use nalgebra::{Matrix3, Rotation3, Vector2};

/// How far rays land in one camera from where another one has them, once the cameras are turned to agree best: a turned
/// camera sees the same world, so that part of a difference harms nobody.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Apart {
    /// A tenth of the side and more from the image's border. Farther out few corners of a board are ever seen, so lens
    /// models are free to differ.
    pub inner: Distance,
    /// Over the whole image.
    pub whole: Distance,
}

/// Distances, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// The largest.
    pub most: f64,
    /// Root mean square.
    pub rms: f64,
}

/// Compares two cameras; `None` where one of them has no ray for a pixel.
pub fn apart(known: &Camera, other: &Camera, size: [usize; 2]) -> Option<Apart> {
    let pixels = inner(size);
    let ray = |camera: &Camera, pixel| Some(camera.unproject(pixel)?.normalize());
    let mut products = Matrix3::zeros();
    for pixel in &pixels {
        products += ray(other, pixel)? * ray(known, pixel)?.transpose();
    }
    let rotation = Rotation3::from_matrix_eps(&products, 1e-12, 100, Rotation3::identity());
    let of = |pixels: &[Vector2<f64>]| distance(known, other, &rotation, pixels);
    Some(Apart { inner: of(&pixels)?, whole: of(&grid(size))? })
}

/// How far the two cameras are apart at most at the image's border, as they stand, pixels.
pub fn at_border(known: &Camera, other: &Camera, size: [usize; 2]) -> Option<f64> {
    Some(distance(known, other, &Rotation3::identity(), &border(size))?.most)
}

/// How far the rays through the known camera's pixels land from there in the other, turned camera.
fn distance(
    known: &Camera,
    other: &Camera,
    other_from_known: &Rotation3<f64>,
    pixels: &[Vector2<f64>],
) -> Option<Distance> {
    let apart = |pixel: &Vector2<f64>| {
        Some((other.project(&(other_from_known * known.unproject(pixel)?))? - pixel).norm())
    };
    let all = pixels.iter().map(apart).collect::<Option<Vec<f64>>>()?;
    let squares: f64 = all.iter().map(|distance| distance * distance).sum();
    let most = all.iter().copied().reduce(f64::max)?;
    Some(Distance { most, rms: (squares / all.len() as f64).sqrt() })
}

/// Steps of the grid of pixels along a side.
const STEPS: usize = 16;

/// Pixels all over the image.
fn grid([width, height]: [usize; 2]) -> Vec<Vector2<f64>> {
    let at = |i: usize, side: usize| i as f64 / STEPS as f64 * (side as f64 - 1.0);
    let row = |y: usize| (0..=STEPS).map(move |x| Vector2::new(at(x, width), at(y, height)));
    (0..=STEPS).flat_map(row).collect()
}

/// Those that are a tenth of the side or more from the border.
fn inner(size: [usize; 2]) -> Vec<Vector2<f64>> {
    let is_inner = |at: f64, side: usize| (0.1..=0.9).contains(&(at / (side as f64 - 1.0)));
    let inner = |pixel: &Vector2<f64>| is_inner(pixel.x, size[0]) && is_inner(pixel.y, size[1]);
    grid(size).into_iter().filter(inner).collect()
}

/// Those at its border.
fn border(size: [usize; 2]) -> Vec<Vector2<f64>> {
    let is_end = |i: usize| i == 0 || i == STEPS;
    let at_border = |i: usize| is_end(i / (STEPS + 1)) || is_end(i % (STEPS + 1));
    grid(size).into_iter().enumerate().filter(|(i, _)| at_border(*i)).map(|(_, pixel)| pixel).collect()
}

/// The camera with fx, fy, cx, cy and all terms of its lens; `None` when there are only the first four.
pub fn camera([width, height]: [usize; 2], values: &[f64]) -> Option<Camera> {
    let [fx, fy, cx, cy, terms @ ..] = values else { return None };
    if terms.is_empty() {
        return None;
    }
    let pinhole = Pinhole { width, height, fx: *fx, fy: *fy, cx: *cx, cy: *cy };
    Camera::new(pinhole, Distortion::RadTan(RadTan::new(terms).ok()?)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: [f64; 8] = [458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76e-5];

    #[test]
    fn a_rotation_is_no_difference() {
        let values = [2000.0, 2000.0, 100.0, 50.0, 0.0, 0.0, 0.0, 0.0];
        let shifted = [2000.0, 2000.0, 105.0, 47.0, 0.0, 0.0, 0.0, 0.0];
        let [known, other] = [values, shifted].map(|values| camera([200, 100], &values).unwrap());
        // Seen through so long a lens, a shift is a turn.
        let apart = apart(&known, &other, [200, 100]).unwrap();
        assert!(apart.inner.most < 0.05 && apart.whole.most < 0.1, "{apart:?}");
        assert!((at_border(&known, &other, [200, 100]).unwrap() - 34f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn a_longer_lens_moves_what_is_far_from_the_middle() {
        let size = [752, 480];
        let known = camera(size, &LENS).unwrap();
        let mut values = LENS;
        (values[0], values[1]) = (values[0] * 1.01, values[1] * 1.01);
        let found = apart(&known, &camera(size, &values).unwrap(), size).unwrap();
        assert!(found.inner.rms < found.inner.most && found.inner.most < found.whole.most, "{found:?}");
        // One percent of the distance from the principal point.
        assert!((found.whole.most - 4.5).abs() < 0.3 && (found.inner.rms - 2.1).abs() < 0.3, "{found:?}");
        assert_eq!(border(size).len(), 4 * STEPS);
    }
}
