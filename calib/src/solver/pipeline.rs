//! From views to a calibrated camera, or to the reason why there is none.

use super::bundle::{Problem, State};
use super::calibration::{Calibration, FittedCorner, FittedView};
use super::planar::{MIN_CORNERS, homography};
use super::uncertainty::{Estimate, covariance, estimates};
use super::{LensModel, Refusal, View, initial};
use crate::Board;
use geometry::{Camera, Se3, median};
use nalgebra::{Vector2, Vector3};

/// Rounds of adjusting and setting aside what does not fit.
const ROUNDS: usize = 8;
/// Iterations of each adjustment.
const ITERATIONS: usize = 60;
/// Median of a length whose two components are normal with deviation 1 (Rayleigh).
const RAYLEIGH_MEDIAN: f64 = 1.177_41;
/// Corners are never held to less than this, pixels: detection of simulated images may be nearly perfect.
const MIN_SIGMA: f64 = 0.02;

/// How views are judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverParams {
    /// Fewest views. Default 3: fewer leave focal length and principal point to chance.
    pub min_views: usize,
    /// Corners farther from where they should be than so many standard deviations are set aside. Default 5.
    pub corner_gate: f64,
    /// Corners nearer than this to where the judging model has them are never set aside, pixels. Default 1: detection
    /// alone is rarely wrong by less, and corners that bend the most are those at the edge, which matter the most.
    pub min_gate: f64,
    /// Corners that the calibrated model misses by more than this are set aside too, pixels. Default 3: of a lens that
    /// the model does not fit at the very edge, those corners would bend it everywhere else.
    pub gross: f64,
    /// Views whose rms is above so many times that of the others (median) are set aside. Default 3.
    pub view_gate: f64,
    /// Largest share of a view's corners that may be set aside before the view is. Default 0.25.
    pub max_outlier_share: f64,
    /// Largest uncertainty of a focal length, as a share of it, and of the principal point, as a share of the
    /// image's width. Default 0.01.
    pub max_uncertainty: f64,
    /// Largest rms as a share of the image's diagonal. Default 0.003, 2.4 pixels of 640×480.
    pub max_rms: f64,
}

impl Default for SolverParams {
    fn default() -> Self {
        Self {
            min_views: 3,
            corner_gate: 5.0,
            min_gate: 1.0,
            gross: 3.0,
            view_gate: 3.0,
            max_outlier_share: 0.25,
            max_uncertainty: 0.01,
            max_rms: 0.003,
        }
    }
}

/// Calibrates a camera whose images have `size` (width, height).
///
/// # Errors
/// When the views do not make a calibration; says why, and which views would.
pub fn calibrate(
    board: &Board,
    views: &[View],
    size: (usize, usize),
    model: LensModel,
    params: &SolverParams,
) -> Result<Calibration, Refusal> {
    let points = board.points();
    check_corners(views, points.len())?;
    let mut judge = Work::new(&points, views, size, model.judge(), params);
    let usable = judge.usable.iter().filter(|usable| **usable).count();
    if usable < params.min_views {
        return Err(Refusal::TooFewViews { usable, given: views.len(), needed: params.min_views });
    }
    let state = judge.adjusted()?;
    let most_flexible = (judge.model, judge.rms(&state));
    let kept = judge.kept().count();
    if kept < params.min_views || 2 * kept < usable {
        return Err(Refusal::FewFit { kept, usable });
    }
    let mut work = Work { model, ..judge };
    let state = work.settled()?;
    Ok(Calibration { most_flexible, ..work.result(&state)? })
}

/// Whether all corners are on a board of `count` corners.
pub(super) fn check_corners(views: &[View], count: usize) -> Result<(), Refusal> {
    for view in views {
        if let Some(corner) = view.corners.iter().find(|corner| corner.index >= count) {
            return Err(Refusal::NoSuchCorner { view: view.name.clone(), index: corner.index, count });
        }
    }
    Ok(())
}

/// What is worked on: which corners are used.
struct Work<'a> {
    points: &'a [Vector3<f64>],
    views: &'a [View],
    size: (usize, usize),
    model: LensModel,
    params: &'a SolverParams,
    /// Views with enough corners, not along a line.
    usable: Vec<bool>,
    /// Why views are set aside.
    rejected: Vec<Option<String>>,
    /// Which corners are used.
    used: Vec<Vec<bool>>,
}

impl<'a> Work<'a> {
    fn new(
        points: &'a [Vector3<f64>],
        views: &'a [View],
        size: (usize, usize),
        model: LensModel,
        params: &'a SolverParams,
    ) -> Self {
        let usable: Vec<bool> = views
            .iter()
            .map(|view| {
                view.corners.len() >= MIN_CORNERS
                    && homography(&initial::pairs(points, &view.corners)).is_some()
            })
            .collect();
        let reason = |view: &View| format!("{} corners are too few to place the board", view.corners.len());
        let rejected = usable.iter().zip(views).map(|(ok, view)| (!ok).then(|| reason(view))).collect();
        let used = views.iter().map(|view| vec![true; view.corners.len()]).collect();
        Self { points, views, size, model, params, usable, rejected, used }
    }

    /// Indices of the views that are used.
    fn kept(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.views.len()).filter(|&i| self.rejected[i].is_none())
    }

    fn problem(&self, indices: &[usize], huber: f64) -> Problem<'a> {
        let corners = |&i: &usize| {
            let used = self.views[i].corners.iter().zip(&self.used[i]).filter(|(_, used)| **used);
            used.map(|(corner, _)| *corner).collect()
        };
        let views = indices.iter().map(corners).collect();
        Problem { model: self.model, size: self.size, points: self.points, views, huber }
    }

    /// Adjusts, sets aside what does not fit, until that stays the same. Returns the camera of the kept views.
    fn adjusted(&mut self) -> Result<State, Refusal> {
        let mut indices: Vec<usize> = self.kept().collect();
        let mut state = initial::start(&self.problem(&indices, 1.0)).ok_or(Refusal::NoStart)?;
        for _ in 0..ROUNDS {
            let huber = 1.5 * self.sigma(&state, &indices).max(MIN_SIGMA);
            state = self.problem(&indices, huber).solve(state, ITERATIONS);
            let before = (self.used.clone(), indices.clone());
            let parameters = state.parameters;
            self.sort_out(&state, &indices);
            indices = self.kept().collect();
            if indices.len() < self.params.min_views {
                break;
            }
            let camera = self.model.camera(self.size, &parameters).map_err(|_| Refusal::NoStart)?;
            let poses = indices.iter().map(|&i| self.pose(&camera, &parameters, i));
            let poses: Option<Vec<Se3>> = poses.collect();
            state = State { parameters, poses: poses.ok_or(Refusal::NoStart)? };
            if before == (self.used.clone(), indices.clone()) {
                break;
            }
        }
        Ok(self.problem(&indices, f64::INFINITY).solve(state, ITERATIONS))
    }

    /// Adjusts to the corners that are used, but for those that are off by [`SolverParams::gross`].
    fn settled(&mut self) -> Result<State, Refusal> {
        let indices: Vec<usize> = self.kept().collect();
        let mut state = initial::start(&self.problem(&indices, 1.0)).ok_or(Refusal::NoStart)?;
        state = self.problem(&indices, f64::INFINITY).solve(state, ITERATIONS);
        for _ in 0..ROUNDS {
            let camera = self.model.camera(self.size, &state.parameters).map_err(|_| Refusal::NoStart)?;
            let mut dropped = false;
            for (&i, pose) in indices.iter().zip(&state.poses) {
                let lengths = self.lengths(&camera, pose, i);
                for (used, length) in self.used[i].iter_mut().zip(lengths) {
                    dropped |= *used && length > self.params.gross;
                    *used &= length <= self.params.gross;
                }
            }
            if !dropped {
                break;
            }
            state = self.problem(&indices, f64::INFINITY).solve(state, ITERATIONS);
        }
        Ok(state)
    }

    /// The pose of a view for a known camera, from its used corners, by a robust fit.
    fn pose(&self, camera: &Camera, parameters: &super::model::Parameters, index: usize) -> Option<Se3> {
        let problem = self.problem(&[index], 1.0);
        let pose = initial::board_pose(camera, self.points, &problem.views[0])
            .or_else(|| initial::board_pose(camera, self.points, &self.views[index].corners))?;
        let state = problem.solve_poses(State { parameters: *parameters, poses: vec![pose] }, 20);
        state.poses.first().copied()
    }

    /// Lengths of the residuals of all corners of a view.
    fn lengths(&self, camera: &Camera, pose: &Se3, index: usize) -> Vec<f64> {
        let problem = self.problem(&[], f64::INFINITY);
        let corners = self.views[index].corners.iter();
        corners.map(|corner| problem.residual(camera, pose, corner).map_or(f64::MAX, |r| r.norm())).collect()
    }

    /// Standard deviation of a residual's component, from the median length, over the used views' corners.
    fn sigma(&self, state: &State, indices: &[usize]) -> f64 {
        let Ok(camera) = self.model.camera(self.size, &state.parameters) else { return 1.0 };
        let of_view = |(&i, pose): (&usize, &Se3)| self.lengths(&camera, pose, i);
        let mut all: Vec<f64> = indices.iter().zip(&state.poses).flat_map(of_view).collect();
        median(&mut all).unwrap_or(0.0) / RAYLEIGH_MEDIAN
    }

    /// Decides anew which corners and views are used.
    fn sort_out(&mut self, state: &State, indices: &[usize]) {
        let Ok(camera) = self.model.camera(self.size, &state.parameters) else { return };
        let gate = (self.params.corner_gate * self.sigma(state, indices)).max(self.params.min_gate);
        let all: Vec<usize> = (0..self.views.len()).filter(|&i| self.usable[i]).collect();
        let mut lengths = vec![Vec::new(); self.views.len()];
        for &i in &all {
            let known = indices.iter().position(|&kept| kept == i).map(|at| state.poses[at]);
            let Some(pose) = known.or_else(|| self.pose(&camera, &state.parameters, i)) else {
                lengths[i] = vec![f64::MAX; self.views[i].corners.len()];
                continue;
            };
            lengths[i] = self.lengths(&camera, &pose, i);
        }
        let rms = |lengths: &[f64]| mean_square(lengths.iter().copied()).sqrt();
        let typical = median(&mut all.iter().map(|&i| rms(&lengths[i])).collect::<Vec<f64>>()).unwrap_or(0.0);
        for i in all {
            let outliers = lengths[i].iter().filter(|length| **length > gate).count();
            let (count, of_view) = (lengths[i].len(), rms(&lengths[i]));
            let too_many = outliers as f64 > self.params.max_outlier_share * count as f64;
            let inliers: Vec<f64> = lengths[i].iter().copied().filter(|length| *length <= gate).collect();
            let worse = rms(&inliers) > self.params.view_gate * typical.max(MIN_SIGMA);
            self.rejected[i] = if too_many || count - outliers < MIN_CORNERS {
                Some(format!("{outliers} of {count} corners do not fit (rms {})", display_text(of_view)))
            } else if worse {
                Some(format!("rms {} where the others have {}", display_text(of_view), display_text(typical)))
            } else {
                None
            };
            // A view set aside is fitted by all its corners: which of them are wrong is not known.
            let keep_all = self.rejected[i].is_some();
            self.used[i] = lengths[i].iter().map(|length| keep_all || *length <= gate).collect();
        }
    }

    /// Root mean square of the residuals of the corners that are used.
    fn rms(&self, state: &State) -> f64 {
        let problem = self.problem(&self.kept().collect::<Vec<_>>(), f64::INFINITY);
        let count: usize = problem.views.iter().map(Vec::len).sum();
        (problem.cost(state) / count.max(1) as f64).sqrt()
    }

    /// The outcome, if the views determine it.
    fn result(&self, state: &State) -> Result<Calibration, Refusal> {
        let indices: Vec<usize> = self.kept().collect();
        let problem = self.problem(&indices, f64::INFINITY);
        let camera = problem.camera(state).ok_or(Refusal::NoStart)?;
        let corner_count: usize = problem.views.iter().map(Vec::len).sum();
        let rms = self.rms(state);
        let (width, height) = (self.size.0 as f64, self.size.1 as f64);
        if rms > self.params.max_rms * width.hypot(height) {
            return Err(Refusal::PoorFit { rms });
        }
        let unknowns = self.model.parameter_count() + 6 * indices.len();
        let freedom = (2 * corner_count).saturating_sub(unknowns).max(1);
        let variance = problem.cost(state) / freedom as f64;
        let spread = spread(&state.poses);
        let normal = problem.normal(state).ok_or(Refusal::NoStart)?;
        let (covariance, condition) =
            covariance(&normal, self.model, variance).ok_or(Refusal::Singular { spread })?;
        let estimates = estimates(self.model, &state.parameters, &covariance);
        judge(&estimates, spread, width, self.params)?;
        let views = self.fitted(&camera, state, &indices);
        let all = views.iter().filter(|view| view.pose.is_some()).flat_map(|view| &view.corners);
        let rms_of_all = mean_square(all.map(|corner| corner.residual.norm())).sqrt();
        let model = self.model;
        Ok(Calibration {
            camera,
            model,
            estimates,
            covariance,
            condition,
            rms,
            rms_of_all,
            most_flexible: (model, rms),
            corner_count,
            views,
        })
    }

    fn fitted(&self, camera: &Camera, state: &State, indices: &[usize]) -> Vec<FittedView> {
        let problem = self.problem(&[], f64::INFINITY);
        let of_view = |(i, view): (usize, &View)| {
            let kept = indices.iter().position(|&kept| kept == i).map(|at| state.poses[at]);
            let other = || self.usable[i].then(|| self.pose(camera, &state.parameters, i)).flatten();
            let pose = kept.or_else(other);
            let corners = view.corners.iter().zip(&self.used[i]).map(|(corner, used)| FittedCorner {
                corner: *corner,
                residual: pose
                    .and_then(|pose| problem.residual(camera, &pose, corner))
                    .unwrap_or(Vector2::repeat(f64::NAN)),
                used: kept.is_some() && *used,
            });
            let corners: Vec<FittedCorner> = corners.collect();
            let counted = corners.iter().filter(|corner| corner.used || kept.is_none());
            let rms = mean_square(counted.map(|corner| corner.residual.norm())).sqrt();
            FittedView { name: view.name.clone(), pose, rms, corners, rejected: self.rejected[i].clone() }
        };
        self.views.iter().enumerate().map(of_view).collect()
    }
}

/// Whether focal length and principal point are known well enough.
fn judge(estimates: &[Estimate], spread: f64, width: f64, params: &SolverParams) -> Result<(), Refusal> {
    let weak = |name: &str| {
        let limit = params.max_uncertainty * if name.starts_with('f') { 1.0 } else { width };
        estimates
            .iter()
            .find(|e| e.name == name)
            .filter(|e| e.sigma > limit * if name.starts_with('f') { e.value } else { 1.0 })
    };
    let Some(worst) = ["fx", "fy", "cx", "cy"].into_iter().find_map(weak) else { return Ok(()) };
    if spread < 10.0 {
        return Err(Refusal::OneDirection { spread, fx: estimates[0].clone() });
    }
    Err(Refusal::NotDetermined(worst.clone()))
}

/// Largest angle between the directions of the board in two views, degrees.
fn spread(poses: &[Se3]) -> f64 {
    let normals: Vec<Vector3<f64>> = poses.iter().map(|pose| pose.rotation * Vector3::z()).collect();
    let angle = |a: &Vector3<f64>, b: &Vector3<f64>| a.dot(b).clamp(-1.0, 1.0).acos().to_degrees();
    normals.iter().flat_map(|a| normals.iter().map(move |b| angle(a, b))).fold(0.0, f64::max)
}

/// Mean of the squares of what is finite; 0 of nothing.
fn mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values
        .filter(|v| v.is_finite() && *v < f64::MAX)
        .fold((0.0, 0usize), |(sum, count), v| (sum + v * v, count + 1));
    sum / count.max(1) as f64
}

fn display_text(pixels: f64) -> String {
    if pixels < 1000.0 { format!("{pixels:.2} px") } else { "over 1000 px".into() }
}
