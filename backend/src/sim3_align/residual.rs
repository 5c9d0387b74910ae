//! Residuals of one point and their Jacobians.

use super::level_depth::{DepthPoint, LevelDepth};
use super::{Sim3AlignParams, Vector9};
use geometry::{GrayImage, Pinhole, Sim3};
use nalgebra::{Matrix3, Vector3};

/// The unknowns.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// The similarity sought.
    pub target_from_source: Sim3,
    /// `(a, b)` of `target = e^a · source + b`.
    pub brightness: [f64; 2],
}

impl State {
    /// The state after a step (υ, ω, λ, a, b).
    pub(super) fn updated(&self, step: &Vector9) -> Self {
        let [a, b] = self.brightness;
        Self {
            target_from_source: Sim3::exp(&step.fixed_rows::<7>(0).into_owned()) * self.target_from_source,
            brightness: [a + step[7], b + step[8]],
        }
    }
}

/// Everything about a level that does not change between points.
pub(super) struct Projector<'a> {
    /// The source camera of the level.
    pub source_camera: Pinhole,
    /// The target camera of the level.
    pub target_camera: Pinhole,
    /// Target image of the level.
    pub image: &'a GrayImage,
    /// Target depth of the level.
    pub depth: &'a LevelDepth,
    /// `s·R` of `target_from_source`.
    pub scaled_rotation: Matrix3<f64>,
    /// Its translation.
    pub translation: Vector3<f64>,
    /// `e^a`.
    pub gain: f64,
    /// `b`.
    pub offset: f64,
    /// Variance of the photometric residual from image noise, both images.
    pub noise_variance: f64,
    /// Floor of the relative standard deviation of inverse depths.
    pub min_depth_sigma: f64,
}

/// Residuals of a point at a state. Jacobians are of the residuals, not of the weights.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointTerm {
    /// `I_target(p′) − (e^a I_source(p) + b)`, grey levels.
    pub photometric: f64,
    /// Its variance (Engel 2014, Eq. 13).
    pub photometric_variance: f64,
    /// Its derivative by (υ, ω, a, b); it does not depend on λ, which moves points along their rays.
    pub photometric_by: [f64; 8],
    /// The depth residual, where the target has a depth.
    pub depth: Option<DepthTerm>,
}

/// Depth residual of a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthTerm {
    /// `1/z′ − D_target(p′)`.
    pub residual: f64,
    /// Its variance (Engel 2014, Eq. 18).
    pub variance: f64,
    /// Its derivative by (υz, ωx, ωy, λ); by the others it is zero. The slope of the target's depth
    /// map is left out, as it is piecewise constant.
    pub by: [f64; 4],
}

impl<'a> Projector<'a> {
    /// A projector at a state, for the cameras of source and target at the level.
    pub(super) fn new(
        state: &State,
        [source_camera, target_camera]: [Pinhole; 2],
        image: &'a GrayImage,
        depth: &'a LevelDepth,
        params: &Sim3AlignParams,
    ) -> Self {
        let gain = state.brightness[0].exp();
        Self {
            source_camera,
            target_camera,
            image,
            depth,
            scaled_rotation: state.target_from_source.rigid().rotation_matrix()
                * state.target_from_source.scale,
            translation: state.target_from_source.translation,
            gain,
            offset: state.brightness[1],
            noise_variance: (1.0 + gain * gain) * params.image_noise * params.image_noise,
            min_depth_sigma: params.min_depth_sigma,
        }
    }

    /// Residuals of a source point of intensity `intensity`; `None` when it lies behind the target
    /// or outside its image.
    pub(super) fn evaluate(&self, point: &DepthPoint, intensity: u8) -> Option<PointTerm> {
        let d = point.inverse_depth as f64;
        let ray = self.source_camera.unproject(point.x as f64, point.y as f64);
        let turned = self.scaled_rotation * ray / d;
        let p = turned + self.translation;
        if p.z.is_nan() || p.z <= 1e-9 {
            return None;
        }
        let pixel = self.target_camera.project(&p);
        let (value, gx, gy) = sample(self.image, pixel.x, pixel.y)?;
        let inverse_z = 1.0 / p.z;
        // Derivative of the intensity by the point in the target's frame.
        let (gx, gy) = (gx * self.target_camera.fx * inverse_z, gy * self.target_camera.fy * inverse_z);
        let gz = -(gx * p.x + gy * p.y) * inverse_z;
        let scaled = self.gain * intensity as f64;
        // The point moves along its turned ray as d changes: ∂p/∂d = −turned / d.
        let by_d = -(gx * turned.x + gy * turned.y + gz * turned.z) / d;
        let source_variance = self.floored(point.variance as f64, d);
        let depth = self.depth.at(pixel.x.round() as usize, pixel.y.round() as usize).map(|target| {
            let target_d = target.inverse_depth as f64;
            let iz2 = inverse_z * inverse_z;
            let by_d = iz2 * turned.z / d;
            DepthTerm {
                residual: inverse_z - target_d,
                variance: self.floored(target.variance as f64, target_d) + by_d * by_d * source_variance,
                by: [-iz2, -iz2 * p.y, iz2 * p.x, -inverse_z],
            }
        });
        Some(PointTerm {
            photometric: value - scaled - self.offset,
            photometric_variance: self.noise_variance + by_d * by_d * source_variance,
            photometric_by: [
                gx,
                gy,
                gz,
                gz * p.y - gy * p.z,
                gx * p.z - gz * p.x,
                gy * p.x - gx * p.y,
                -scaled,
                -1.0,
            ],
            depth,
        })
    }

    fn floored(&self, variance: f64, inverse_depth: f64) -> f64 {
        variance.max((self.min_depth_sigma * inverse_depth).powi(2))
    }
}

/// Bilinear intensity and its exact gradient; `None` outside the image.
#[inline]
pub(super) fn sample(image: &GrayImage, x: f64, y: f64) -> Option<(f64, f64, f64)> {
    let (right, bottom) = (image.width() as f64 - 1.0, image.height() as f64 - 1.0);
    if !(x >= 0.0 && y >= 0.0 && x < right && y < bottom) {
        return None;
    }
    let (x0, y0) = (x as usize, y as usize);
    let (dx, dy) = (x - x0 as f64, y - y0 as f64);
    let at = |x, y| image.get(x, y) as f64;
    let (v00, v10) = (at(x0, y0), at(x0 + 1, y0));
    let (v01, v11) = (at(x0, y0 + 1), at(x0 + 1, y0 + 1));
    let (top, bottom) = (v00 + dx * (v10 - v00), v01 + dx * (v11 - v01));
    let gx = (1.0 - dy) * (v10 - v00) + dy * (v11 - v01);
    Some((top + dy * (bottom - top), gx, bottom - top))
}
