//! Direct alignment of an image against a keyframe's points, coarse to fine.
//!
//! Minimises `E(ξ, a, b) = Σ ρ(r² / σ²)` with `r = I(ω(p, d, ξ)) − e^a I_ref(p) − b` and
//! `σ² = 2σ_I² + (∂r/∂d)² V` (Engel 2014, Eq. 12–15; affine brightness from Engel 2018, Eq. 4) by the
//! inverse compositional Gauss–Newton method: derivatives are taken once, in the keyframe.

use backend::{Descent, params};
use geometry::{Pinhole, Pyramid, Se3};
use nalgebra::{SMatrix, SVector, Vector3, Vector6};

params! {
    /// Parameters of the direct alignment.
    pub struct AlignParams {
        /// Standard deviation of the image noise, grey levels. Source: Engel 2014, §2.3. Range 0.1–50.
        pub intensity_sigma: f32 = 4.0,
        /// Huber threshold on the normalised residual. Source: Engel 2014, Eq. 13. Range 0.5–20.
        pub huber: f32 = 3.0,
        /// Iterations per pyramid level at most. Range 1–200.
        pub max_iterations: usize = 12,
        /// Finest level that is aligned; the patches take over from there. Range 0–6.
        pub finest_level: usize = 1,
        /// Levels of the image pyramid, the image itself included. Range 2–8.
        pub pyramid_levels: usize = 5,
        /// A level has converged when an iteration lowers the mean cost by less than this share. Range 1e-6–0.5.
        pub min_decrease: f32 = 0.003,
    }
}

/// A point as the keyframe sees it.
#[derive(Clone, Copy, Debug)]
pub struct ReferencePoint {
    /// Position in the keyframe, pixels of level 0.
    pub pixel: [f32; 2],
    /// Inverse depth in the keyframe.
    pub inverse_depth: f32,
    /// Its variance.
    pub variance: f32,
}

/// Affine brightness `I ≈ e^gain · I_ref + offset`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Brightness {
    /// Logarithm of the gain.
    pub log_gain: f32,
    /// Offset, grey levels.
    pub offset: f32,
}

/// Result of an alignment, with its evidence.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// Maps the reference keyframe's camera frame to the image's.
    pub frame_from_reference: Se3,
    /// Brightness of the image relative to the keyframe.
    pub brightness: Brightness,
    /// Share of the points that fall inside the image at the finest level.
    pub visible_share: f32,
    /// Share of those whose normalised residual is below the Huber threshold.
    pub inlier_share: f32,
    /// Root mean square residual of the inliers at the finest level, grey levels.
    pub rmse: f32,
}

/// A keyframe prepared for alignment: per level, intensities and derivatives of its points.
pub struct AlignmentReference {
    levels: Vec<Level>,
    params: AlignParams,
}

struct Level {
    camera: Pinhole,
    points: Vec<LevelPoint>,
}

struct LevelPoint {
    /// Ray through the pixel, z = 1.
    ray: [f32; 3],
    inverse_depth: f32,
    variance: f32,
    intensity: f32,
    gradient: [f32; 2],
    /// Derivative of the template by the twist of the reference.
    jacobian: [f32; 6],
}

/// Normal equations over (υ, ω, a, b).
struct Sums {
    hessian: SMatrix<f64, 8, 8>,
    gradient: SVector<f64, 8>,
    cost: f64,
    visible: usize,
    inliers: usize,
    inlier_square: f64,
}

impl Sums {
    /// Mean cost per visible point; points that leave the image must not make a pose look better.
    fn mean_cost(&self, total: usize) -> f64 {
        let missing = (total - self.visible) as f64;
        (self.cost + missing * 4.5) / total.max(1) as f64
    }
}

impl AlignmentReference {
    /// Prepares the keyframe's points at all levels that images are aligned at, which have as many levels.
    pub fn new(pyramid: &Pyramid, camera: &Pinhole, points: &[ReferencePoint], params: &AlignParams) -> Self {
        let finest = params.finest_level.min(pyramid.len() - 1);
        let points_at = |level: usize| if level < finest { &[] } else { points };
        let level = |level: usize| Level::new(pyramid, camera, points_at(level), level);
        Self { levels: (0..pyramid.len()).map(level).collect(), params: params.clone() }
    }

    /// Number of points at the finest level.
    pub fn len(&self) -> usize {
        self.levels.get(self.params.finest_level).map_or(0, |l| l.points.len())
    }

    /// Whether there is nothing to align to.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Aligns `image`, starting from `guess` at the coarsest level.
    pub fn align(&self, image: &Pyramid, guess: &Se3, brightness: Brightness) -> Alignment {
        let mut state = (*guess, brightness);
        let top = self.levels.len().min(image.len());
        let finest = self.params.finest_level.min(top - 1);
        let mut last = None;
        for level in (finest..top).rev() {
            last = Some(self.align_level(image, level, &mut state));
        }
        let total = self.levels[finest].points.len().max(1) as f32;
        let sums = last.expect("there is at least one level");
        Alignment {
            frame_from_reference: state.0,
            brightness: state.1,
            visible_share: sums.visible as f32 / total,
            inlier_share: sums.inliers as f32 / sums.visible.max(1) as f32,
            rmse: (sums.inlier_square / sums.inliers.max(1) as f64).sqrt() as f32,
        }
    }

    /// Mean robust cost of a pose at the coarsest level, to compare guesses.
    pub fn coarse_cost(&self, image: &Pyramid, guess: &Se3, brightness: Brightness) -> f64 {
        let level = self.levels.len().min(image.len()) - 1;
        let mut state = (*guess, brightness);
        let sums = self.align_level(image, level, &mut state);
        sums.mean_cost(self.levels[level].points.len())
    }

    fn align_level(&self, image: &Pyramid, level: usize, state: &mut (Se3, Brightness)) -> Sums {
        let total = self.levels[level].points.len();
        let descent = Descent {
            iterations: self.params.max_iterations,
            min_decrease: self.params.min_decrease as f64,
            damping: 1e-3,
            eased: (0.2, 1e-6),
            raised: (8.0, 8e-4),
            most: 10.0,
        };
        let start = (*state, linearise(self, image, level, state));
        let (found, sums) = descent.minimise(
            start,
            |state, sums: &Sums, lambda| step(sums, lambda, state),
            |state| Some(linearise(self, image, level, state)),
            |sums| sums.mean_cost(total),
        );
        *state = found;
        sums
    }
}

geometry::multiversion! {
    fn linearise(alignment: &AlignmentReference, image: &Pyramid, level: usize, state: &(Se3, Brightness)) -> Sums {
        let (reference, (pose, brightness)) = (&alignment.levels[level], state);
        let (view, camera) = (image.level(level), &reference.camera);
        let rotation = pose.rotation_matrix().cast::<f32>();
        let translation = pose.translation.cast::<f32>();
        let (fx, fy) = (camera.fx as f32, camera.fy as f32);
        let (cx, cy) = (camera.cx as f32, camera.cy as f32);
        let gain = brightness.log_gain.exp();
        let noise = 2.0 * alignment.params.intensity_sigma * alignment.params.intensity_sigma;
        let huber = alignment.params.huber;
        let mut sums = Accumulator::default();
        for point in &reference.points {
            let ray = Vector3::from(point.ray);
            let x = rotation * ray + translation * point.inverse_depth;
            if x.z < 0.02 {
                continue;
            }
            let iz = 1.0 / x.z;
            let (u, v) = (fx * x.x * iz + cx, fy * x.y * iz + cy);
            if !view.contains(u, v, 1.0) {
                continue;
            }
            let residual = view.bilinear(u, v) - gain * point.intensity - brightness.offset;
            let by_depth = gain
                * iz
                * (point.gradient[0] * fx * (translation.x - x.x * iz * translation.z)
                    + point.gradient[1] * fy * (translation.y - x.y * iz * translation.z));
            let inverse_variance = 1.0 / (noise + by_depth * by_depth * point.variance);
            let normalised = residual.abs() * inverse_variance.sqrt();
            let inlier = normalised <= huber;
            let weight = inverse_variance * if inlier { 1.0 } else { huber / normalised };
            sums.cost +=
                if inlier { 0.5 * normalised * normalised } else { huber * (normalised - 0.5 * huber) }
                    .min(9.0) as f64;
            sums.visible += 1;
            if inlier {
                sums.inliers += 1;
                sums.inlier_square += (residual * residual) as f64;
            }
            let p = &point.jacobian;
            let j = [p[0], p[1], p[2], p[3], p[4], p[5], point.intensity].map(|v| v * gain);
            sums.add(&[j[0], j[1], j[2], j[3], j[4], j[5], j[6], 1.0], residual, weight);
        }
        sums.finish()
    }
}

/// The 36 upper entries and the gradient in f32 per run of points, folded into f64.
#[derive(Default)]
struct Accumulator {
    wide: [[f64; 8]; 8],
    gradient: [f64; 8],
    tile: [[f32; 8]; 8],
    tile_gradient: [f32; 8],
    in_tile: usize,
    cost: f64,
    visible: usize,
    inliers: usize,
    inlier_square: f64,
}

impl Accumulator {
    #[inline(always)]
    fn add(&mut self, j: &[f32; 8], residual: f32, weight: f32) {
        for a in 0..8 {
            let wa = weight * j[a];
            for (entry, jb) in self.tile[a].iter_mut().zip(j) {
                *entry += wa * jb;
            }
            self.tile_gradient[a] += wa * residual;
        }
        self.in_tile += 1;
        if self.in_tile == 64 {
            self.fold();
        }
    }

    fn fold(&mut self) {
        for a in 0..8 {
            for b in 0..8 {
                self.wide[a][b] += self.tile[a][b] as f64;
            }
            self.gradient[a] += self.tile_gradient[a] as f64;
        }
        self.tile = Default::default();
        self.tile_gradient = Default::default();
        self.in_tile = 0;
    }

    fn finish(mut self) -> Sums {
        self.fold();
        Sums {
            hessian: SMatrix::from_fn(|i, j| self.wide[i][j]),
            gradient: SVector::from(self.gradient),
            cost: self.cost,
            visible: self.visible,
            inliers: self.inliers,
            inlier_square: self.inlier_square,
        }
    }
}

/// One damped step: the template is moved by δ to meet the image, so the pose takes δ's inverse.
fn step(sums: &Sums, lambda: f64, (pose, brightness): &(Se3, Brightness)) -> Option<(Se3, Brightness)> {
    if sums.visible < 12 {
        return None;
    }
    let mut h = sums.hessian;
    for i in 0..8 {
        h[(i, i)] *= 1.0 + lambda;
        h[(i, i)] += 1e-6;
    }
    // A weak prior keeps gain and offset apart where the image has little contrast.
    h[(6, 6)] += 10.0;
    let mut gradient = sums.gradient;
    gradient[6] -= 10.0 * brightness.log_gain as f64;
    let delta = h.cholesky()?.solve(&gradient);
    let twist: Vector6<f64> = delta.fixed_rows::<6>(0).into_owned();
    let moved = (*pose * Se3::exp(&twist).inverse()).renormalized();
    let brightness = Brightness {
        log_gain: brightness.log_gain + delta[6] as f32,
        offset: brightness.offset + delta[7] as f32,
    };
    (moved.is_finite() && brightness.log_gain.abs() < 3.0).then_some((moved, brightness))
}

impl Level {
    fn new(pyramid: &Pyramid, camera: &Pinhole, points: &[ReferencePoint], level: usize) -> Self {
        let image = pyramid.level(level);
        let camera = camera.at_level(level);
        let scale = 1.0 / (1u32 << level) as f32;
        let points = points
            .iter()
            .filter_map(|point| {
                let (u, v) = ((point.pixel[0] + 0.5) * scale - 0.5, (point.pixel[1] + 0.5) * scale - 0.5);
                if !image.contains(u, v, 1.5) {
                    return None;
                }
                let gradient = [
                    0.5 * (image.bilinear(u + 1.0, v) - image.bilinear(u - 1.0, v)),
                    0.5 * (image.bilinear(u, v + 1.0) - image.bilinear(u, v - 1.0)),
                ];
                let ray = camera.unproject(u as f64, v as f64).cast::<f32>();
                let (x, y, d) = (ray.x, ray.y, point.inverse_depth);
                let (gx, gy) = (gradient[0] * camera.fx as f32, gradient[1] * camera.fy as f32);
                let jacobian = [
                    gx * d,
                    gy * d,
                    -(gx * x + gy * y) * d,
                    -gx * x * y - gy * (1.0 + y * y),
                    gx * (1.0 + x * x) + gy * x * y,
                    -gx * y + gy * x,
                ];
                Some(LevelPoint {
                    ray: ray.into(),
                    inverse_depth: d,
                    variance: point.variance,
                    intensity: image.bilinear(u, v),
                    gradient,
                    jacobian,
                })
            })
            .collect();
        Self { camera, points }
    }
}

#[cfg(test)]
mod tests;
