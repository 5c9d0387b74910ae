//! The distortion that remains in images that were undistorted by a calibration, and its correction.
//!
//! A calibration that is wrong by a pixel at the image's border makes the scale of a map drift when driving. Points
//! are first seen near the middle and last at the border, so each step is measured by others that are a little too
//! long or too short, always in the same sense (Krešo & Šegvić, VISAPP 2015, on the KITTI cameras). Points that are
//! seen from many places determine this error, so the joint optimisation solves for it.

use crate::{Camera, Pinhole};
use nalgebra::{Matrix2, Vector2, Vector3};

/// Unknowns of a lens.
pub const TERMS: usize = 1;

/// Places along each side of an image where a camera's distortion is looked at.
const GRID: usize = 25;

/// The camera as its images show it: `x = x' (1 + a ρ)`. x' is a point on the image plane at z = 1 by the
/// calibration, and ρ its squared distance from the axis over that of the image's corner. So `a` is the shift of the
/// corner, as a share of its distance from the middle.
///
/// The focal length is not solved for. Motion straight ahead does not determine it, and scenes with an exactly known
/// camera came out worse with a free focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// The camera by the calibration.
    pub camera: Pinhole,
    /// `a` of the formula above.
    pub terms: [f64; TERMS],
    /// One over the squared distance of the image's corner from the axis, at z = 1.
    per_corner: f64,
}

impl Lens {
    /// A lens without remaining distortion.
    pub fn ideal(camera: Pinhole) -> Self {
        let (x, y) = (0.5 * camera.width as f64 / camera.fx, 0.5 * camera.height as f64 / camera.fy);
        Self { camera, terms: [0.0; TERMS], per_corner: 1.0 / (x * x + y * y) }
    }

    /// The lens nearest to the distortion of a camera over its whole image, and the largest remaining error, as a
    /// share of the corner's distance from the middle. `None` where the camera has no ray for a part of its image.
    pub fn nearest(camera: &Camera) -> Option<(Self, f64)> {
        let lens = Self::ideal(*camera.intrinsics());
        let Pinhole { width, height, .. } = lens.camera;
        let grid = |i: usize, side: usize| (side as f64 - 1.0) * i as f64 / (GRID - 1) as f64;
        let moved = |i: usize| {
            let pixel = Vector2::new(grid(i % GRID, width), grid(i / GRID, height));
            let ray = camera.unproject(&pixel).filter(|ray| ray.z > 0.0)?;
            let [by_term] = lens.by_terms(pixel.into());
            Some((by_term, lens.camera.project(&ray) - pixel))
        };
        let all: Vec<_> = (0..GRID * GRID).map(moved).collect::<Option<_>>()?;
        let squares: f64 = all.iter().map(|(by_term, _)| by_term.norm_squared()).sum();
        let term = all.iter().map(|(by_term, moved)| by_term.dot(moved)).sum::<f64>() / squares;
        let missed = all.iter().map(|(by_term, moved)| (moved - by_term * term).norm()).fold(0.0, f64::max);
        let corner = 0.5 * (width as f64).hypot(height as f64);
        Some((Self { terms: [term], ..lens }, missed / corner))
    }

    /// The terms as they are written with a map: the shortest text that reads as the same number.
    pub fn to_text(self) -> String {
        let [term] = self.terms;
        format!("{term:?}")
    }

    /// The lens of these terms; `None` where the text has none.
    pub fn from_text(camera: Pinhole, text: &str) -> Option<Self> {
        let term: f64 = text.parse().ok()?;
        term.is_finite().then(|| Self { terms: [term], ..Self::ideal(camera) })
    }

    /// Share of its distance from the middle by which a point at distance one of the image plane moves.
    pub(super) fn bend(&self) -> f64 {
        self.terms[0] * self.per_corner
    }

    /// The distance of a pixel from the middle, as a share of the corner's.
    pub fn share_of_corner(&self, pixel: [f64; 2]) -> f64 {
        (self.plane(pixel).norm_squared() * self.per_corner).sqrt()
    }

    /// How far an ideal camera sees the image's corner farther from the middle than the image shows it, pixels.
    pub(super) fn corner_shift(&self) -> f64 {
        let (width, height) = (self.camera.width as f64, self.camera.height as f64);
        self.terms[0] * 0.5 * width.hypot(height)
    }

    #[inline(always)]
    fn is_ideal(&self) -> bool {
        let [radial] = self.terms;
        radial == 0.0
    }

    #[inline(always)]
    fn plane(&self, pixel: [f64; 2]) -> Vector2<f64> {
        let c = &self.camera;
        Vector2::new((pixel[0] - c.cx) / c.fx, (pixel[1] - c.cy) / c.fy)
    }

    #[inline(always)]
    fn pixel(&self, plane: Vector2<f64>) -> [f64; 2] {
        let c = &self.camera;
        [c.fx * plane.x + c.cx, c.fy * plane.y + c.cy]
    }

    #[inline(always)]
    fn factor(&self, rho: f64) -> f64 {
        1.0 + self.terms[0] * rho
    }

    /// Where an ideal pinhole camera sees what the image shows at `pixel`.
    #[inline(always)]
    pub fn undistort(&self, pixel: [f64; 2]) -> [f64; 2] {
        if self.is_ideal() {
            return pixel;
        }
        let plane = self.plane(pixel);
        self.pixel(plane * self.factor(plane.norm_squared() * self.per_corner))
    }

    /// Where the image shows what an ideal pinhole camera sees at `pixel`; exact to 1e-6 of the distortion's square.
    #[inline(always)]
    pub fn distort(&self, pixel: [f64; 2]) -> [f64; 2] {
        if self.is_ideal() {
            return pixel;
        }
        let ideal = self.plane(pixel);
        let mut distorted = ideal;
        for _ in 0..4 {
            distorted = ideal / self.factor(distorted.norm_squared() * self.per_corner).max(0.1);
        }
        self.pixel(distorted)
    }

    /// The ray through what the image shows at `pixel`, z = 1.
    pub fn ray(&self, pixel: [f64; 2]) -> Vector3<f64> {
        let [x, y] = self.undistort(pixel);
        self.camera.unproject(x, y)
    }

    /// Derivatives of [`Lens::undistort`] by the terms, pixels.
    pub fn by_terms(&self, pixel: [f64; 2]) -> [Vector2<f64>; TERMS] {
        let plane = self.plane(pixel);
        let moved = Vector2::new(self.camera.fx * plane.x, self.camera.fy * plane.y);
        [moved * (plane.norm_squared() * self.per_corner)]
    }

    /// Derivative of [`Lens::undistort`] by the pixel; like pixels of equal size along x and y.
    pub fn magnification(&self, pixel: [f64; 2]) -> Matrix2<f64> {
        let plane = self.plane(pixel);
        let rho = plane.norm_squared() * self.per_corner;
        let radial = plane * plane.transpose() * (2.0 * self.terms[0] * self.per_corner);
        Matrix2::identity() * self.factor(rho) + radial
    }

    /// Derivatives of [`Lens::magnification`] by the terms.
    pub fn magnification_by_terms(&self, pixel: [f64; 2]) -> [Matrix2<f64>; TERMS] {
        let plane = self.plane(pixel);
        let rho = plane.norm_squared() * self.per_corner;
        [Matrix2::identity() * rho + plane * plane.transpose() * (2.0 * self.per_corner)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Distortion, RadTan};

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 420.0, cx: 310.0, cy: 250.0 };

    fn bent() -> Lens {
        Lens { terms: [-0.03], ..Lens::ideal(CAMERA) }
    }

    #[test]
    fn distortion_is_undone() {
        let (ideal, bent) = (Lens::ideal(CAMERA), bent());
        for pixel in [[310.0, 250.0], [0.0, 0.0], [639.0, 10.0], [200.0, 400.0]] {
            assert_eq!(ideal.undistort(pixel), pixel);
            assert_eq!(ideal.distort(pixel), pixel);
            let back = bent.distort(bent.undistort(pixel));
            assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-3, "{pixel:?} {back:?}");
        }
        let corner = bent.undistort([630.0, 490.0]);
        let moved = (corner[0] - 310.0) / 320.0;
        assert!((moved - (1.0 - 0.03)).abs() < 1e-12, "a corner moves by its share: {moved}");
    }

    #[test]
    fn the_nearest_lens_is_that_of_a_weak_distortion_and_misses_a_strong_one() {
        let nearest_of = |pinhole: Pinhole, terms: [f64; 4]| {
            let distortion = Distortion::RadTan(RadTan::new(&terms).expect("finite terms"));
            Lens::nearest(&Camera::new(pinhole, distortion).expect("a camera"))
        };
        let nearest = |terms| nearest_of(CAMERA, terms).expect("rays everywhere");
        let (lens, missed) = nearest([0.02, 0.0, 0.0, 0.0]);
        let corner = (320.0f64 / 420.0).powi(2) + (240.0f64 / 420.0).powi(2);
        assert!((lens.terms[0] + 0.02 * corner).abs() < 1e-3, "{lens:?}");
        assert!(missed < 5e-4, "{missed}");
        // Of a Kinect: outwards half-way, and back at the corner.
        let kinect = [0.13, -0.21, 0.0, 0.0];
        let (_, missed) =
            nearest_of(Pinhole { fx: 520.0, fy: 520.0, ..CAMERA }, kinect).expect("rays everywhere");
        assert!(missed > 0.01, "{missed}");
        assert_eq!(nearest_of(CAMERA, kinect), None, "at a wider view it turns back before the corner");
        let (lens, missed) = nearest([0.0; 4]);
        assert!(lens.terms[0].abs() < 1e-9 && missed < 1e-9, "{lens:?} {missed}");
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let lens = bent();
        let (pixel, h) = ([100.0, 420.0], 1e-5);
        for k in 0..TERMS {
            let moved = |by: f64| {
                let mut lens = lens;
                lens.terms[k] += by;
                (Vector2::from(lens.undistort(pixel)), lens.magnification(pixel))
            };
            let (plus, minus) = (moved(h), moved(-h));
            assert!(((plus.0 - minus.0) / (2.0 * h) - lens.by_terms(pixel)[k]).norm() < 1e-5);
            assert!(((plus.1 - minus.1) / (2.0 * h) - lens.magnification_by_terms(pixel)[k]).norm() < 1e-6);
        }
        let along = |x: f64, y: f64| Vector2::from(lens.undistort([pixel[0] + x, pixel[1] + y]));
        let columns =
            [(along(h, 0.0) - along(-h, 0.0)) / (2.0 * h), (along(0.0, h) - along(0.0, -h)) / (2.0 * h)];
        assert!((Matrix2::from_columns(&columns) - lens.magnification(pixel)).norm() < 1e-6);
    }
}
