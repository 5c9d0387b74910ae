//! Epipolar geometry of a keyframe and a reference, and the search along the line.

use geometry::{GrayImage, Pinhole, Se3};
use nalgebra::{Matrix3, Vector3};

/// Template samples on either side of the pixel; the outermost only serve the gradients.
pub(super) const RADIUS: usize = 3;
/// Samples of the template, one pixel apart along the epipolar line.
pub(super) const TEMPLATE: usize = 2 * RADIUS + 1;
/// Samples compared: the design's five.
pub(super) const COMPARED: usize = TEMPLATE - 2;
/// Steps by which a search runs beyond its range on either side.
const PADDING: usize = 2;
/// Most positions of one search.
const MAX_POSITIONS: usize = 112;
/// Most samples of one search.
const MAX_SAMPLES: usize = MAX_POSITIONS + COMPARED - 1;

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

/// A line in the reference: positions `origin + μ · step`, μ in template samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    /// Position of μ = 0, pixels.
    pub origin: [f32; 2],
    /// One template sample, about a pixel.
    pub step: [f32; 2],
}

impl Line {
    /// The pixel at `mu`.
    #[inline]
    pub fn at(&self, mu: f32) -> [f32; 2] {
        [self.origin[0] + mu * self.step[0], self.origin[1] + mu * self.step[1]]
    }

    /// Whether all samples from `from` to `to` lie inside `image`.
    #[inline]
    pub fn inside(&self, image: &GrayImage, from: f32, to: f32) -> bool {
        let (a, b) = (self.at(from), self.at(to));
        image.contains(a[0], a[1], 1.0) && image.contains(b[0], b[1], 1.0)
    }

    /// Intensities at `mu`, `mu + 1`, …; the caller has made sure that all are inside.
    #[inline]
    pub fn sample(&self, image: &GrayImage, mu: f32, out: &mut [f32]) {
        for (k, value) in out.iter_mut().enumerate() {
            let [x, y] = self.at(mu + k as f32);
            *value = image.bilinear(x, y);
        }
    }
}

/// The outcome of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Search {
    /// The best position μ of the template's centre, to a fraction of a step.
    Found(f32),
    /// The line leaves the image.
    Outside,
    /// The range is longer than allowed.
    TooLong,
    /// Another position fits about as well, or the best one lies at the end of the range.
    Ambiguous,
}

/// Searches `μ ∈ [0, length]` on `line` for the least sum of squared differences to `template`
/// (its inner [`COMPARED`] samples).
///
/// `floor` is the sum expected from noise alone: minima below it cannot be told apart.
pub(super) fn search(
    image: &GrayImage,
    line: &Line,
    length: f32,
    template: &[f32; TEMPLATE],
    uniqueness: f32,
    floor: f32,
) -> Search {
    let positions = length.ceil() as usize + 1 + 2 * PADDING;
    if positions > MAX_POSITIONS {
        return Search::TooLong;
    }
    let half = (COMPARED / 2) as f32;
    let first = -(PADDING as f32) - half;
    if !line.inside(image, first, first + (positions + COMPARED - 2) as f32) {
        return Search::Outside;
    }
    let mut samples = [0.0f32; MAX_SAMPLES];
    let samples = &mut samples[..positions + COMPARED - 1];
    line.sample(image, first, samples);
    let mut sums = [0.0f32; MAX_POSITIONS];
    let sums = &mut sums[..positions];
    for (j, &value) in template[1..=COMPARED].iter().enumerate() {
        for (sum, &sample) in sums.iter_mut().zip(&samples[j..]) {
            let difference = sample - value;
            *sum += difference * difference;
        }
    }
    let mut best = 0;
    for (k, &sum) in sums.iter().enumerate() {
        if sum < sums[best] {
            best = k;
        }
    }
    if best == 0 || best == positions - 1 {
        return Search::Ambiguous;
    }
    let limit = uniqueness * sums[best].max(floor);
    let rival = |k: usize| sums[k] < limit && sums[k] <= sums[k - 1] && sums[k] <= sums[k + 1];
    if (1..positions - 1).any(|k| k.abs_diff(best) >= 2 && rival(k)) {
        return Search::Ambiguous;
    }
    let (before, here, after) = (sums[best - 1], sums[best], sums[best + 1]);
    let curvature = before - 2.0 * here + after;
    let offset = if curvature > 1e-6 { 0.5 * (before - after) / curvature } else { 0.0 };
    Search::Found(best as f32 - PADDING as f32 + offset.clamp(-0.5, 0.5))
}
