//! Covariance of a registration (Loop-box, Eqs. 2–3; Censi, "An accurate closed-form estimate of ICP's
//! covariance", ICRA 2007).
//!
//! Eq. 2 is the objective `J = Σ ‖G_i‖²`, `G_i = R P_i + T − Q_i`. We write it with a metric,
//! `J(x) = Σ G_iᵀ Ω_i G_i` and `G_i(x) = exp(x) y_i − Q_i`, where y_i is the source point as registered and x the
//! left perturbation of target_from_source, tangent order (υ, ω, λ). `Ω = I` is Eq. 2 to the letter, `Ω = n nᵀ`
//! point-to-plane and `Ω = (C_Q + A C_P Aᵀ)⁻¹` generalised ICP; a robust weight is a factor of Ω. Eq. 3 then says
//! how noise in the points z = {P_i, Q_i} becomes noise in x. It takes Ω and the correspondences as given and
//! noise of different points as independent.

use geometry::hat;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// A tangent vector (υ, ω, λ) of Sim(3).
pub type Tangent = SVector<f64, 7>;
/// A matrix over tangent vectors.
pub type TangentMatrix = SMatrix<f64, 7, 7>;

/// A source point and the target point it is held against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Index of the source point.
    pub source: usize,
    /// Index of the target point; several source points may share one.
    pub target: usize,
    /// y: the source point as registered, in the target frame.
    pub moved: Vector3<f64>,
    /// G = y − Q, target units.
    pub residual: Vector3<f64>,
    /// Ω, weights and all; symmetric and positive semi-definite.
    pub metric: Matrix3<f64>,
}

/// Covariances of the points of one correspondence, in the frame and unit of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointNoise {
    /// Of the source point as registered: `A C_P Aᵀ` with A = σR.
    pub source: Matrix3<f64>,
    /// Of the target point: C_Q. The same in all correspondences that share it.
    pub target: Matrix3<f64>,
}

impl Correspondence {
    /// ∂G/∂x at x = 0: `[I, −[y]×, y]`.
    pub(super) fn jacobian(&self) -> SMatrix<f64, 3, 7> {
        let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-hat(&self.moved));
        jacobian.fixed_view_mut::<3, 1>(0, 6).copy_from(&self.moved);
        jacobian
    }

    /// ∂(∂G/∂xᵀ g)/∂y for a fixed `g = Ω G`: how the Jacobian's turning with the point bends the objective.
    fn bend(&self) -> SMatrix<f64, 7, 3> {
        let g = self.metric * self.residual;
        let mut bend = SMatrix::<f64, 7, 3>::zeros();
        bend.fixed_view_mut::<3, 3>(3, 0).copy_from(&-hat(&g));
        bend.fixed_view_mut::<1, 3>(6, 0).copy_from(&g.transpose());
        bend
    }
}

/// J of Eq. 2.
pub fn objective(correspondences: &[Correspondence]) -> f64 {
    correspondences.iter().map(|c| c.residual.dot(&(c.metric * c.residual))).sum()
}

/// ∂J/∂x at x = 0.
pub fn gradient(correspondences: &[Correspondence]) -> Tangent {
    correspondences.iter().map(|c| c.jacobian().transpose() * (c.metric * c.residual) * 2.0).sum()
}

/// ∂²J/∂x² at x = 0, with the second derivative of exp(x) in it.
pub fn hessian(correspondences: &[Correspondence]) -> TangentMatrix {
    let mut half = TangentMatrix::zeros();
    for c in correspondences {
        let jacobian = c.jacobian();
        let bend = c.bend() * jacobian;
        half += jacobian.transpose() * (c.metric * jacobian) + (bend + bend.transpose()) * 0.5;
    }
    half * 2.0
}

/// Eq. 3: the covariance of x from that of the points.
///
/// `noise` has one entry per correspondence. With `estimate_scale` false x has six degrees of freedom, and the
/// row and column of λ are zero. `None` if ∂²J/∂x² is not positive definite: the points leave x open.
pub fn covariance(
    correspondences: &[Correspondence],
    noise: &[PointNoise],
    estimate_scale: bool,
) -> Option<TangentMatrix> {
    let inverse = estimated_inverse(&hessian(correspondences), estimate_scale)?;
    // (∂²J/∂z∂x) cov(z) (∂²J/∂z∂x)ᵀ, a sum over points. Correspondences with one target are added up before.
    let mut middle = TangentMatrix::zeros();
    for (c, noise) in correspondences.iter().zip(noise) {
        let by_source = (c.jacobian().transpose() * c.metric + c.bend()) * 2.0;
        middle += by_source * noise.source * by_source.transpose();
    }
    let mut order: Vec<usize> = (0..correspondences.len().min(noise.len())).collect();
    order.sort_by_key(|&index| correspondences[index].target);
    for group in order.chunk_by(|&a, &b| correspondences[a].target == correspondences[b].target) {
        let by_target: SMatrix<f64, 7, 3> = group
            .iter()
            .map(|&index| {
                correspondences[index].jacobian().transpose() * correspondences[index].metric * -2.0
            })
            .sum();
        middle += by_target * noise[group[0]].target * by_target.transpose();
    }
    Some(inverse * middle * inverse)
}

/// Inverse over the estimated degrees of freedom, zero elsewhere; `None` if it is not positive definite.
pub(super) fn estimated_inverse(matrix: &TangentMatrix, estimate_scale: bool) -> Option<TangentMatrix> {
    if estimate_scale {
        return Some(matrix.cholesky()?.inverse());
    }
    let inverse = matrix.fixed_view::<6, 6>(0, 0).into_owned().cholesky()?.inverse();
    let mut full = TangentMatrix::zeros();
    full.fixed_view_mut::<6, 6>(0, 0).copy_from(&inverse);
    Some(full)
}

/// The factor by which the noise must grow for the residuals to be as large as they are: weighted sum of squared
/// residuals over what `noise` predicts, less the degrees of freedom used up.
pub(super) fn noise_factor(correspondences: &[Correspondence], noise: &[PointNoise], freedom: usize) -> f64 {
    let predicted: f64 =
        correspondences.iter().zip(noise).map(|(c, n)| (c.metric * (n.source + n.target)).trace()).sum();
    let rows = correspondences.len() as f64;
    objective(correspondences) / predicted * rows / (rows - freedom as f64).max(1.0)
}
