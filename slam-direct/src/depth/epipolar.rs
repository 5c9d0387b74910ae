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
    iz: f32,
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
    #[inline]
    pub fn direction(&self, x: f32, y: f32) -> [f32; 2] {
        let [ex, ey, ez] = self.epipole;
        [ex - x * ez, ey - y * ez]
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
    pub fn project(&self, ray: &Ray, d: f32) -> Option<Projection> {
        let [ax, ay, az] = ray.at_infinity;
        let [bx, by, bz] = self.shift;
        let z = az + d * bz;
        let iz = 1.0 / z;
        (z > MIN_DEPTH_RATIO).then_some(Projection { u: [(ax + d * bx) * iz, (ay + d * by) * iz], iz })
    }

    /// Step in the reference for one pixel along the line in the keyframe, depth held.
    #[inline]
    pub fn step(&self, ray: &Ray, at: &Projection) -> [f32; 2] {
        [0, 1].map(|i: usize| (ray.along[i] - at.u[i] * ray.along[2]) * at.iz)
    }

    /// Motion of the image per inverse depth, pixels · keyframe unit.
    #[inline]
    pub fn velocity(&self, at: &Projection) -> [f32; 2] {
        [0, 1].map(|i: usize| (self.shift[i] - at.u[i] * self.shift[2]) * at.iz)
    }

    /// Inverse depth of the ray seen at `u`, from the coordinate that moves more with depth.
    #[inline]
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

/// Fractional bits of positions along a line.
const POSITION_BITS: u32 = 16;
/// Fractional bits of interpolation weights: with an intensity's 8 bits they fill a lane of 16.
const WEIGHT_BITS: u32 = 8;

impl Line {
    /// The pixel at `mu`.
    #[inline]
    pub fn at(&self, mu: f32) -> [f32; 2] {
        [self.origin[0] + mu * self.step[0], self.origin[1] + mu * self.step[1]]
    }

    /// Bilinear intensities at `mu`, `mu + 1`, … into `out`; false (and nothing written) when one of them
    /// would lie less than a pixel inside the image.
    ///
    /// Positions and weights are fixed-point, exact to 2⁻⁸ of a pixel.
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
        const SCALE: f32 = 1.0 / (1u32 << (2 * WEIGHT_BITS)) as f32;
        for value in out {
            let i = (y >> POSITION_BITS) as usize * width + (x >> POSITION_BITS) as usize;
            debug_assert!(i + width + 1 < data.len());
            // SAFETY: both ends lie a pixel or more inside the image, steps are rounded by less than 2⁻¹⁶ and
            // there are at most 2¹⁰ of them, so every position keeps its four neighbours inside the image.
            let (top, bottom) = unsafe { (pair(data, i), pair(data, i + width)) };
            let fx = weight(x);
            let fy = weight(y);
            let both = top * ((1 << WEIGHT_BITS) - fy) + bottom * fy;
            let (left, right) = ((both & 0xffff) as i32, (both >> 16) as i32);
            *value = ((left << WEIGHT_BITS) + fx as i32 * (right - left)) as f32 * SCALE;
            x += dx;
            y += dy;
        }
        true
    }
}

/// The interpolation weight of a fixed-point position.
#[inline]
fn weight(position: i32) -> u32 {
    (position as u32 >> (POSITION_BITS - WEIGHT_BITS)) & ((1 << WEIGHT_BITS) - 1)
}

/// The neighbours `i` and `i + 1` in the lower and upper 16 bits.
///
/// # Safety
/// `i + 1` must lie within `data`.
#[inline]
unsafe fn pair(data: &[u8], i: usize) -> u32 {
    // SAFETY: the caller's promise.
    let bytes = unsafe { [*data.get_unchecked(i), *data.get_unchecked(i + 1)] };
    bytes[0] as u32 | (bytes[1] as u32) << 16
}
