//! Calibrates a camera from a map that was made with a guess of its calibration: the joint optimisation of poses and
//! depths with the lens free as well.
//!
//! The observations of a map are pixels, and points that are seen from several sides contradict a wrong lens. The map
//! was made of images that were undistorted by the guess. Distorted again by the guess, its observations are those of
//! the raw images, and `z = π_c(T_fh · π_c⁻¹(z_h) / ρ)` holds for them with the true lens c only. If the map has a
//! rolling shutter, its effect is undone first (`stills`). One factor for both focal lengths, the principal point and
//! two radial terms are free. The deviation shows what a motion does not determine, such as the focal length when
//! going straight ahead past little depth (Hartley & Zisserman, Multiple View Geometry, §18.5 and §19).

mod problem;
mod solve;
mod stills;
#[cfg(test)]
mod tests;

use geometry::Camera;
use map::Map;
use problem::Problem;
use std::ops::Range;

/// The free parameters of the lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FreeLens {
    /// One factor for both focal lengths.
    Focal,
    /// One factor for both focal lengths, the principal point and two radial terms. A lens of another model than
    /// pinhole and radial-tangential has only the first two.
    All,
}

/// The prior of the lens, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensPrior {
    /// Deviation of the focal length's logarithm. Infinite without a prior.
    pub focal: f64,
    /// Deviation of the principal point, as a share of the image's width. Makers of modules state 1 to 2 %.
    pub centre: f64,
    /// Deviations of the radial terms k1 and k2.
    pub radial: [f64; 2],
}

impl Default for LensPrior {
    fn default() -> Self {
        Self { focal: f64::INFINITY, centre: 0.015, radial: [0.15, 0.15] }
    }
}

/// A lens found from a map.
#[derive(Clone, Debug, PartialEq)]
pub struct SelfCalibration {
    /// The lens of the raw images.
    pub camera: Camera,
    /// Standard deviation of the focal length over the focal length: by the residuals, or by the difference between
    /// halves of the map where that is larger.
    pub focal_deviation: f64,
    /// Keyframes it was found from.
    pub keyframes: usize,
    /// Observations it was found from.
    pub observations: usize,
    /// Root mean square of the observations' normalised residuals; 1 if their uncertainties are right.
    pub residual: f64,
}

/// Why a map does not determine its lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SelfCalibrationError {
    /// It is too small.
    #[error(
        "the map of {keyframes} keyframes and {observations} observations is too small to find the lens from; {} and {} \
         are needed",
        problem::MIN_KEYFRAMES,
        problem::MIN_OBSERVATIONS
    )]
    TooSmall {
        /// Keyframes with observations.
        keyframes: usize,
        /// Their observations.
        observations: usize,
    },
    /// The equations have no solution that is better than the guess.
    #[error("the map does not determine the lens")]
    Undetermined,
}

/// Finds the lens with which the raw images of `map` were taken, when `guess` is the one by which they were undistorted.
///
/// # Errors
/// When the map is too small or does not determine the lens.
pub fn self_calibrate(
    map: &Map,
    guess: &Camera,
    free: FreeLens,
    prior: &LensPrior,
) -> Result<SelfCalibration, SelfCalibrationError> {
    let question = Question { map, guess, free, prior, most: usize::MAX };
    question.answer(&question.solved(question.all())?)
}

/// Observations from which [`other_focal_length`] is found: so many leave it uncertain by far less than a percent.
const SAMPLE: usize = 20_000;
/// What a fifth of them must say at the most for the lens to be right, as a share of what does no harm: the rest is for
/// chance, which is some two percent of so few.
const FIRST_LOOK: f64 = 1.0 / 3.0;

/// The lens that fits `map` better than `lens`, by which its images were undistorted, with the focal length alone
/// free. `None` where the logarithms of both focal lengths differ by less than `harmless`. It is found from a sample
/// of the points.
///
/// # Errors
/// When the map is too small or does not determine the lens.
pub fn other_focal_length(
    map: &Map,
    lens: &Camera,
    harmless: f64,
) -> Result<Option<SelfCalibration>, SelfCalibrationError> {
    let prior = &LensPrior::default();
    let question = Question { map, guess: lens, free: FreeLens::Focal, prior, most: SAMPLE };
    let difference = |solved: &Problem| Ok((logarithm(&camera(solved)?) - logarithm(lens)).abs());
    // Most lenses are right, and of those few observations tell it.
    let sample = Question { most: SAMPLE / 5, ..question };
    if difference(&sample.solved(sample.all())?)? < FIRST_LOOK * harmless {
        return Ok(None);
    }
    let whole = question.solved(question.all())?;
    if difference(&whole)? < harmless {
        return Ok(None);
    }
    question.answer(&whole).map(Some)
}

/// What a map is asked.
#[derive(Clone, Copy)]
struct Question<'a> {
    map: &'a Map,
    guess: &'a Camera,
    free: FreeLens,
    prior: &'a LensPrior,
    /// Observations at most, of points spread evenly over the map.
    most: usize,
}

impl Question<'_> {
    /// All keyframes that are asked, by their places.
    fn all(&self) -> Range<usize> {
        0..self.map.keyframes.len().min(problem::MAX_KEYFRAMES)
    }

    /// The problem that keyframes pose, solved.
    fn solved(&self, range: Range<usize>) -> Result<Problem, SelfCalibrationError> {
        let mut problem = Problem::new(self.map, range, self.guess, self.free, self.prior)?;
        problem.thin(self.most);
        solve::solve(&mut problem).ok_or(SelfCalibrationError::Undetermined)?;
        Ok(problem)
    }

    /// What the solved problem of all keyframes says, and what halves of them say of its deviation.
    fn answer(&self, whole: &Problem) -> Result<SelfCalibration, SelfCalibrationError> {
        let solution = solve::solution(whole).ok_or(SelfCalibrationError::Undetermined)?;
        let (keyframes, observations) = (whole.poses.len(), whole.observations.len());
        // Observations of a point share the error of its host's pixel and are no independent witnesses: as many count as
        // there are points.
        let shared = (observations as f64 / whole.points.len() as f64).sqrt();
        // A rolling shutter or a lens of another model disturbs all observations of a motion alike, which no residual
        // shows; but two halves of the map then say different things. Half their difference is the deviation of their mean.
        let count = self.all().len();
        let halves = [0..count / 2, count / 2..count]
            .map(|range| self.solved(range).and_then(|problem| camera(&problem)).ok());
        let between = match &halves {
            [Some(a), Some(b)] => 0.5 * (logarithm(a) - logarithm(b)).abs(),
            _ => 0.0,
        };
        Ok(SelfCalibration {
            camera: camera(whole)?,
            focal_deviation: (solution.deviations[0] * shared).max(between),
            keyframes,
            observations,
            residual: solution.residual,
        })
    }
}

/// The lens of a problem that is solved.
fn camera(problem: &Problem) -> Result<Camera, SelfCalibrationError> {
    problem.lens(&problem.terms).ok_or(SelfCalibrationError::Undetermined)
}

/// Of the focal length.
fn logarithm(camera: &Camera) -> f64 {
    camera.intrinsics().fx.ln()
}
