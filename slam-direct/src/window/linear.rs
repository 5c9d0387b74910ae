//! Normal equations of the window: accumulated per pair of frames, depths eliminated.

use super::border::Border;
use super::cost::{mahalanobis, predict, robust_weight};
use super::pairs::{Pairs, Relative};
use super::problem::Problem;
use backend::{BlockSystem, SystemError};
use geometry::sensor::UNKNOWNS;
use nalgebra::{Matrix6, Vector6};

/// What the observations of a pair add, in terms of its relative pose.
#[derive(Clone)]
struct Sum {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
}

/// One observation's coupling between its depth and its relative pose: `J_ξᵀ W J_ρ`.
type Coupling = Vector6<f64>;

/// A step of all unknowns.
pub(super) struct Step {
    /// Left-multiplicative twist of each frame; zero of those that are held.
    pub pose: Vec<Vector6<f64>>,
    /// Of each point's inverse depth.
    pub depth: Vec<f64>,
    /// Of the sensor's unknowns; zero where they are not solved for.
    pub sensor: [f64; UNKNOWNS],
}

/// The linearised window.
pub(super) struct Normal {
    /// Index of each frame's block in the reduced system; `None` for fixed frames.
    block: Vec<Option<usize>>,
    /// Poses before the depths are eliminated.
    system: BlockSystem<6>,
    /// Of the relative pose of each pair; only where the host moves.
    adjoint: Vec<Matrix6<f64>>,
    sums: Vec<Sum>,
    /// Per observation.
    coupling: Vec<Coupling>,
    /// Per point: `Σ J_ρᵀ W J_ρ` and `Σ J_ρᵀ W r`.
    depth: Vec<(f64, f64)>,
    /// What couples the sensor with the rest, where it is solved for.
    border: Option<Border>,
}

geometry::multiversion! {
    /// Adds what all points tell.
    fn add_points(normal: &mut Normal, problem: &Problem, pairs: &Pairs, relative: &[Relative]) {
        for index in 0..problem.points.len() {
            normal.add_point(problem, pairs, relative, index);
        }
    }
}

geometry::multiversion! {
    /// Schur complement over the depths.
    fn eliminate_depths(normal: &mut Normal, problem: &Problem, pairs: &Pairs, lambda: f64) {
        let mut rows: Vec<(usize, Vector6<f64>)> = Vec::new();
        if let Some(border) = &mut normal.border {
            border.damp();
        }
        for (index, (point, &(hessian, gradient))) in problem.points.iter().zip(&normal.depth).enumerate() {
            if hessian <= 0.0 {
                continue;
            }
            rows.clear();
            let host_block = normal.block[point.host];
            let mut host = Vector6::zeros();
            for i in point.observations.clone() {
                let e = normal.coupling[i];
                if let Some(f) = normal.block[problem.observations[i].frame] {
                    rows.push((f, e));
                }
                if host_block.is_some() {
                    host -= normal.adjoint[pairs.of(i)].tr_mul(&e);
                }
            }
            rows.extend(host_block.map(|o| (o, host)));
            let inverse = 1.0 / (hessian * (1.0 + lambda));
            if let Some(border) = &mut normal.border {
                border.eliminate(index, inverse, gradient, &rows);
            }
            for &(bi, ei) in &rows {
                let scaled = ei * -inverse;
                normal.system.reduce_node(bi, &(scaled * ei.transpose()), &(scaled * gradient));
                for &(bj, ej) in rows.iter().filter(|r| r.0 < bi) {
                    normal.system.reduce_pair(normal.system.slot(bi, bj), &(scaled * ej.transpose()));
                }
            }
        }
    }
}

impl Normal {
    /// Makes room for a problem's equations.
    ///
    /// # Errors
    /// When there is not enough memory.
    pub fn new(problem: &Problem, pairs: &Pairs) -> Result<Self, SystemError> {
        let mut next = 0;
        let mut number = |fixed: &bool| {
            next += usize::from(!fixed);
            (!fixed).then(|| next - 1)
        };
        let block: Vec<Option<usize>> = problem.fixed.iter().map(&mut number).collect();
        let none = Sum { hessian: Matrix6::zeros(), gradient: Vector6::zeros() };
        Ok(Self {
            system: BlockSystem::new(next, coupled(problem, &block))?,
            block,
            adjoint: vec![Matrix6::zeros(); pairs.ends.len()],
            sums: vec![none; pairs.ends.len()],
            coupling: vec![Coupling::zeros(); problem.observations.len()],
            depth: vec![(0.0, 0.0); problem.points.len()],
            border: problem
                .calibration
                .as_ref()
                .map(|_| Border::new(next, pairs.ends.len(), problem.points.len())),
        })
    }

    /// Linearises `problem` at its present values, which `relative` belongs to.
    pub fn linearise(&mut self, problem: &Problem, pairs: &Pairs, relative: &[Relative]) {
        for (sum, (adjoint, relative)) in self.sums.iter_mut().zip(self.adjoint.iter_mut().zip(relative)) {
            sum.hessian.fill(0.0);
            sum.gradient.fill(0.0);
            *adjoint = relative.pose.adjoint();
        }
        self.coupling.fill(Coupling::zeros());
        if let (Some(border), Some(calibration)) = (&mut self.border, &problem.calibration) {
            border.begin(calibration);
        }
        add_points(self, problem, pairs, relative);
        self.gather_pairs(pairs);
    }

    #[inline(always)]
    fn add_point(&mut self, problem: &Problem, pairs: &Pairs, relative: &[Relative], index: usize) {
        let point = &problem.points[index];
        let mut depth = (0.0, 0.0);
        let host = problem.calibration.as_ref().map(|calibration| calibration.host_by_unknowns(index));
        for i in point.observations.clone() {
            let seen = &problem.observations[i];
            let pair = pairs.of(i);
            let Relative { pose, rotation } = &relative[pair];
            let predicted = predict(
                &problem.camera,
                rotation,
                &pose.translation,
                &point.ray,
                point.inverse_depth,
                &seen.pixel,
            );
            let Some(p) = predicted else { continue };
            let weight = robust_weight(mahalanobis(&p.residual, &seen.information));
            let [a, b, c] = seen.information.map(|v| v * weight);
            let wr = [a * p.residual[0] + b * p.residual[1], b * p.residual[0] + c * p.residual[1]];
            let jr = p.by_inverse_depth;
            let wj = [a * jr[0] + b * jr[1], b * jr[0] + c * jr[1]];
            depth.0 += jr[0] * wj[0] + jr[1] * wj[1];
            depth.1 += jr[0] * wr[0] + jr[1] * wr[1];
            if let (Some(border), Some(calibration), Some(host)) =
                (&mut self.border, &problem.calibration, &host)
            {
                let by =
                    calibration.by_unknowns(&problem.camera, &relative[pair], (point, host), i, &p.residual);
                border.add(&p, &by, [a, b, c], pair, index);
            }
            if self.block[point.host].or(self.block[seen.frame]).is_none() {
                continue;
            }
            let [ju, jv] = p.by_twist;
            self.coupling[i] = Vector6::from_fn(|k, _| ju[k] * wj[0] + jv[k] * wj[1]);
            let sum = &mut self.sums[pair];
            for k in 0..6 {
                let (wu, wv) = (a * ju[k] + b * jv[k], b * ju[k] + c * jv[k]);
                for l in k..6 {
                    sum.hessian[(k, l)] += wu * ju[l] + wv * jv[l];
                }
                sum.gradient[k] += ju[k] * wr[0] + jv[k] * wr[1];
            }
        }
        self.depth[index] = depth;
    }

    /// Carries each pair's sums to the poses: `δ_frame·host = δ_frame − Ad δ_host`.
    fn gather_pairs(&mut self, pairs: &Pairs) {
        self.system.clear();
        for (&(host, frame), (sum, ad)) in pairs.ends.iter().zip(self.sums.iter_mut().zip(&self.adjoint)) {
            sum.hessian.fill_lower_triangle_with_upper_triangle();
            let (h, g) = (&sum.hessian, &sum.gradient);
            let (f, o) = (self.block[frame], self.block[host]);
            if let Some(f) = f {
                self.system.add_node(f, h, g);
            }
            let Some(o) = o else { continue };
            let coupling = h * ad;
            self.system.add_node(o, &ad.tr_mul(&coupling), &-ad.tr_mul(g));
            match f {
                Some(f) if f > o => self.system.add_pair(self.system.slot(f, o), &-coupling),
                Some(f) => self.system.add_pair(self.system.slot(o, f), &-coupling.transpose()),
                None => {}
            }
        }
        if let Some(border) = &mut self.border {
            border.gather(pairs, &self.adjoint, &self.block);
        }
    }

    /// Solves for pose steps and depth steps with Levenberg–Marquardt damping `lambda`.
    /// `None` when the damped system is not positive definite.
    pub fn step(&mut self, problem: &Problem, pairs: &Pairs, lambda: f64) -> Option<Step> {
        self.system.damp(|diagonal| lambda * diagonal + 1e-9);
        eliminate_depths(self, problem, pairs, lambda);
        let mut delta = self.system.solve()?;
        let sensor = match &self.border {
            Some(border) => border.solve(&mut self.system, &mut delta, lambda)?,
            None => [0.0; UNKNOWNS],
        };
        let pose: Vec<Vector6<f64>> = self
            .block
            .iter()
            .map(|b| b.map_or(Vector6::zeros(), |b| Vector6::from_column_slice(&delta[6 * b..6 * b + 6])))
            .collect();
        let depth = self.depth_steps(problem, pairs, lambda, &pose, &sensor);
        Some(Step { pose, depth, sensor })
    }

    fn depth_steps(
        &self,
        problem: &Problem,
        pairs: &Pairs,
        lambda: f64,
        pose: &[Vector6<f64>],
        sensor: &[f64; UNKNOWNS],
    ) -> Vec<f64> {
        let relative: Vec<Vector6<f64>> = pairs
            .ends
            .iter()
            .zip(&self.adjoint)
            .map(|(&(host, frame), adjoint)| match self.block[host] {
                Some(_) => pose[frame] - adjoint * pose[host],
                None => pose[frame],
            })
            .collect();
        let step = |(index, (point, &(hessian, gradient))): (usize, (&super::WindowPoint, &(f64, f64)))| {
            if hessian <= 0.0 {
                return 0.0;
            }
            let coupled: f64 =
                point.observations.clone().map(|i| self.coupling[i].dot(&relative[pairs.of(i)])).sum();
            let by_sensor = self.border.as_ref().map_or(0.0, |border| border.of_depth(index, sensor));
            -(gradient + coupled + by_sensor) / (hessian * (1.0 + lambda))
        };
        problem.points.iter().zip(&self.depth).enumerate().map(step).collect()
    }

    /// Variance that the poses' uncertainty adds to each point's inverse depth: with `c = H_ρx / H_ρρ`, `cᵀ Σ_xx c`. `None`
    /// when the system is not positive definite.
    pub fn variances_by_poses(&mut self, problem: &Problem, pairs: &Pairs) -> Option<Vec<f64>> {
        self.system.damp(|_| 1e-9);
        eliminate_depths(self, problem, pairs, 0.0);
        self.system.solve()?;
        let blocks = self.block.iter().flatten().count();
        let covariance: Vec<Vec<f64>> = (0..6 * blocks)
            .map(|unknown| {
                let mut column = vec![0.0; 6 * blocks];
                column[unknown] = 1.0;
                self.system.solve_again(&mut column);
                column
            })
            .collect();
        let mut by_pose = vec![Vector6::zeros(); blocks];
        let of_point = |(point, &(hessian, _)): (&super::WindowPoint, &(f64, f64))| {
            if hessian <= 0.0 {
                return 0.0;
            }
            by_pose.fill(Vector6::zeros());
            for i in point.observations.clone() {
                if let Some(frame) = self.block[problem.observations[i].frame] {
                    by_pose[frame] += self.coupling[i];
                }
                if let Some(host) = self.block[point.host] {
                    by_pose[host] -= self.adjoint[pairs.of(i)].tr_mul(&self.coupling[i]);
                }
            }
            quadratic(&by_pose, &covariance) / (hessian * hessian)
        };
        Some(problem.points.iter().zip(&self.depth).map(of_point).collect())
    }

    /// Variances of the sensor's unknowns; `None` when the system is not positive definite, or the sensor is not solved for.
    pub fn sensor_variances(&mut self, problem: &Problem, pairs: &Pairs) -> Option<[f64; UNKNOWNS]> {
        self.border.as_ref()?;
        self.system.damp(|_| 1e-9);
        eliminate_depths(self, problem, pairs, 0.0);
        self.system.solve()?;
        self.border.as_ref()?.variances(&mut self.system)
    }

    /// Entries of the reduced system.
    #[cfg(test)]
    pub fn entries(&self) -> usize {
        self.system.entries()
    }

    /// Information of each point's inverse depth given the poses.
    pub fn depth_information(&self) -> impl Iterator<Item = f64> + '_ {
        self.depth.iter().map(|d| d.0)
    }
}

/// `vᵀ M v` of a vector in blocks, most of which are zero, and a symmetric matrix of columns.
fn quadratic(blocks: &[Vector6<f64>], columns: &[Vec<f64>]) -> f64 {
    let is_set = |(_, block): &(usize, &Vector6<f64>)| block.iter().any(|v| *v != 0.0);
    let set: Vec<(usize, &Vector6<f64>)> = blocks.iter().enumerate().filter(is_set).collect();
    let mut sum = 0.0;
    for (i, u) in &set {
        for (k, value) in u.iter().enumerate() {
            let column = &columns[6 * i + k];
            let product = |(j, v): &(usize, &Vector6<f64>)| -> f64 {
                column[6 * j..][..6].iter().zip(v.iter()).map(|(a, b)| a * b).sum()
            };
            sum += value * set.iter().map(product).sum::<f64>();
        }
    }
    sum
}

/// The pairs of blocks that some point couples, `(greater, smaller)`, each once.
fn coupled(problem: &Problem, block: &[Option<usize>]) -> Vec<(usize, usize)> {
    let blocks = |point: &super::WindowPoint| {
        let observers = problem.observations[point.observations.clone()].iter().map(|o| o.frame);
        observers.chain([point.host]).filter_map(|frame| block[frame]).collect::<Vec<_>>()
    };
    let mut points_of: Vec<Vec<u32>> = vec![Vec::new(); block.len()];
    let of_points: Vec<Vec<usize>> = problem.points.iter().map(blocks).collect();
    for (index, blocks) in of_points.iter().enumerate().filter(|(_, blocks)| blocks.len() > 1) {
        blocks.iter().for_each(|&block| points_of[block].push(index as u32));
    }
    let mut met = vec![usize::MAX; block.len()];
    let mut pairs = Vec::new();
    for (greater, points) in points_of.iter().enumerate() {
        for &smaller in points.iter().flat_map(|&point| &of_points[point as usize]) {
            if smaller < greater && met[smaller] != greater {
                met[smaller] = greater;
                pairs.push((greater, smaller));
            }
        }
    }
    pairs
}

#[cfg(test)]
mod tests;
