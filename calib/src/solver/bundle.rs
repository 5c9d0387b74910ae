//! Bundle adjustment: parameters of the camera and a pose for each view, by Levenberg–Marquardt.

use super::model::{MAX_PARAMETERS, Parameters};
use super::{Corner, LensModel};
use faer::linalg::solvers::Solve;
use geometry::{Camera, Se3, hat};
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3, Matrix6, SMatrix, Vector2, Vector3, Vector6};

/// Residual that stands for a corner the camera cannot see, pixels: worse than any that is seen, and without slope.
const UNSEEN: f64 = 100.0;
/// Steps that improve the cost by less than this share end the search.
const MIN_IMPROVEMENT: f64 = 1e-12;

type Reduced = SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>;
type Mixed = SMatrix<f64, 6, MAX_PARAMETERS>;

/// What is adjusted: the camera's parameters, and camera_from_board of each view.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub parameters: Parameters,
    pub poses: Vec<Se3>,
}

/// What it is adjusted to.
pub(crate) struct Problem<'a> {
    pub model: LensModel,
    pub size: (usize, usize),
    pub points: &'a [Vector3<f64>],
    /// The corners of each view.
    pub views: Vec<Vec<Corner>>,
    /// Residuals beyond this count linearly (Huber), pixels.
    pub huber: f64,
}

/// Normal equations, view by view: `H` and gradient of half the squared residuals.
pub(crate) struct Normal {
    cost: f64,
    shared: Reduced,
    shared_right: Parameters,
    views: Vec<ViewNormal>,
}

struct ViewNormal {
    shared: Reduced,
    shared_right: Parameters,
    own: Matrix6<f64>,
    mixed: Mixed,
    right: Vector6<f64>,
}

impl ViewNormal {
    fn zero() -> Self {
        Self {
            shared: Reduced::zeros(),
            shared_right: Parameters::zeros(),
            own: Matrix6::zeros(),
            mixed: Mixed::zeros(),
            right: Vector6::zeros(),
        }
    }

    /// What the view says of the camera when its pose is adjusted too (Schur complement): information and gradient.
    fn reduced(&self) -> Option<(Reduced, Parameters)> {
        let across = self.mixed.transpose() * self.own.try_inverse()?;
        Some((self.shared - across * self.mixed, self.shared_right - across * self.right))
    }
}

impl Problem<'_> {
    /// The residual of a corner: predicted minus found; `None` where the camera does not see it.
    pub fn residual(&self, camera: &Camera, pose: &Se3, corner: &Corner) -> Option<Vector2<f64>> {
        Some(camera.project(&(*pose * self.points[corner.index]))? - corner.pixel)
    }

    /// The camera of a state; `None` when its parameters describe none.
    pub fn camera(&self, state: &State) -> Option<Camera> {
        self.model.camera(self.size, &state.parameters).ok()
    }

    /// Weight and cost of a squared residual length (Huber).
    fn kernel(&self, squared: f64) -> (f64, f64) {
        let length = squared.sqrt();
        if length <= self.huber {
            (1.0, squared)
        } else {
            (self.huber / length, self.huber * (2.0 * length - self.huber))
        }
    }

    pub fn cost(&self, state: &State) -> f64 {
        let Some(camera) = self.camera(state) else { return f64::INFINITY };
        let of_view = |(corners, pose): (&Vec<Corner>, &Se3)| {
            let squared =
                |corner| self.residual(&camera, pose, corner).map_or(UNSEEN * UNSEEN, |r| r.norm_squared());
            corners.iter().map(|corner| self.kernel(squared(corner)).1).sum::<f64>()
        };
        self.views.iter().zip(&state.poses).map(of_view).sum()
    }

    pub fn normal(&self, state: &State) -> Option<Normal> {
        let camera = self.camera(state)?;
        let mut normal = Normal {
            cost: self.cost(state),
            shared: Reduced::zeros(),
            shared_right: Parameters::zeros(),
            views: Vec::with_capacity(self.views.len()),
        };
        for (corners, pose) in self.views.iter().zip(&state.poses) {
            let mut view = ViewNormal::zero();
            for corner in corners {
                let point = *pose * self.points[corner.index];
                let Some((pixel, by_point, by_shared)) = self.model.project(&camera, &point) else {
                    continue;
                };
                let residual = pixel - corner.pixel;
                let by_pose = by_pose(&by_point, &point);
                let (weight, _) = self.kernel(residual.norm_squared());
                view.own += by_pose.transpose() * by_pose * weight;
                view.mixed += by_pose.transpose() * by_shared * weight;
                view.right += by_pose.transpose() * residual * weight;
                view.shared += by_shared.transpose() * by_shared * weight;
                view.shared_right += by_shared.transpose() * residual * weight;
            }
            normal.shared += view.shared;
            normal.shared_right += view.shared_right;
            normal.views.push(view);
        }
        Some(normal)
    }

    /// Adjusts all of the state.
    pub fn solve(&self, state: State, iterations: usize) -> State {
        self.descend(state, iterations, self.model.parameter_count())
    }

    /// Adjusts the poses alone.
    pub fn solve_poses(&self, state: State, iterations: usize) -> State {
        self.descend(state, iterations, 0)
    }

    /// Adjusts the poses and the first `free` parameters.
    fn descend(&self, mut state: State, iterations: usize, free: usize) -> State {
        let mut damping = 1e-4;
        for _ in 0..iterations {
            let Some(normal) = self.normal(&state) else { return state };
            let better = (0..12).find_map(|_| {
                let candidate = normal.step(&state, damping, free);
                let cost = candidate.as_ref().map_or(f64::INFINITY, |candidate| self.cost(candidate));
                if cost < normal.cost {
                    damping = (damping * 0.2).max(1e-12);
                    return candidate.map(|candidate| (candidate, cost));
                }
                damping *= 8.0;
                None
            });
            let Some((candidate, cost)) = better else { return state };
            state = candidate;
            if normal.cost - cost <= MIN_IMPROVEMENT * normal.cost {
                return state;
            }
        }
        state
    }
}

/// Derivative of a pixel by a small motion `exp(δ)` after the pose, δ = (υ, ω).
fn by_pose(by_point: &Matrix2x3<f64>, point: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
    let mut motion = SMatrix::<f64, 3, 6>::zeros();
    motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&-hat(point));
    by_point * motion
}

impl Normal {
    /// The state after a damped step; `None` when the equations cannot be solved.
    fn step(&self, state: &State, damping: f64, free: usize) -> Option<State> {
        let mut reduced = damped(self.shared, damping);
        let mut right = self.shared_right;
        let mut inverses = Vec::with_capacity(self.views.len());
        for view in &self.views {
            let inverse = damped(view.own, damping).try_inverse()?;
            reduced -= view.mixed.transpose() * inverse * view.mixed;
            right -= view.mixed.transpose() * inverse * view.right;
            inverses.push(inverse);
        }
        let shared_step = -solve_leading(&reduced, &right, free)?;
        let poses = state.poses.iter().zip(&self.views).zip(&inverses).map(|((pose, view), inverse)| {
            let step = -(inverse * (view.right + view.mixed * shared_step));
            (Se3::exp(&step) * *pose).renormalized()
        });
        Some(State { parameters: state.parameters + shared_step, poses: poses.collect() })
    }

    /// What each view says of the camera's first `count` parameters when the poses are adjusted too: information and
    /// gradient.
    pub fn by_view(&self, count: usize) -> Option<Vec<(DMatrix<f64>, DVector<f64>)>> {
        let leading = |(information, gradient): (Reduced, Parameters)| {
            let information = DMatrix::from_fn(count, count, |i, j| information[(i, j)]);
            (information, DVector::from_fn(count, |i, _| gradient[i]))
        };
        self.views.iter().map(|view| view.reduced().map(leading)).collect()
    }
}

/// With a share of the diagonal added (Marquardt 1963).
fn damped<const N: usize>(mut matrix: SMatrix<f64, N, N>, damping: f64) -> SMatrix<f64, N, N> {
    for i in 0..N {
        matrix[(i, i)] += damping * matrix[(i, i)].max(1e-12);
    }
    matrix
}

/// Solves the leading `count` equations; the other unknowns are zero.
fn solve_leading(matrix: &Reduced, right: &Parameters, count: usize) -> Option<Parameters> {
    let mut solution = Parameters::zeros();
    if count == 0 {
        return Some(solution);
    }
    let leading = faer::Mat::<f64>::from_fn(count, count, |i, j| matrix[(i, j)]);
    let factor = leading.llt(faer::Side::Lower).ok()?;
    let found = factor.solve(&faer::Mat::<f64>::from_fn(count, 1, |i, _| right[i]));
    for i in 0..count {
        solution[i] = found[(i, 0)];
    }
    solution.iter().all(|v| v.is_finite()).then_some(solution)
}
