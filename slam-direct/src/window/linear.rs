//! Normal equations of the window: accumulated per pair of frames, depths eliminated.

use super::problem::{Problem, mahalanobis, predict, robust_weight};
use geometry::Se3;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Vector3, Vector6};

/// Relative pose of an ordered pair (host, frame) and what its observations add.
struct Pair {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    adjoint: Matrix6<f64>,
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
    used: bool,
}

/// One observation's coupling between its depth and its relative pose: `J_ξᵀ W J_ρ`.
type Coupling = Vector6<f64>;

/// The linearised window.
pub(super) struct Normal {
    /// Index of each frame's block in the reduced system; `None` for fixed frames.
    pub block: Vec<Option<usize>>,
    /// Pose Hessian before the depths are eliminated.
    hessian: DMatrix<f64>,
    /// Pose gradient likewise.
    gradient: DVector<f64>,
    /// Per observation.
    coupling: Vec<Coupling>,
    /// Per point: `Σ J_ρᵀ W J_ρ` and `Σ J_ρᵀ W r`.
    depth: Vec<(f64, f64)>,
    pairs: Vec<Pair>,
    frames: usize,
}

impl Normal {
    /// Linearises `problem` at its present values.
    pub fn new(problem: &Problem) -> Self {
        let frames = problem.frames.len();
        let mut next = 0;
        let block: Vec<Option<usize>> = problem
            .fixed
            .iter()
            .map(|fixed| {
                (!fixed).then(|| {
                    next += 1;
                    next - 1
                })
            })
            .collect();
        let mut normal = Self {
            block,
            hessian: DMatrix::zeros(6 * next, 6 * next),
            gradient: DVector::zeros(6 * next),
            coupling: vec![Coupling::zeros(); problem.observations.len()],
            depth: vec![(0.0, 0.0); problem.points.len()],
            pairs: pairs(&problem.frames),
            frames,
        };
        for index in 0..problem.points.len() {
            normal.add_point(problem, index);
        }
        normal.gather_pairs();
        normal
    }

    fn add_point(&mut self, problem: &Problem, index: usize) {
        let point = &problem.points[index];
        for i in point.observations.clone() {
            let seen = &problem.observations[i];
            let pair = &mut self.pairs[point.host * self.frames + seen.frame];
            let Some(p) = predict(
                &problem.camera,
                &pair.rotation,
                &pair.translation,
                &point.ray,
                point.inverse_depth,
                &seen.pixel,
            ) else {
                continue;
            };
            let weight = robust_weight(mahalanobis(&p.residual, &seen.information));
            let [a, b, c] = seen.information.map(|v| v * weight);
            let wr = [a * p.residual[0] + b * p.residual[1], b * p.residual[0] + c * p.residual[1]];
            let jr = p.by_inverse_depth;
            let wj = [a * jr[0] + b * jr[1], b * jr[0] + c * jr[1]];
            self.depth[index].0 += jr[0] * wj[0] + jr[1] * wj[1];
            self.depth[index].1 += jr[0] * wr[0] + jr[1] * wr[1];
            let [ju, jv] = p.by_twist;
            self.coupling[i] = Vector6::from_fn(|k, _| ju[k] * wj[0] + jv[k] * wj[1]);
            pair.used = true;
            for k in 0..6 {
                let (wu, wv) = (a * ju[k] + b * jv[k], b * ju[k] + c * jv[k]);
                for l in k..6 {
                    pair.hessian[(k, l)] += wu * ju[l] + wv * jv[l];
                }
                pair.gradient[k] += ju[k] * wr[0] + jv[k] * wr[1];
            }
        }
    }

    /// Carries each pair's sums to the poses: `δ_frame·host = δ_frame − Ad δ_host`.
    fn gather_pairs(&mut self) {
        for host in 0..self.frames {
            for frame in 0..self.frames {
                let pair = &mut self.pairs[host * self.frames + frame];
                if !pair.used {
                    continue;
                }
                pair.hessian.fill_lower_triangle_with_upper_triangle();
                let (h, ad) = (pair.hessian, pair.adjoint);
                let (f, o) = (self.block[frame], self.block[host]);
                if let Some(f) = f {
                    let mut view = self.hessian.fixed_view_mut::<6, 6>(6 * f, 6 * f);
                    view += h;
                    let mut g = self.gradient.fixed_rows_mut::<6>(6 * f);
                    g += pair.gradient;
                }
                if let Some(o) = o {
                    let mut view = self.hessian.fixed_view_mut::<6, 6>(6 * o, 6 * o);
                    view += ad.transpose() * h * ad;
                    let mut g = self.gradient.fixed_rows_mut::<6>(6 * o);
                    g -= ad.transpose() * pair.gradient;
                }
                if let (Some(f), Some(o)) = (f, o) {
                    let cross = -(h * ad);
                    let mut view = self.hessian.fixed_view_mut::<6, 6>(6 * f, 6 * o);
                    view += cross;
                    let mut view = self.hessian.fixed_view_mut::<6, 6>(6 * o, 6 * f);
                    view += cross.transpose();
                }
            }
        }
    }

    /// Solves for pose steps and depth steps with Levenberg–Marquardt damping `lambda`.
    /// `None` when the damped system is not positive definite.
    pub fn step(&self, problem: &Problem, lambda: f64) -> Option<(Vec<Vector6<f64>>, Vec<f64>)> {
        let mut h = self.hessian.clone();
        let mut g = self.gradient.clone();
        self.eliminate_depths(problem, lambda, &mut h, &mut g);
        for i in 0..h.nrows() {
            h[(i, i)] += lambda * self.hessian[(i, i)] + 1e-9;
        }
        let delta = if h.nrows() == 0 { g } else { -solve_dense(h, g)? };
        let pose: Vec<Vector6<f64>> = self
            .block
            .iter()
            .map(|b| b.map_or(Vector6::zeros(), |b| delta.fixed_rows::<6>(6 * b).into_owned()))
            .collect();
        let depth = self.depth_steps(problem, lambda, &pose);
        Some((pose, depth))
    }

    /// Schur complement over the depths.
    fn eliminate_depths(&self, problem: &Problem, lambda: f64, h: &mut DMatrix<f64>, g: &mut DVector<f64>) {
        let mut rows: Vec<(usize, Vector6<f64>)> = Vec::new();
        for (point, &(hessian, gradient)) in problem.points.iter().zip(&self.depth) {
            if hessian <= 0.0 {
                continue;
            }
            rows.clear();
            let mut host = Vector6::zeros();
            for i in point.observations.clone() {
                let frame = problem.observations[i].frame;
                let e = self.coupling[i];
                if let Some(f) = self.block[frame] {
                    rows.push((f, e));
                }
                host -= self.pairs[point.host * self.frames + frame].adjoint.tr_mul(&e);
            }
            if let Some(o) = self.block[point.host] {
                rows.push((o, host));
            }
            let inverse = 1.0 / (hessian * (1.0 + lambda));
            for &(bi, ei) in &rows {
                let scaled = ei * inverse;
                for &(bj, ej) in rows.iter().filter(|r| r.0 <= bi) {
                    // The lower triangle suffices for the Cholesky factorisation.
                    let mut view = h.fixed_view_mut::<6, 6>(6 * bi, 6 * bj);
                    view.ger(-1.0, &scaled, &ej, 1.0);
                }
                let mut view = g.fixed_rows_mut::<6>(6 * bi);
                view.axpy(-gradient, &scaled, 1.0);
            }
        }
    }

    fn depth_steps(&self, problem: &Problem, lambda: f64, pose: &[Vector6<f64>]) -> Vec<f64> {
        let relative: Vec<Vector6<f64>> = (0..self.pairs.len())
            .map(|i| match self.pairs[i].used {
                true => pose[i % self.frames] - self.pairs[i].adjoint * pose[i / self.frames],
                false => Vector6::zeros(),
            })
            .collect();
        problem
            .points
            .iter()
            .zip(&self.depth)
            .map(|(point, &(hessian, gradient))| {
                if hessian <= 0.0 {
                    return 0.0;
                }
                let coupled: f64 = point
                    .observations
                    .clone()
                    .map(|i| {
                        let pair = point.host * self.frames + problem.observations[i].frame;
                        self.coupling[i].dot(&relative[pair])
                    })
                    .sum();
                -(gradient + coupled) / (hessian * (1.0 + lambda))
            })
            .collect()
    }

    /// Information of each point's inverse depth given the poses.
    pub fn depth_information(&self) -> impl Iterator<Item = f64> + '_ {
        self.depth.iter().map(|d| d.0)
    }
}

fn pairs(frames: &[Se3]) -> Vec<Pair> {
    let inverse: Vec<Se3> = frames.iter().map(Se3::inverse).collect();
    let pair = |host: usize, frame: usize| {
        let relative = frames[frame] * inverse[host];
        Pair {
            rotation: relative.rotation_matrix(),
            translation: relative.translation,
            adjoint: relative.adjoint(),
            hessian: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            used: false,
        }
    };
    (0..frames.len())
        .flat_map(|host| (0..frames.len()).map(move |frame| (host, frame)))
        .map(|(h, f)| pair(h, f))
        .collect()
}

/// Solves `h x = g` from the lower triangle of `h` by Cholesky.
fn solve_dense(h: DMatrix<f64>, g: DVector<f64>) -> Option<DVector<f64>> {
    let n = h.nrows();
    let mat = faer::Mat::<f64>::from_fn(n, n, |i, j| h[(i, j)]);
    let factor = mat.llt(faer::Side::Lower).ok()?;
    let rhs = faer::Mat::<f64>::from_fn(n, 1, |i, _| g[i]);
    let x = faer::linalg::solvers::Solve::solve(&factor, &rhs);
    let x = DVector::from_fn(n, |i, _| x[(i, 0)]);
    x.iter().all(|v| v.is_finite()).then_some(x)
}

#[cfg(test)]
mod tests;
