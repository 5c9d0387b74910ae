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

    /// Unit direction of the epipolar line through keyframe pixel `(x, y)`; `None` at the epipole.
    #[inline]
    pub fn direction(&self, x: f32, y: f32) -> Option<[f32; 2]> {
        let [ex, ey, ez] = self.epipole;
        let (lx, ly) = (ex - x * ez, ey - y * ez);
        let norm2 = lx * lx + ly * ly;
        let inverse = 1.0 / norm2.sqrt();
        (norm2 > 1e-12).then_some([lx * inverse, ly * inverse])
    }

    /// The ray of keyframe pixel `(x, y)`, with the change of its image along `direction`.
    #[inline]
    pub fn ray(&self, x: f32, y: f32, direction: [f32; 2]) -> Ray {
        let h = &self.infinite_homography;
        let [lx, ly] = direction;
        let at_infinity = [0, 1, 2].map(|i: usize| h[i][0] * x + h[i][1] * y + h[i][2]);
        let along = [0, 1, 2].map(|i: usize| h[i][0] * lx + h[i][1] * ly);
        Ray { at_infinity, along }
    }

    /// Where a ray with inverse depth `d` is seen; `None` behind the camera.
    #[inline]
    pub fn project(&self, ray: &Ray, d: f32) -> Option<[f32; 2]> {
        let [ax, ay, az] = ray.at_infinity;
        let [bx, by, bz] = self.shift;
        let z = az + d * bz;
        let iz = 1.0 / z;
        (z > 0.05).then_some([(ax + d * bx) * iz, (ay + d * by) * iz])
    }

    /// Step in the reference at `u = u(p, d)` for one pixel along the line in the keyframe, depth held.
    #[inline]
    pub fn step(&self, ray: &Ray, u: [f32; 2], d: f32) -> [f32; 2] {
        let iz = 1.0 / (ray.at_infinity[2] + d * self.shift[2]);
        [(ray.along[0] - u[0] * ray.along[2]) * iz, (ray.along[1] - u[1] * ray.along[2]) * iz]
    }

    /// Inverse depth of the ray seen at `u`, from the coordinate that moves more with depth.
    #[inline]
    pub fn inverse_depth(&self, ray: &Ray, u: [f32; 2]) -> f32 {
        let [ax, ay, az] = ray.at_infinity;
        let [bx, by, bz] = self.shift;
        let (qx, qy) = (bx - u[0] * bz, by - u[1] * bz);
        if qx.abs() > qy.abs() { (u[0] * az - ax) / qx } else { (u[1] * az - ay) / qy }
    }

    /// Motion of the image per inverse depth at `u = u(p, d)`, pixels · keyframe unit.
    #[inline]
    pub fn velocity(&self, ray: &Ray, u: [f32; 2], d: f32) -> [f32; 2] {
        let [bx, by, bz] = self.shift;
        let iz = 1.0 / (ray.at_infinity[2] + d * bz);
        [(bx - u[0] * bz) * iz, (by - u[1] * bz) * iz]
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

/// Fractional bits of positions along a line.
const POSITION_BITS: u32 = 16;
/// Fractional bits of interpolation weights: two of them and 8 bits of intensity fit into 31.
const WEIGHT_BITS: u32 = 11;

impl Line {
    /// The pixel at `mu`.
    #[inline]
    pub fn at(&self, mu: f32) -> [f32; 2] {
        [self.origin[0] + mu * self.step[0], self.origin[1] + mu * self.step[1]]
    }

    /// Bilinear intensities at `mu`, `mu + 1`, … into `out`; false (and nothing written) when one of them
    /// would lie less than a pixel inside the image.
    ///
    /// Positions and weights are fixed-point, exact to 2⁻¹¹ of a pixel.
    #[inline]
    pub fn sample(&self, image: &GrayImage, mu: f32, out: &mut [f32]) -> bool {
        let (first, last) = (self.at(mu), self.at(mu + (out.len() as f32 - 1.0)));
        // NaN fails both tests; sizes above 2¹⁴ would overflow the fixed-point positions.
        let inside = image.contains(first[0], first[1], 1.0) && image.contains(last[0], last[1], 1.0);
        if !inside || image.width().max(image.height()) > 1 << 14 || out.len() > 1 << 10 {
            return false;
        }
        let one = (1u32 << POSITION_BITS) as f32;
        let (mut x, mut y) = ((first[0] * one) as i32, (first[1] * one) as i32);
        let (dx, dy) = ((self.step[0] * one) as i32, (self.step[1] * one) as i32);
        let (width, data) = (image.width(), image.data());
        let shift = POSITION_BITS - WEIGHT_BITS;
        let mask = (1i32 << WEIGHT_BITS) - 1;
        const SCALE: f32 = 1.0 / (1u32 << (2 * WEIGHT_BITS)) as f32;
        for value in out {
            let i = (y >> POSITION_BITS) as usize * width + (x >> POSITION_BITS) as usize;
            debug_assert!(i + width + 1 < data.len());
            // SAFETY: both ends lie a pixel or more inside the image, steps are rounded by less than 2⁻¹⁶ and
            // there are at most 2¹⁰ of them, so every position keeps its four neighbours inside the image.
            let [p00, p01, p10, p11] =
                unsafe { [i, i + 1, i + width, i + width + 1].map(|k| *data.get_unchecked(k) as i32) };
            let (fx, fy) = ((x >> shift) & mask, (y >> shift) & mask);
            let top = (p00 << WEIGHT_BITS) + fx * (p01 - p00);
            let bottom = (p10 << WEIGHT_BITS) + fx * (p11 - p10);
            *value = ((top << WEIGHT_BITS) + fy * (bottom - top)) as f32 * SCALE;
            x += dx;
            y += dy;
        }
        true
    }
}
