//! Epipolar geometry of a keyframe and a reference, and the search along the line.

use geometry::{GrayImage, Pinhole, Se3};
use nalgebra::{Matrix3, Vector3};

/// Maps pixels of the keyframe with inverse depth to pixels of the reference:
/// `u(p, d) ~ K R K⁻¹ p + d · K t`.
#[derive(Clone, Debug)]
pub(super) struct EpipolarGeometry {
    /// `K R K⁻¹`, by rows.
    infinite_homography: [[f32; 3]; 3],
    /// `K t`.
    pub shift: [f32; 3],
    /// The reference's centre in the keyframe image, homogeneous pixels.
    epipole: [f32; 3],
}

/// A keyframe pixel's ray in the reference: homogeneous pixel at infinite depth, and its change along `l`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// `K R K⁻¹ p`.
    pub at_infinity: [f32; 3],
    /// `K R K⁻¹ (l, 0)`.
    along: [f32; 3],
}

/// Where a ray is seen in the reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    /// Pixel.
    pub u: [f32; 2],
    /// Depth in the keyframe over depth in the reference.
    pub iz: f32,
}

impl Projection {
    /// Whether the point lies in front of the reference, not too close.
    #[inline(always)]
    pub fn is_in_front(&self) -> bool {
        (self.iz > 0.0) & (self.iz < 1.0 / MIN_DEPTH_RATIO)
    }
}

/// Least depth in the reference over depth in the keyframe that still counts as in front.
const MIN_DEPTH_RATIO: f32 = 0.05;

impl EpipolarGeometry {
    /// The geometry of `frame_from_keyframe` for two images of `camera`.
    pub fn new(camera: &Pinhole, frame_from_keyframe: &Se3) -> Self {
        let k = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
        let k_inverse = Matrix3::new(
            1.0 / camera.fx,
            0.0,
            -camera.cx / camera.fx,
            0.0,
            1.0 / camera.fy,
            -camera.cy / camera.fy,
            0.0,
            0.0,
            1.0,
        );
        let h = k * frame_from_keyframe.rotation_matrix() * k_inverse;
        let row = |i: usize| [h[(i, 0)] as f32, h[(i, 1)] as f32, h[(i, 2)] as f32];
        let vector = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        Self {
            infinite_homography: [row(0), row(1), row(2)],
            shift: vector(k * frame_from_keyframe.translation),
            epipole: vector(k * frame_from_keyframe.inverse().translation),
        }
    }

    /// Direction of the epipolar line through keyframe pixel `(x, y)`, of any length; zero at the epipole.
    #[inline(always)]
    pub fn direction(&self, x: f32, y: f32) -> [f32; 2] {
        let [ex, ey, ez] = self.epipole;
        [ex - x * ez, ey - y * ez]
    }

    /// The ray of keyframe pixel `(x, y)`, with the change of its image along `direction`.
    #[inline(always)]
    pub fn ray(&self, x: f32, y: f32, direction: [f32; 2]) -> Ray {
        let h = &self.infinite_homography;
        let [lx, ly] = direction;
        let at_infinity = [0, 1, 2].map(|i: usize| h[i][0] * x + h[i][1] * y + h[i][2]);
        let along = [0, 1, 2].map(|i: usize| h[i][0] * lx + h[i][1] * ly);
        Ray { at_infinity, along }
    }

    /// Where a ray with inverse depth `d` is seen; check [`Projection::is_in_front`].
    #[inline(always)]
    pub fn project(&self, ray: &Ray, d: f32) -> Projection {
        let [ax, ay, az] = ray.at_infinity;
        let [bx, by, bz] = self.shift;
        let iz = 1.0 / (az + d * bz);
        Projection { u: [(ax + d * bx) * iz, (ay + d * by) * iz], iz }
    }

    /// Step in the reference for one pixel along the line in the keyframe, depth held.
    #[inline(always)]
    pub fn step(&self, ray: &Ray, at: &Projection) -> [f32; 2] {
        [0, 1].map(|i: usize| (ray.along[i] - at.u[i] * ray.along[2]) * at.iz)
    }

    /// Inverse depth of the ray seen at `u`, from the coordinate that moves more with depth.
    #[inline(always)]
    pub fn inverse_depth(&self, ray: &Ray, u: [f32; 2]) -> f32 {
        let [ax, ay, az] = ray.at_infinity;
        let [bx, by, bz] = self.shift;
        let (qx, qy) = (bx - u[0] * bz, by - u[1] * bz);
        if qx.abs() > qy.abs() { (u[0] * az - ax) / qx } else { (u[1] * az - ay) / qy }
    }
}

/// A line in an image: positions `origin + μ · step`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    /// Position of μ = 0, pixels.
    pub origin: [f32; 2],
    /// Step per unit of μ, pixels.
    pub step: [f32; 2],
}

/// Samples are taken in blocks of this many, so that the compiler can work on them side by side.
pub(super) const BLOCK: usize = 4;
/// Images up to this many pixels: their indices are exact in f32.
const MAX_PIXELS: usize = 1 << 24;

impl Line {
    /// The pixel at `mu`.
    #[inline(always)]
    pub fn at(&self, mu: f32) -> [f32; 2] {
        [self.origin[0] + mu * self.step[0], self.origin[1] + mu * self.step[1]]
    }

    /// Bilinear intensities at `mu`, `mu + 1`, … into `out`, a whole number of [`BLOCK`]s; false (and nothing
    /// written) when one of them would lie less than a pixel inside the image.
    #[inline(always)]
    pub fn sample(&self, image: &GrayImage, mu: f32, out: &mut [f32]) -> bool {
        debug_assert!(out.len().is_multiple_of(BLOCK));
        let (first, last) = (self.at(mu), self.at(mu + (out.len() as f32 - 1.0)));
        // NaN fails both tests.
        let inside = image.contains(first[0], first[1], 1.0) && image.contains(last[0], last[1], 1.0);
        if !inside || image.data().len() > MAX_PIXELS {
            return false;
        }
        for (block, values) in out.chunks_exact_mut(BLOCK).enumerate() {
            let start = mu + (block * BLOCK) as f32;
            // SAFETY: both ends of the line lie a pixel or more inside the image, so what lies between does.
            values.copy_from_slice(&unsafe { self.block(image, start) });
        }
        true
    }

    /// One block of [`Line::sample`].
    ///
    /// # Safety
    /// All its positions must lie inside the image, half a pixel or more from its border, and the image must
    /// have at most [`MAX_PIXELS`].
    #[inline(always)]
    unsafe fn block(&self, image: &GrayImage, mu: f32) -> [f32; BLOCK] {
        let (width, data) = (image.width(), image.data());
        let (mut dx, mut dy, mut index) = ([0.0f32; BLOCK], [0.0f32; BLOCK], [0i32; BLOCK]);
        for k in 0..BLOCK {
            let x = self.origin[0] + (mu + k as f32) * self.step[0];
            let y = self.origin[1] + (mu + k as f32) * self.step[1];
            // SAFETY: positions inside the image are finite, positive and small, and so is the index, which is
            // exact as the image has at most 2²⁴ pixels.
            unsafe {
                let (x0, y0) = (x.to_int_unchecked::<i32>() as f32, y.to_int_unchecked::<i32>() as f32);
                index[k] = (y0 * width as f32 + x0).to_int_unchecked::<i32>();
                (dx[k], dy[k]) = (x - x0, y - y0);
            }
        }
        let (mut top, mut bottom) = ([0i32; BLOCK], [0i32; BLOCK]);
        for k in 0..BLOCK {
            let i = index[k] as usize;
            debug_assert!(i + width + 1 < data.len());
            // SAFETY: the four neighbours of a position inside the image lie in it.
            unsafe {
                top[k] = pair(data, i);
                bottom[k] = pair(data, i + width);
            }
        }
        let mut values = [0.0f32; BLOCK];
        for k in 0..BLOCK {
            let (p00, p01) = ((top[k] & 255) as f32, (top[k] >> 8) as f32);
            let (p10, p11) = ((bottom[k] & 255) as f32, (bottom[k] >> 8) as f32);
            let upper = p00 + dx[k] * (p01 - p00);
            let lower = p10 + dx[k] * (p11 - p10);
            values[k] = upper + dy[k] * (lower - upper);
        }
        values
    }
}

/// The neighbours `i` and `i + 1` in the lower and upper byte.
///
/// # Safety
/// `i + 1` must lie within `data`.
#[inline(always)]
unsafe fn pair(data: &[u8], i: usize) -> i32 {
    // SAFETY: the caller's promise; bytes need no alignment.
    let bytes = unsafe { data.as_ptr().add(i).cast::<[u8; 2]>().read_unaligned() };
    u16::from_le_bytes(bytes) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 410.0, cx: 319.5, cy: 239.5 };

    proptest! {
        #[test]
        fn projection_is_the_cameras_and_inverts(
            x in 10.0f64..630.0, y in 10.0f64..470.0, d in 0.05f64..2.0,
            t in prop::array::uniform3(-0.2f64..0.2), r in prop::array::uniform3(-0.1f64..0.1),
        ) {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(r));
            let frame_from_keyframe = Se3::new(rotation, Vector3::from(t));
            let geometry = EpipolarGeometry::new(&CAMERA, &frame_from_keyframe);
            let point = frame_from_keyframe * (CAMERA.unproject(x, y) / d);
            let expected = CAMERA.project(&point);
            let ray = geometry.ray(x as f32, y as f32, [1.0, 0.0]);
            let seen = geometry.project(&ray, d as f32);
            prop_assert!((seen.u[0] as f64 - expected.x).abs() < 2e-2);
            prop_assert!((seen.u[1] as f64 - expected.y).abs() < 2e-2);
            // Near the epipole a pixel says little about depth.
            let moved = geometry.project(&ray, 1.1 * d as f32);
            prop_assume!((moved.u[0] - seen.u[0]).hypot(moved.u[1] - seen.u[1]) > 0.5);
            let back = geometry.inverse_depth(&ray, seen.u) as f64;
            prop_assert!((back - d).abs() < 1e-2 * d);
        }

        #[test]
        fn samples_are_bilinear(
            x in 30.0f32..60.0, y in 30.0f32..60.0, angle in 0.0f32..6.3, seed in 0u64..1000,
        ) {
            let mut random = geometry::Random::new(seed);
            let data = (0..96 * 90).map(|_| random.bits() as u8);
            let image = GrayImage::from_vec(96, 90, data.collect()).unwrap();
            let line = Line { origin: [x, y], step: [angle.cos(), angle.sin()] };
            let mut out = [0.0; 12];
            prop_assert!(line.sample(&image, -3.5, &mut out));
            for (k, value) in out.into_iter().enumerate() {
                let [u, v] = line.at(k as f32 - 3.5);
                prop_assert!((value - image.bilinear(u, v)).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn samples_outside_are_refused() {
        let image = GrayImage::filled(40, 30, 7);
        let mut out = [0.0; 8];
        for origin in [[36.0, 10.0], [0.5, 10.0], [10.0, 28.5], [f32::NAN, 10.0], [-1e30, 10.0]] {
            assert!(!Line { origin, step: [1.0, 0.0] }.sample(&image, 0.0, &mut out), "{origin:?}");
        }
        assert!(Line { origin: [31.0, 28.0], step: [1.0, 0.0] }.sample(&image, 0.0, &mut out));
    }
}
