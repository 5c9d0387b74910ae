//! Which model the inliers call for, and the result that follows from it.

use super::epipolar::{self, EpipolarFit, in_front};
use super::least_squares::{covariance, minimise};
use super::linear::{PlanePose, Pose, nearest_rotation};
use super::rays::{Rays, tangent_basis};
use super::transfer::{self, PlaneFit, RotationFit, pose_by_plane};
use super::{Direction, RelativePose, Scene, TwoViewParams, plane_limit};
use geometry::median;
use nalgebra::{Matrix3, Matrix5, Rotation3, Unit, UnitQuaternion, Vector3};

/// Residuals above this many standard deviations pull no harder: Huber's bound, for 95 % efficiency.
const HUBER: f64 = 1.345;

/// No key point is found better than this, pixels.
const LEAST_DEVIATION: f64 = 0.1;

/// Most rounds of fitting and choosing inliers anew.
const ROUNDS: usize = 10;

/// Steps of one fit.
const STEPS: usize = 15;

/// Matches, beyond those expected by chance, that a model with more freedom always takes in.
const FREE_MATCHES: f64 = 5.0;

/// A pose with the inliers it rests on.
pub(super) struct Settled {
    pub(super) pose: Pose,
    pub(super) inliers: Vec<usize>,
    /// Standard deviation of the inliers' epipolar errors, radians.
    deviation: f64,
}

/// The inliers of a pose that may lie in front of both cameras.
fn visible_inliers(rays: &Rays, pose: &Pose, limit: f64) -> Vec<usize> {
    let mut inliers = epipolar::inliers(rays, pose, limit);
    inliers.retain(|&i| in_front(rays, pose, i, limit.sqrt()));
    inliers
}

impl Settled {
    /// Refines a pose on its inliers and chooses them anew until they stay.
    pub(super) fn new(rays: &Rays, start: Pose, limit: f64, pixel_angle: f64) -> Self {
        let mut pose = start;
        let mut inliers = visible_inliers(rays, &pose, limit);
        let mut spread = LEAST_DEVIATION * pixel_angle;
        for _ in 0..ROUNDS {
            spread = epipolar::deviation(rays, &pose, &inliers).max(LEAST_DEVIATION * pixel_angle);
            pose = minimise(&EpipolarFit { rays, matches: &inliers }, pose, HUBER * spread, STEPS);
            let next = visible_inliers(rays, &pose, limit);
            let stays = next == inliers;
            inliers = next;
            if stays {
                break;
            }
        }
        Self { pose, inliers, deviation: spread }
    }

    /// Logarithm of how many sets of as many matches would fit some pose as well if all were wrong (a contrario,
    /// Moisan & Stival 2004).
    pub(super) fn ln_false_alarms(&self, rays: &Rays, limit: f64) -> f64 {
        let (given, fits) = (rays.len(), self.inliers.len());
        let chance = epipolar::chance_share(rays, &self.pose, limit);
        ln_false_alarms(given, fits, FREE_MATCHES as usize, chance)
    }
}

/// Logarithm of how many sets of `fits` of `given` matches may be expected to fit some model by chance, which `free` of them
/// settle and one fits with probability `chance` (Moisan & Stival, IJCV 2004, Eq. 8).
pub(crate) fn ln_false_alarms(given: usize, fits: usize, free: usize, chance: f64) -> f64 {
    (given as f64).ln()
        + ln_choose(given, fits)
        + ln_choose(fits, free)
        + fits.saturating_sub(free) as f64 * chance.ln()
}

/// ln of the binomial coefficient.
fn ln_choose(of: usize, chosen: usize) -> f64 {
    (1..=chosen.min(of - chosen.min(of))).map(|k| ((of + 1 - k) as f64 / k as f64).ln()).sum()
}

/// GRIC of a model: squared errors (radians²) over variance, capped, plus the cost of its dimensions and unknowns.
fn gric(squared: impl Iterator<Item = f64>, variance: f64, dimension: f64, unknowns: f64) -> f64 {
    // A match has four coordinates; Torr's λ₃ = 2 caps the error at the gain of calling it wrong.
    let cap = 2.0 * (4.0 - dimension);
    let (mut sum, mut count) = (0.0, 0.0);
    for error in squared {
        sum += (error / variance).min(cap);
        count += 1.0;
    }
    sum + 4f64.ln() * dimension * count + (4.0 * count).max(1.0).ln() * unknowns
}

/// A plane with its pose, refined on all it explains.
struct FlatPose {
    plane: PlanePose,
    pose: Pose,
    on_plane: Vec<usize>,
    off_plane: Vec<usize>,
    /// Epipolar cost over all matches, those behind a camera counted as wrong, in wrong matches.
    wrong: f64,
}

/// Chooses the model.
pub(super) struct Chooser<'a> {
    pub rays: &'a Rays,
    pub settled: &'a Settled,
    pub limit: f64,
    pub pixel_angle: f64,
    pub params: &'a TwoViewParams,
}

impl Chooser<'_> {
    /// The result by the model that explains the inliers best; nothing where they leave the rotation open.
    pub fn choose(&self, homography: Option<&Matrix3<f64>>, planes: Vec<PlanePose>) -> Option<RelativePose> {
        let with_depth = self.gric_depth();
        let pure_rotation = self.pure_rotation(homography);
        if self.gric_homography(&pure_rotation.0, 3.0) < with_depth
            && self.shows_no_parallax(&pure_rotation.1)
        {
            return self.without_parallax(&pure_rotation.0, pure_rotation.1);
        }
        let flat: Vec<FlatPose> = planes.into_iter().filter_map(|plane| self.flat(plane)).collect();
        let is_flat = flat.iter().any(|f| self.gric_homography(&f.plane.homography(), 8.0) < with_depth);
        let on_plane = if is_flat { self.on_plane(flat) } else { None };
        on_plane.or_else(|| self.with_depth())
    }

    fn bound(&self) -> f64 {
        HUBER * self.settled.deviation
    }

    fn gric_depth(&self) -> f64 {
        let essential = self.settled.pose.essential();
        let error =
            |&i: &usize| epipolar::squared_error(&essential, &self.rays.source[i], &self.rays.target[i]);
        gric(self.settled.inliers.iter().map(error), self.settled.deviation.powi(2), 3.0, 5.0)
    }

    fn gric_homography(&self, homography: &Matrix3<f64>, unknowns: f64) -> f64 {
        let error = |&i: &usize| transfer::squared_error(self.rays, homography, i);
        gric(self.settled.inliers.iter().map(error), self.settled.deviation.powi(2), 2.0, unknowns)
    }

    /// The rotation that alone explains most matches, with them.
    fn pure_rotation(&self, homography: Option<&Matrix3<f64>>) -> (Matrix3<f64>, Vec<usize>) {
        let limit = plane_limit(self.limit);
        let converge = |start: Matrix3<f64>| {
            let mut pure_rotation = start;
            let mut fits = transfer::inliers(self.rays, &pure_rotation, limit);
            for _ in 0..ROUNDS {
                let fit = RotationFit { rays: self.rays, matches: &fits };
                pure_rotation = minimise(&fit, pure_rotation, self.bound(), STEPS);
                let next = transfer::inliers(self.rays, &pure_rotation, limit);
                if next == fits {
                    break;
                }
                fits = next;
            }
            (pure_rotation, fits)
        };
        let from_pose = converge(self.settled.pose.rotation);
        match homography.and_then(nearest_rotation).map(converge) {
            Some(other) if other.1.len() > from_pose.1.len() => other,
            _ => from_pose,
        }
    }

    /// Whether hardly more matches fit the pose than fit the rotation alone.
    fn shows_no_parallax(&self, fits: &[usize]) -> bool {
        let more = self.settled.inliers.iter().filter(|i| fits.binary_search(i).is_err()).count();
        let others = self.rays.len() - fits.len();
        let by_chance = epipolar::chance_share(self.rays, &self.settled.pose, self.limit) * others as f64;
        more as f64 <= FREE_MATCHES + by_chance + 3.0 * by_chance.sqrt()
    }

    fn without_parallax(&self, pure_rotation: &Matrix3<f64>, fits: Vec<usize>) -> Option<RelativePose> {
        let fit = RotationFit { rays: self.rays, matches: &fits };
        let rotation_covariance = covariance(&fit, pure_rotation, self.bound())?;
        // Two rows an inlier.
        let squared: f64 = fits.iter().map(|&i| transfer::squared_error(self.rays, pure_rotation, i)).sum();
        let rmse = (squared / (2 * fits.len()) as f64).sqrt() / self.pixel_angle;
        let target_from_source = quaternion(pure_rotation);
        let parallax = self.parallax(pure_rotation, &fits);
        let (direction, scene) = (None, Scene::NoParallax);
        Some(RelativePose {
            target_from_source,
            rotation_covariance,
            direction,
            scene,
            inliers: fits,
            ln_false_alarms: self.settled.ln_false_alarms(self.rays, self.limit),
            parallax,
            rmse,
        })
    }

    fn with_depth(&self) -> Option<RelativePose> {
        let Settled { pose, inliers, .. } = self.settled;
        let fit = EpipolarFit { rays: self.rays, matches: inliers };
        let covariance = covariance(&fit, pose, self.bound())?;
        Some(self.result(pose, covariance, Scene::Depth, inliers.clone()))
    }

    /// Refines one of a homography's poses on the plane and what else fits the pose.
    fn flat(&self, start: PlanePose) -> Option<FlatPose> {
        let mut plane = start;
        let (mut on_plane, mut off_plane) = self.parts(&plane)?;
        for _ in 0..ROUNDS {
            let fit = PlaneFit { rays: self.rays, on_plane: &on_plane, off_plane: &off_plane };
            plane = minimise(&fit, plane, self.bound(), STEPS);
            let next = self.parts(&plane)?;
            let stays = next == (on_plane, off_plane);
            (on_plane, off_plane) = next;
            if stays {
                break;
            }
        }
        let pose = plane.pose()?;
        let essential = pose.essential();
        let slack = self.limit.sqrt();
        let cost = |i: usize| {
            let error = epipolar::squared_error(&essential, &self.rays.source[i], &self.rays.target[i]);
            if in_front(self.rays, &pose, i, slack) { error.min(self.limit) } else { self.limit }
        };
        let wrong = (0..self.rays.len()).map(cost).sum::<f64>() / self.limit;
        Some(FlatPose { plane, pose, on_plane, off_plane, wrong })
    }

    /// The matches on a plane, and the others that fit its pose.
    fn parts(&self, plane: &PlanePose) -> Option<(Vec<usize>, Vec<usize>)> {
        let on_plane = transfer::inliers(self.rays, &plane.homography(), plane_limit(self.limit));
        let mut off_plane = visible_inliers(self.rays, &plane.pose()?, self.limit);
        off_plane.retain(|i| on_plane.binary_search(i).is_err());
        Some((on_plane, off_plane))
    }

    /// The result for a plane: of its two poses the one that more matches fit, and in front of both cameras.
    fn on_plane(&self, mut flat: Vec<FlatPose>) -> Option<RelativePose> {
        flat.sort_by(|a, b| a.wrong.total_cmp(&b.wrong));
        let mut flat = flat.into_iter();
        let best = flat.next()?;
        let alternative = flat
            .next()
            .filter(|other| self.as_likely(&best, other))
            .map(|other| (other.pose.quaternion(), Unit::new_normalize(other.pose.direction)));
        let fit = PlaneFit { rays: self.rays, on_plane: &best.on_plane, off_plane: &best.off_plane };
        let derivative = pose_by_plane(&best.plane.shift);
        let covariance = derivative * covariance(&fit, &best.plane, self.bound())? * derivative.transpose();
        let normal = Unit::new_normalize(best.plane.normal);
        let inliers = visible_inliers(self.rays, &best.pose, self.limit);
        Some(self.result(&best.pose, covariance, Scene::Plane { normal, alternative }, inliers))
    }

    /// Whether the two poses of a plane differ in what they explain by no more than chance.
    fn as_likely(&self, best: &FlatPose, other: &FlatPose) -> bool {
        let others = self.rays.len() - best.on_plane.len();
        let by_chance = epipolar::chance_share(self.rays, &best.pose, self.limit) * others as f64;
        other.wrong - best.wrong <= 3.0 + 3.0 * (2.0 * by_chance).sqrt()
    }

    fn result(
        &self,
        pose: &Pose,
        covariance: Matrix5<f64>,
        scene: Scene,
        inliers: Vec<usize>,
    ) -> RelativePose {
        let across = covariance.fixed_view::<2, 2>(3, 3).into_owned();
        let known = across.symmetric_eigenvalues().max().sqrt() <= self.params.max_direction_deviation;
        let direction = known.then(|| Direction {
            vector: Unit::new_normalize(pose.direction),
            basis: tangent_basis(&pose.direction),
            covariance,
        });
        let essential = pose.essential();
        let error =
            |&i: &usize| epipolar::squared_error(&essential, &self.rays.source[i], &self.rays.target[i]);
        let mean = inliers.iter().map(error).sum::<f64>() / inliers.len().max(1) as f64;
        RelativePose {
            target_from_source: pose.quaternion(),
            rotation_covariance: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            direction,
            scene,
            parallax: self.parallax(&pose.rotation, &inliers),
            inliers,
            ln_false_alarms: self.settled.ln_false_alarms(self.rays, self.limit),
            rmse: mean.sqrt() / self.pixel_angle,
        }
    }

    /// Median angle between the rays of some matches, once turned into one frame.
    fn parallax(&self, rotation: &Matrix3<f64>, matches: &[usize]) -> f64 {
        let angle = |&i: &usize| {
            let source: Vector3<f64> = rotation * self.rays.source[i];
            let target = self.rays.target[i];
            source.cross(&target).norm().atan2(source.dot(&target))
        };
        let mut angles: Vec<f64> = matches.iter().map(angle).collect();
        median(&mut angles).unwrap_or(0.0)
    }
}

fn quaternion(rotation: &Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation))
}
