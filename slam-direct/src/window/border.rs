//! The part of the normal equations that couples the sensor with poses and depths: a few dense columns beside the sparse
//! system, solved for by its Schur complement.

use super::calibration::Calibration;
use super::cost::Prediction;
use super::pairs::{Pairs, Relative};
use super::problem::WindowPoint;
use backend::BlockSystem;
use geometry::Pinhole;
use geometry::sensor::UNKNOWNS;
use nalgebra::{Matrix2, Matrix6, SMatrix, SVector, Vector2, Vector6};

type Unknowns = SVector<f64, UNKNOWNS>;
/// Derivative of a residual by the unknowns of the sensor, a column each.
type ByUnknowns = SMatrix<f64, 2, UNKNOWNS>;
type PoseByUnknowns = SMatrix<f64, 6, UNKNOWNS>;

/// The columns of the sensor's unknowns.
pub(super) struct Border {
    hessian: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    gradient: Unknowns,
    /// Per pair, of its relative pose.
    pairs: Vec<PoseByUnknowns>,
    /// Per block of the system.
    poses: Vec<PoseByUnknowns>,
    /// Per point.
    depths: Vec<Unknowns>,
    /// The same with the depths eliminated.
    reduced_hessian: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    reduced_gradient: Unknowns,
    reduced_poses: Vec<PoseByUnknowns>,
}

impl Border {
    /// Room for a system of so many blocks, pairs and points.
    pub fn new(blocks: usize, pairs: usize, points: usize) -> Self {
        Self {
            hessian: SMatrix::zeros(),
            gradient: Unknowns::zeros(),
            pairs: vec![PoseByUnknowns::zeros(); pairs],
            poses: vec![PoseByUnknowns::zeros(); blocks],
            depths: vec![Unknowns::zeros(); points],
            reduced_hessian: SMatrix::zeros(),
            reduced_gradient: Unknowns::zeros(),
            reduced_poses: vec![PoseByUnknowns::zeros(); blocks],
        }
    }

    /// Begins a linearisation with what was known of the sensor before.
    pub fn begin(&mut self, calibration: &Calibration) {
        let prior = Unknowns::from(calibration.prior());
        self.hessian = SMatrix::from_diagonal(&prior);
        let free = |k: usize, value: f64| if calibration.sigma[k] > 0.0 { value } else { 0.0 };
        let values = calibration.sensor.unknowns();
        self.gradient = Unknowns::from_fn(|k, _| free(k, prior[k] * values[k]));
        self.pairs.fill(PoseByUnknowns::zeros());
        self.depths.fill(Unknowns::zeros());
    }

    /// Adds an observation of weighted information `[a, b, c]`.
    pub fn add(&mut self, p: &Prediction, by: &ByUnknowns, [a, b, c]: [f64; 3], pair: usize, point: usize) {
        let weighted = Matrix2::new(a, b, b, c) * by;
        self.hessian += by.transpose() * weighted;
        self.gradient += weighted.tr_mul(&Vector2::from(p.residual));
        self.depths[point] += weighted.tr_mul(&Vector2::from(p.by_inverse_depth));
        let [ju, jv] = p.by_twist.map(Vector6::from);
        self.pairs[pair] += ju * weighted.row(0) + jv * weighted.row(1);
    }

    /// Carries each pair's columns to its poses: `δ_frame·host = δ_frame − Ad δ_host`.
    pub fn gather(&mut self, pairs: &Pairs, adjoint: &[Matrix6<f64>], block: &[Option<usize>]) {
        self.poses.fill(PoseByUnknowns::zeros());
        for (&(host, frame), (sum, ad)) in pairs.ends.iter().zip(self.pairs.iter().zip(adjoint)) {
            if let Some(frame) = block[frame] {
                self.poses[frame] += sum;
            }
            if let Some(host) = block[host] {
                self.poses[host] -= ad.tr_mul(sum);
            }
        }
    }

    /// Begins a solve.
    pub fn damp(&mut self) {
        self.reduced_hessian = self.hessian;
        self.reduced_gradient = self.gradient;
        self.reduced_poses.copy_from_slice(&self.poses);
    }

    /// Eliminates a point's depth: `inverse` of its damped Hessian, its gradient, and its coupling with poses.
    pub fn eliminate(&mut self, point: usize, inverse: f64, gradient: f64, rows: &[(usize, Vector6<f64>)]) {
        let by = self.depths[point];
        self.reduced_hessian -= by * by.transpose() * inverse;
        self.reduced_gradient -= by * (inverse * gradient);
        for (block, row) in rows {
            self.reduced_poses[*block] -= row * by.transpose() * inverse;
        }
    }

    /// The step of the unknowns; `delta`, the step of the poses without them, becomes the one with them.
    pub fn solve(
        &self,
        system: &mut BlockSystem<6>,
        delta: &mut [f64],
        lambda: f64,
    ) -> Option<[f64; UNKNOWNS]> {
        let (columns, solved) = self.columns(system);
        let hessian = self.complement(&columns, &solved, lambda);
        let gradient = self.reduced_gradient + Unknowns::from_fn(|k, _| dot(&columns[k], delta));
        let step = -hessian.cholesky()?.solve(&gradient);
        for (column, step) in solved.iter().zip(step.iter()) {
            delta.iter_mut().zip(column).for_each(|(delta, column)| *delta -= column * step);
        }
        step.iter().all(|v| v.is_finite()).then_some(step.into())
    }

    /// Variance of each unknown, poses and depths left free: the diagonal of the inverse of what is left of its matrix.
    pub fn variances(&self, system: &mut BlockSystem<6>) -> Option<[f64; UNKNOWNS]> {
        let (columns, solved) = self.columns(system);
        Some(self.complement(&columns, &solved, 0.0).cholesky()?.inverse().diagonal().into())
    }

    /// The columns that couple the unknowns with the poses, and the same solved for.
    fn columns(&self, system: &mut BlockSystem<6>) -> ([Vec<f64>; UNKNOWNS], [Vec<f64>; UNKNOWNS]) {
        let columns: [Vec<f64>; UNKNOWNS] = std::array::from_fn(|k| {
            self.reduced_poses
                .iter()
                .flat_map(|block| block.column(k).iter().copied().collect::<Vec<_>>())
                .collect()
        });
        let mut solved = columns.clone();
        solved.iter_mut().for_each(|column| system.solve_again(column));
        (columns, solved)
    }

    /// The Hessian of the unknowns with poses and depths eliminated, damped by `lambda`.
    fn complement(
        &self,
        columns: &[Vec<f64>; UNKNOWNS],
        solved: &[Vec<f64>; UNKNOWNS],
        lambda: f64,
    ) -> SMatrix<f64, UNKNOWNS, UNKNOWNS> {
        let mut hessian = self.reduced_hessian;
        for k in 0..UNKNOWNS {
            hessian[(k, k)] += lambda * self.hessian[(k, k)];
        }
        hessian - SMatrix::from_fn(|k, l| dot(&columns[k], &solved[l]))
    }

    /// What a step of the unknowns adds to a point's gradient.
    pub fn of_depth(&self, point: usize, sensor: &[f64; UNKNOWNS]) -> f64 {
        self.depths[point].dot(&Unknowns::from(*sensor))
    }
}

impl Calibration {
    /// Derivative by the unknowns of an observation's residual, brought back to pixels of the image: a lens that makes the
    /// image smaller does not make its errors smaller. `host` is [what its point's host says](Self::host_by_unknowns).
    pub fn by_unknowns(
        &self,
        camera: &Pinhole,
        relative: &Relative,
        (point, host): (&WindowPoint, &[Vector2<f64>; UNKNOWNS]),
        observation: usize,
        residual: &[f64; 2],
    ) -> ByUnknowns {
        let x = relative.transform(&point.ray, point.inverse_depth);
        let iz = 1.0 / x.z;
        let (px, py) = (x.x * iz, x.y * iz);
        let distorted = &self.seen[observation].0;
        let seen = distorted.by_unknowns(&self.sensor);
        let [by_radial] = self.sensor.lens.magnification_by_terms(distorted.still(&self.sensor));
        // By the readout times it changes by next to nothing.
        let magnification = [by_radial, Matrix2::zeros(), Matrix2::zeros()];
        let residual = Vector2::from(*residual);
        let columns: [Vector2<f64>; UNKNOWNS] = std::array::from_fn(|k| {
            let ray = relative.rotation.column(0) * (host[k].x / camera.fx)
                + relative.rotation.column(1) * (host[k].y / camera.fy);
            let predicted =
                Vector2::new(camera.fx * iz * (ray.x - px * ray.z), camera.fy * iz * (ray.y - py * ray.z));
            // What is known stays as it is, to the last bit.
            let is_free = f64::from(u8::from(self.sigma[k] > 0.0));
            (predicted - seen[k] - magnification[k] * residual) * is_free
        });
        ByUnknowns::from_columns(&columns)
    }
}

/// The inner product.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
