//! The matched bearings, laid out for the solvers.

use super::{BearingMatch, TwoViewRefusal};
use nalgebra::{Matrix3, Matrix3x2, SymmetricEigen, Vector3};

/// Rays scored between two looks at whether the hypothesis can still win.
pub(super) const BLOCK: usize = 64;

/// Directions as three arrays, filled up with zeros to a multiple of [`BLOCK`]. A match of zeros has no error,
/// so the filling changes no cost.
#[derive(Default)]
pub(super) struct Lanes {
    pub(super) x: Vec<f64>,
    pub(super) y: Vec<f64>,
    pub(super) z: Vec<f64>,
}

impl Lanes {
    fn new(vectors: impl Iterator<Item = Vector3<f64>>) -> Self {
        let mut lanes = Self::default();
        for vector in vectors {
            lanes.x.push(vector.x);
            lanes.y.push(vector.y);
            lanes.z.push(vector.z);
        }
        let padded = lanes.x.len().next_multiple_of(BLOCK);
        for lane in [&mut lanes.x, &mut lanes.y, &mut lanes.z] {
            lane.resize(padded, 0.0);
        }
        lanes
    }
}

/// Matched unit rays in every form the solvers need.
pub(super) struct Rays {
    pub(super) source: Vec<Vector3<f64>>,
    pub(super) target: Vec<Vector3<f64>>,
    pub(super) source_lanes: Lanes,
    pub(super) target_lanes: Lanes,
    /// Two directions across each ray, orthonormal to it.
    pub(super) source_basis: Vec<Matrix3x2<f64>>,
    /// The same for the target.
    pub(super) target_basis: Vec<Matrix3x2<f64>>,
    /// What whitens the source's rays: `mean (N f)(N f)ᵀ = 1`.
    pub(super) source_whitening: Matrix3<f64>,
    /// The same for the target.
    pub(super) target_whitening: Matrix3<f64>,
}

impl Rays {
    /// Checks and prepares; rays of another length than one are normalised.
    pub(super) fn new(matches: &[BearingMatch]) -> Result<Self, TwoViewRefusal> {
        let usable = |ray: &Vector3<f64>| ray.norm().is_normal();
        if let Some(index) = matches.iter().position(|m| !usable(&m.source) || !usable(&m.target)) {
            return Err(TwoViewRefusal::InvalidMatch { index });
        }
        let source: Vec<_> = matches.iter().map(|m| m.source.normalize()).collect();
        let target: Vec<_> = matches.iter().map(|m| m.target.normalize()).collect();
        Ok(Self {
            source_lanes: Lanes::new(source.iter().copied()),
            target_lanes: Lanes::new(target.iter().copied()),
            source_basis: source.iter().map(tangent_basis).collect(),
            target_basis: target.iter().map(tangent_basis).collect(),
            source_whitening: whitening(&source),
            target_whitening: whitening(&target),
            source,
            target,
        })
    }

    /// How many matches there are.
    pub(super) fn len(&self) -> usize {
        self.source.len()
    }
}

/// Two unit vectors orthogonal to the unit vector `ray` and to each other.
pub(super) fn tangent_basis(ray: &Vector3<f64>) -> Matrix3x2<f64> {
    let first = ray.cross(&Vector3::ith(ray.iamin(), 1.0)).normalize();
    Matrix3x2::from_columns(&[first, ray.cross(&first)])
}

/// Hartley's normalisation for rays. On an image plane he moves the points' mean to the origin and scales them so
/// that all columns of the linear system are of one size. Rays have no plane; the linear map that makes their second
/// moment the identity does the same to the columns, and is defined for any field of view.
fn whitening(rays: &[Vector3<f64>]) -> Matrix3<f64> {
    let moment = rays.iter().map(|r| r * r.transpose()).sum::<Matrix3<f64>>() / rays.len().max(1) as f64;
    let eigen = SymmetricEigen::new(moment);
    // Rays that all lie in a plane or on a line must not blow up the noise across it.
    let floor = 1e-6 * eigen.eigenvalues.max();
    let inverse_roots = eigen.eigenvalues.map(|v| v.max(floor).sqrt().recip());
    eigen.eigenvectors * Matrix3::from_diagonal(&inverse_roots) * eigen.eigenvectors.transpose()
}
