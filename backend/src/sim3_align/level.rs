//! Levenberg–Marquardt at one pyramid level.

use super::residual::{PointTerm, Projector, State};
use super::{AlignRefusal, KeyframeView, Matrix9, Sim3AlignParams, Vector9};
use crate::Descent;

/// Where (υ, ω, a, b) of the photometric Jacobian lie among the nine unknowns.
const PHOTOMETRIC: [usize; 8] = [0, 1, 2, 3, 4, 5, 7, 8];
/// Where (υz, ωx, ωy, λ) of the depth Jacobian lie.
const DEPTH: [usize; 4] = [2, 3, 4, 6];

/// The alignment at one level.
pub(super) struct LevelProblem<'a> {
    source: &'a KeyframeView,
    target: &'a KeyframeView,
    level: usize,
    params: &'a Sim3AlignParams,
}

/// Normal equations and statistics at a state.
#[derive(Clone, Debug)]
pub(super) struct Linearisation {
    /// `Σ w Jᵀ J / σ²` over (υ, ω, λ, a, b).
    pub hessian: Matrix9,
    /// `Σ w Jᵀ r / σ²`.
    pub gradient: Vector9,
    /// Points that project into the target.
    pub used: usize,
    /// Each point stands for so many of the source.
    pub stride: usize,
    energy: f64,
    points: usize,
    with_depth: usize,
    inliers: usize,
    photometric_squares: f64,
}

impl Linearisation {
    /// Mean Huber energy per residual, 1 when the residuals fit their variances.
    pub(super) fn mean_energy(&self) -> f64 {
        self.energy / (self.used + self.with_depth).max(1) as f64
    }

    /// Share of the used points within the Huber width.
    pub(super) fn inlier_share(&self) -> f32 {
        self.inliers as f32 / self.used.max(1) as f32
    }

    /// Share of the source's points that project into the target.
    pub(super) fn overlap(&self) -> f32 {
        self.used as f32 / self.points.max(1) as f32
    }

    /// Share of the used points with a depth in the target.
    pub(super) fn depth_overlap(&self) -> f32 {
        self.with_depth as f32 / self.used.max(1) as f32
    }

    /// Root mean square photometric residual, grey levels.
    pub(super) fn photometric_rmse(&self) -> f32 {
        (self.photometric_squares / self.used.max(1) as f64).sqrt() as f32
    }

    /// Adds a point under the joint Huber weight: a point whose depth disagrees (an occlusion) does
    /// not pull photometrically either (Engel 2014, Eq. 16).
    fn add(&mut self, term: &PointTerm, huber_width: f64) {
        let photometric = term.photometric * term.photometric / term.photometric_variance;
        let depth = term.depth.map_or(0.0, |d| d.residual * d.residual / d.variance);
        let norm = (photometric + depth).sqrt();
        let weight = if norm <= huber_width { 1.0 } else { huber_width / norm };
        self.energy += weight * (2.0 - weight) * (photometric + depth);
        self.used += 1;
        self.inliers += (norm <= huber_width) as usize;
        self.photometric_squares += term.photometric * term.photometric;
        let scale = weight / term.photometric_variance;
        self.accumulate(&PHOTOMETRIC, &term.photometric_by, term.photometric, scale);
        if let Some(depth) = term.depth {
            self.with_depth += 1;
            self.accumulate(&DEPTH, &depth.by, depth.residual, weight / depth.variance);
        }
    }

    /// Adds one residual to the upper triangle.
    #[inline]
    fn accumulate<const N: usize>(&mut self, index: &[usize; N], by: &[f64; N], residual: f64, scale: f64) {
        for i in 0..N {
            let scaled = scale * by[i];
            self.gradient[index[i]] += scaled * residual;
            for j in i..N {
                self.hessian[(index[i], index[j])] += scaled * by[j];
            }
        }
    }
}

impl<'a> LevelProblem<'a> {
    /// The problem at `level`.
    pub(super) fn new(
        source: &'a KeyframeView,
        target: &'a KeyframeView,
        level: usize,
        params: &'a Sim3AlignParams,
    ) -> Self {
        Self { source, target, level, params }
    }

    /// Residuals of all points at a state.
    fn linearise(&self, state: &State) -> Linearisation {
        let image = self.target.pyramid().level(self.level);
        let depth = self.target.depth(self.level);
        let cameras = [self.source, self.target].map(|view| view.camera().at_level(self.level));
        let projector = Projector::new(state, cameras, image, depth, self.params);
        let intensities = self.source.pyramid().level(self.level);
        let all = &self.source.depth(self.level).points;
        let stride = all.len().div_ceil(self.params.max_points.max(1)).max(1);
        let points = all.iter().step_by(stride);
        let mut sum = Linearisation {
            hessian: Matrix9::zeros(),
            gradient: Vector9::zeros(),
            used: 0,
            stride,
            energy: 0.0,
            points: points.len(),
            with_depth: 0,
            inliers: 0,
            photometric_squares: 0.0,
        };
        for point in points {
            let intensity = intensities.get(point.x as usize, point.y as usize);
            if let Some(term) = projector.evaluate(point, intensity) {
                sum.add(&term, self.params.huber_width);
            }
        }
        sum.hessian.fill_lower_triangle_with_upper_triangle();
        sum
    }

    /// What starts are compared by, lower is better: points that leave the target count as outliers.
    pub(super) fn score(&self, linear: &Linearisation) -> f64 {
        let lost = 1.0 - linear.overlap() as f64;
        linear.mean_energy() + lost * self.params.huber_width * self.params.huber_width
    }

    /// Whether enough is seen to go on from here.
    fn check(&self, linear: &Linearisation) -> Result<(), AlignRefusal> {
        if linear.points < self.params.min_points {
            return Err(AlignRefusal::TooFewPoints { points: linear.points, level: self.level });
        }
        if linear.overlap() < self.params.min_overlap {
            return Err(AlignRefusal::OutOfView { share: linear.overlap() });
        }
        if linear.depth_overlap() < self.params.min_depth_overlap {
            return Err(AlignRefusal::TooLittleDepth { share: linear.depth_overlap() });
        }
        Ok(())
    }

    /// Minimises from a state; gives the best state and its linearisation.
    pub(super) fn minimise(&self, start: State) -> Result<(State, Linearisation), AlignRefusal> {
        let linear = self.linearise(&start);
        self.check(&linear)?;
        let descent = Descent {
            iterations: self.params.max_iterations,
            min_decrease: self.params.min_relative_decrease,
            damping: 1e-3,
            eased: (0.3, 1e-6),
            raised: (8.0, 0.0),
            most: 1e5,
        };
        let mut is_degenerate = false;
        let step = |state: &State, linear: &Linearisation, damping: f64| {
            let mut damped = linear.hessian;
            for i in 0..9 {
                // Absolute part: without contrast or depth an unknown has no curvature of its own.
                damped[(i, i)] += damping * damped[(i, i)] + 1e-9;
            }
            let cholesky = damped.cholesky();
            is_degenerate = cholesky.is_none();
            Some(state.updated(&-cholesky?.solve(&linear.gradient)))
        };
        // Leaving the image lowers the energy of what is left: such a step is no progress.
        let linearise = |state: &State| Some(self.linearise(state)).filter(|next| self.check(next).is_ok());
        let found = descent.minimise((start, linear), step, linearise, Linearisation::mean_energy);
        if is_degenerate { Err(AlignRefusal::Degenerate) } else { Ok(found) }
    }
}
