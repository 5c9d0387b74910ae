//! Poses, depths and the lens as values, and what they predict.

use super::stills::Stills;
use super::{FreeLens, LensPrior, SelfCalibrationError};
use geometry::{Camera, Distortion, Pinhole, RadTan, Se3, Sim3};
use map::{KeyframeId, Map};
use nalgebra::{DVector, Matrix2x3, Vector2, Vector3};
use std::collections::BTreeMap;
use std::ops::Range;

/// Fewer keyframes leave too much to chance.
pub(super) const MIN_KEYFRAMES: usize = 8;
/// Fewer observations likewise.
pub(super) const MIN_OBSERVATIONS: usize = 400;
/// So many keyframes say all there is to say, and keep the dense equations below a thousand unknowns.
pub(super) const MAX_KEYFRAMES: usize = 100;
/// Steps of numerical derivatives by the terms of the lens: small against what they come out as, large against rounding.
const STEPS: [f64; 5] = [1e-5, 1e-3, 1e-3, 1e-5, 1e-5];

/// Rays farther than this from the axis (cosine of the angle: 84°) have no depth along it.
const MIN_AXIS: f64 = 0.1;

/// A point on its host's ray.
pub(super) struct FreePoint {
    /// Index of the host's pose.
    pub host: usize,
    /// The raw pixel in the host's image.
    pub pixel: Vector2<f64>,
    /// Inverse depth along the host's axis, in 1/world unit.
    pub inverse_depth: f64,
    /// Its observations.
    pub observations: Range<usize>,
}

/// Where another keyframe sees a point.
#[derive(Clone, Copy)]
pub(super) struct FreeObservation {
    /// Index of the observing pose.
    pub frame: usize,
    /// The raw pixel there.
    pub pixel: Vector2<f64>,
    /// Its information `[xx, xy, yy]`, 1/px².
    pub information: [f64; 3],
}

/// Everything that is made consistent.
pub(super) struct Problem {
    guess: Camera,
    pub prior: LensPrior,
    /// `frame_from_world` of each keyframe.
    pub poses: Vec<Se3>,
    pub points: Vec<FreePoint>,
    pub observations: Vec<FreeObservation>,
    /// Logarithm of the focal length over the guess, shift of the principal point in pixels, and radial terms over the
    /// guess; as many as are free.
    pub terms: DVector<f64>,
}

/// A lens with those that differ from it by one step of a term each, and the host's ray through each.
pub(super) struct Lenses {
    pub middle: Camera,
    pub perturbed: Vec<[Camera; 2]>,
}

impl Problem {
    /// The keyframes of a map at these places in their order, with their poses, points and observations.
    pub fn new(
        map: &Map,
        range: Range<usize>,
        guess: &Camera,
        free: FreeLens,
        prior: &LensPrior,
    ) -> Result<Self, SelfCalibrationError> {
        let taken = || map.keyframes.values().skip(range.start).take(range.len());
        let order: BTreeMap<KeyframeId, usize> = taken().enumerate().map(|(i, k)| (k.id, i)).collect();
        let stills = Stills::of(map);
        let mut worlds: Vec<Sim3> = Vec::new();
        let (mut points, mut observations) = (Vec::new(), Vec::new());
        for keyframe in taken() {
            worlds.push(keyframe.world_from_keyframe);
            let pinhole = map.camera(keyframe);
            for point in &keyframe.points {
                let Some(pixel) = raw(guess, pinhole, &stills.host(keyframe, point)) else { continue };
                let first = observations.len();
                for seen in &point.observations {
                    let Some(&frame) = order.get(&seen.keyframe) else { continue };
                    let pixel = stills.seen(keyframe, point, seen);
                    if let Some(pixel) = pixel.and_then(|pixel| raw(guess, pinhole, &pixel)) {
                        let information = seen.information.map(f64::from);
                        observations.push(FreeObservation { frame, pixel, information });
                    }
                }
                // A point seen from one other side has a depth for every lens.
                if observations.len() < first + 2 {
                    observations.truncate(first);
                    continue;
                }
                points.push(FreePoint {
                    host: order[&keyframe.id],
                    pixel,
                    inverse_depth: f64::from(point.inverse_depth) / keyframe.world_from_keyframe.scale,
                    observations: first..observations.len(),
                });
            }
        }
        if worlds.len() < MIN_KEYFRAMES || observations.len() < MIN_OBSERVATIONS {
            let (keyframes, observations) = (worlds.len(), observations.len());
            return Err(SelfCalibrationError::TooSmall { keyframes, observations });
        }
        let origin = worlds[0].rigid();
        let poses = worlds.iter().map(|world| (world.rigid().inverse() * origin).renormalized()).collect();
        let bends = matches!(guess.distortion(), Distortion::None | Distortion::RadTan(_));
        let count = match free {
            FreeLens::Focal => 1,
            FreeLens::All if bends => 5,
            FreeLens::All => 3,
        };
        let (guess, prior, terms) = (*guess, *prior, DVector::zeros(count));
        Ok(Self { guess, prior, poses, points, observations, terms })
    }

    /// Keeps points that are spread evenly over all and have about so many observations.
    pub fn thin(&mut self, most: usize) {
        let share = most as f64 / self.observations.len().max(1) as f64;
        if share >= 1.0 {
            return;
        }
        let all = std::mem::take(&mut self.observations);
        let (mut number, observations) = (0u64, &mut self.observations);
        self.points.retain_mut(|point| {
            number += 1;
            let is_kept = (number as f64 * share).floor() > ((number - 1) as f64 * share).floor();
            if is_kept {
                let first = observations.len();
                observations.extend_from_slice(&all[point.observations.clone()]);
                point.observations = first..observations.len();
            }
            is_kept
        });
    }

    /// The lens with these terms; nothing where that is none.
    pub fn lens(&self, terms: &DVector<f64>) -> Option<Camera> {
        let term = |i: usize| terms.get(i).copied().unwrap_or(0.0);
        let &Pinhole { width, height, fx, fy, cx, cy } = self.guess.intrinsics();
        let factor = term(0).exp();
        let pinhole =
            Pinhole { width, height, fx: fx * factor, fy: fy * factor, cx: cx + term(1), cy: cy + term(2) };
        let distortion = match self.guess.distortion() {
            distortion if terms.len() < 5 => *distortion,
            Distortion::RadTan(lens) => {
                let mut all = lens.terms();
                all[0] += term(3);
                all[1] += term(4);
                Distortion::RadTan(RadTan::new(&all).ok()?)
            }
            _ => Distortion::RadTan(RadTan::new(&[term(3), term(4), 0.0, 0.0]).ok()?),
        };
        Camera::new(pinhole, distortion).ok()
    }

    /// The lens now, with its neighbours for derivatives.
    pub fn lenses(&self) -> Option<Lenses> {
        let perturbed = |i: usize| {
            let at = |step: f64| {
                let mut terms = self.terms.clone();
                terms[i] += step;
                self.lens(&terms)
            };
            Some([at(STEPS[i])?, at(-STEPS[i])?])
        };
        let perturbed = (0..self.terms.len()).map(perturbed).collect::<Option<Vec<_>>>()?;
        Some(Lenses { middle: self.lens(&self.terms)?, perturbed })
    }

    /// Deviations of the terms as known before.
    pub fn prior_deviations(&self) -> [f64; 5] {
        let centre = self.prior.centre * self.guess.intrinsics().width as f64;
        [self.prior.focal, centre, centre, self.prior.radial[0], self.prior.radial[1]]
    }
}

/// The pixel of the raw image that an undistorted one was taken from.
fn raw(lens: &Camera, pinhole: &Pinhole, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
    lens.project(&pinhole.unproject(pixel.x, pixel.y))
}

/// The ray through a raw pixel with z = 1; nothing beside or behind the camera.
pub(super) fn ray(lens: &Camera, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
    lens.unproject(pixel).filter(|ray| ray.z > MIN_AXIS).map(|ray| ray / ray.z)
}

/// A predicted observation with its derivatives.
pub(super) struct Predicted {
    /// Predicted minus measured pixel.
    pub residual: Vector2<f64>,
    /// By the left twist (υ, ω) of `frame_from_host`, column by column.
    pub by_twist: [Vector2<f64>; 6],
    /// By the inverse depth.
    pub by_inverse_depth: Vector2<f64>,
    /// By the terms of the lens.
    pub by_terms: Vec<Vector2<f64>>,
}

/// A host's ray through the lens and its neighbours.
pub(super) struct Rays {
    middle: Vector3<f64>,
    perturbed: Vec<[Vector3<f64>; 2]>,
}

impl Lenses {
    /// The rays of a raw pixel; nothing where a lens does not show it.
    pub fn rays(&self, pixel: &Vector2<f64>) -> Option<Rays> {
        let perturbed = |[plus, minus]: &[Camera; 2]| Some([ray(plus, pixel)?, ray(minus, pixel)?]);
        let perturbed = self.perturbed.iter().map(perturbed).collect::<Option<Vec<_>>>()?;
        Some(Rays { middle: ray(&self.middle, pixel)?, perturbed })
    }

    /// Predicts an observation; nothing behind the camera or outside of what the lens shows.
    pub fn predict(
        &self,
        frame_from_host: &Se3,
        rays: &Rays,
        inverse_depth: f64,
        measured: &Vector2<f64>,
    ) -> Option<Predicted> {
        let rotation = frame_from_host.rotation_matrix();
        let shift = frame_from_host.translation * inverse_depth;
        let x = rotation * rays.middle + shift;
        let (pixel, by_x): (Vector2<f64>, Matrix2x3<f64>) = self.middle.project_with_jacobian(&x)?;
        let column = |v: Vector3<f64>| by_x * v;
        let axis = Vector3::ith;
        let by_twist = std::array::from_fn(|k| {
            if k < 3 { column(axis(k, inverse_depth)) } else { column(axis(k - 3, 1.0).cross(&x)) }
        });
        let by_term =
            |(i, ([plus, minus], [ray_plus, ray_minus])): (usize, (&[Camera; 2], &[Vector3<f64>; 2]))| {
                let plus = plus.project(&(rotation * ray_plus + shift))?;
                let minus = minus.project(&(rotation * ray_minus + shift))?;
                Some((plus - minus) / (2.0 * STEPS[i]))
            };
        Some(Predicted {
            residual: pixel - measured,
            by_twist,
            by_inverse_depth: by_x * frame_from_host.translation,
            by_terms: self
                .perturbed
                .iter()
                .zip(&rays.perturbed)
                .enumerate()
                .map(by_term)
                .collect::<Option<_>>()?,
        })
    }

    /// The residual alone.
    pub fn residual(
        &self,
        frame_from_host: &Se3,
        ray: &Vector3<f64>,
        inverse_depth: f64,
        measured: &Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        let x = frame_from_host.rotation_matrix() * ray + frame_from_host.translation * inverse_depth;
        Some(self.middle.project(&x)? - measured)
    }
}
