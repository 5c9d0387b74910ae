//! Least-squares alignment of two point sets (Umeyama, "Least-squares estimation of transformation
//! parameters between two point patterns", PAMI 1991).

use crate::{Se3, Sim3};
use nalgebra::{Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3, Vector4};

/// Why two point sets cannot be aligned.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum UmeyamaError {
    /// The sets must correspond point by point.
    #[error("cannot align {source_len} points to {target_len}: the sets must have one length")]
    LengthMismatch {
        /// Number of source points.
        source_len: usize,
        /// Number of target points.
        target_len: usize,
    },
    /// Three points are the fewest that fix a rotation.
    #[error("cannot align {0} points: at least 3 are needed")]
    TooFew(usize),
    /// All points of a set lie on one line or in one place, so the rotation is free; or a number is not finite.
    #[error("cannot align the points: they lie on one line or in one place, which leaves the rotation open")]
    Degenerate,
}

/// The second and third singular value together, as a share of the first, below which they count as zero.
const RANK_TOLERANCE: f64 = 1e-12;

/// The rigid motion `target_from_source` that minimises `Σ |target − (R source + t)|²`.
pub fn se3(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Result<Se3, UmeyamaError> {
    let fit = Fit::new(source, target)?;
    Ok(Se3::new(fit.rotation, fit.target_mean - fit.rotation * fit.source_mean))
}

/// The similarity `target_from_source` that minimises `Σ |target − (s R source + t)|²` (Umeyama, Eqs. 40–42).
pub fn sim3(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Result<Sim3, UmeyamaError> {
    let fit = Fit::new(source, target)?;
    let translation = fit.target_mean - fit.rotation * fit.source_mean * fit.scale;
    Ok(Sim3::new(fit.rotation, translation, fit.scale))
}

/// The scale of [`sim3`] alone: target units per source unit.
pub fn scale(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Result<f64, UmeyamaError> {
    Ok(Fit::new(source, target)?.scale)
}

/// What all three variants share.
struct Fit {
    source_mean: Vector3<f64>,
    target_mean: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    scale: f64,
}

impl Fit {
    fn new(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Result<Self, UmeyamaError> {
        if source.len() != target.len() {
            return Err(UmeyamaError::LengthMismatch { source_len: source.len(), target_len: target.len() });
        }
        if source.len() < 3 {
            return Err(UmeyamaError::TooFew(source.len()));
        }
        let n = source.len() as f64;
        let source_mean = source.iter().sum::<Vector3<f64>>() / n;
        let target_mean = target.iter().sum::<Vector3<f64>>() / n;
        let source_variance = source.iter().map(|x| (x - source_mean).norm_squared()).sum::<f64>() / n;
        let covariance = source
            .iter()
            .zip(target)
            .map(|(x, y)| (y - target_mean) * (x - source_mean).transpose())
            .sum::<Matrix3<f64>>()
            / n;
        let (rotation, trace) = best_rotation(&covariance).ok_or(UmeyamaError::Degenerate)?;
        let scale = trace / source_variance;
        if !(scale.is_finite() && scale > 0.0) {
            return Err(UmeyamaError::Degenerate);
        }
        Ok(Self { source_mean, target_mean, rotation, scale })
    }
}

/// The rotation `U S Vᵀ` nearest to `covariance = U D Vᵀ`, and `tr(D S)`; `None` where the rotation is free.
///
/// They are the eigenvector and the eigenvalue of a symmetric 4×4 matrix (Horn, "Closed-form solution of absolute
/// orientation using unit quaternions", JOSA A 1987, §4), which needs no care of reflections, and holds for three points
/// and other sets on a plane, whose covariance is singular: iterative singular value decompositions may fail there.
fn best_rotation(covariance: &Matrix3<f64>) -> Option<(UnitQuaternion<f64>, f64)> {
    if covariance.iter().any(|v| !v.is_finite()) {
        return None;
    }
    // Horn sums source · targetᵀ.
    let s = covariance.transpose();
    let (sum, difference) = (|i, j| s[(i, j)] + s[(j, i)], |i, j| s[(i, j)] - s[(j, i)]);
    let [xx, yy, zz] = [s[(0, 0)], s[(1, 1)], s[(2, 2)]];
    let mut matrix =
        Matrix4::from_diagonal(&Vector4::new(xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy));
    let above = [
        (0, 1, difference(1, 2)),
        (0, 2, difference(2, 0)),
        (0, 3, difference(0, 1)),
        (1, 2, sum(0, 1)),
        (1, 3, sum(0, 2)),
        (2, 3, sum(1, 2)),
    ];
    for (i, j, value) in above {
        (matrix[(i, j)], matrix[(j, i)]) = (value, value);
    }
    let eigen = matrix.symmetric_eigen();
    let (best, largest) = eigen.eigenvalues.argmax();
    let others = (0..4).filter(|&i| i != best).map(|i| eigen.eigenvalues[i]);
    let second = others.fold(f64::NEG_INFINITY, f64::max);
    // Of singular values d and with s for a reflection, the difference is 2 (d₂ + s d₃) and the sum 2 d₁.
    if largest - second <= RANK_TOLERANCE * (largest + second) {
        return None;
    }
    let q = eigen.eigenvectors.column(best);
    Some((UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3])), largest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(range: f64) -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-range..range).prop_map(Vector3::from)
    }

    fn points() -> impl Strategy<Value = Vec<Vector3<f64>>> {
        prop::collection::vec(vector(10.0), 4..30)
    }

    fn similarity() -> impl Strategy<Value = Sim3> {
        (vector(3.0), vector(100.0), 0.01..100.0)
            .prop_map(|(w, t, s)| Sim3::new(UnitQuaternion::from_scaled_axis(w), t, s))
    }

    fn cost(transform: &Sim3, source: &[Vector3<f64>], target: &[Vector3<f64>]) -> f64 {
        source.iter().zip(target).map(|(x, y)| (y - *transform * *x).norm_squared()).sum()
    }

    proptest! {
        #[test]
        fn sim3_recovers_an_exact_similarity(source in points(), truth in similarity()) {
            let target: Vec<_> = source.iter().map(|x| truth * *x).collect();
            let found = sim3(&source, &target).unwrap();
            prop_assert!((found.scale / truth.scale - 1.0).abs() < 1e-9);
            prop_assert!(found.rotation.angle_to(&truth.rotation) < 1e-7);
            prop_assert!(cost(&found, &source, &target).sqrt() < 1e-9 * (100.0 + 100.0 * truth.scale));
            prop_assert!((scale(&source, &target).unwrap() - found.scale).abs() == 0.0);
        }

        #[test]
        fn se3_recovers_an_exact_motion(source in points(), truth in similarity()) {
            let truth = truth.rigid();
            let target: Vec<_> = source.iter().map(|x| truth * *x).collect();
            let found = se3(&source, &target).unwrap();
            prop_assert!(cost(&found.into(), &source, &target).sqrt() < 1e-8);
        }

        // Their covariance is singular.
        #[test]
        fn three_points_suffice(source in prop::collection::vec(vector(10.0), 3), truth in similarity()) {
            let area = (source[1] - source[0]).cross(&(source[2] - source[0])).norm();
            prop_assume!(area > 1.0);
            let target: Vec<_> = source.iter().map(|x| truth.rigid() * *x).collect();
            let found = se3(&source, &target).unwrap();
            prop_assert!(cost(&found.into(), &source, &target).sqrt() < 1e-8);
        }

        // At a minimum no small step improves; the optimum over proper rotations holds for mirrored sets too.
        #[test]
        fn no_small_step_improves(
            source in points(), truth in similarity(), noise in prop::collection::vec(vector(0.1), 30),
            step in prop::array::uniform7(-1e-3..1e-3), mirrored in any::<bool>(),
        ) {
            let target: Vec<_> = source.iter().zip(&noise).map(|(x, e)| {
                let x = if mirrored { Vector3::new(-x.x, x.y, x.z) } else { *x };
                truth * (x + e)
            }).collect();
            let step = Sim3::exp(&step.into());
            let best = sim3(&source, &target).unwrap();
            prop_assert!(best.is_valid());
            let least = cost(&best, &source, &target);
            prop_assert!(cost(&(best * step), &source, &target) >= least * (1.0 - 1e-9));
            let rigid = Sim3::from(se3(&source, &target).unwrap());
            let least = cost(&rigid, &source, &target);
            prop_assert!(cost(&(rigid * Sim3::from(step.rigid())), &source, &target) >= least * (1.0 - 1e-9));
        }
    }

    #[test]
    fn a_plane_suffices_and_a_line_does_not() {
        let plane = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::new(1.0, 2.0, 0.0)];
        let truth =
            Sim3::new(UnitQuaternion::from_euler_angles(0.1, 2.0, -0.4), Vector3::new(1.0, 2.0, 3.0), 0.5);
        let target = plane.map(|x| truth * x);
        assert!((sim3(&plane, &target).unwrap().to_matrix() - truth.to_matrix()).norm() < 1e-12);
        let line = [Vector3::zeros(), Vector3::x(), Vector3::x() * 2.0];
        assert_eq!(sim3(&line, &line), Err(UmeyamaError::Degenerate));
        assert_eq!(se3(&[Vector3::x(); 5], &[Vector3::x(); 5]), Err(UmeyamaError::Degenerate));
    }

    #[test]
    fn a_covariance_of_rank_two_gives_its_rotation() {
        // Of three points; nalgebra's iterative decomposition of it is a tenth off.
        let source = [
            Vector3::new(7.5279155027884626, -1.3090780960761843, -2.2939653621603693),
            Vector3::new(2.6831061162845264, 3.5830364040042544, 1.5280795978310266),
            Vector3::new(3.4019729334878015, -4.657638017405593, 3.70497839937914),
        ];
        let target = [
            Vector3::new(5.723996625241288, 0.16556050310617698, 6.976141407410236),
            Vector3::new(-0.6791529754974489, 3.191737034676475, 3.533043857240897),
            Vector3::new(0.0, -5.1644124804648435, 5.2294781557660714),
        ];
        let found = se3(&source, &target).unwrap();
        assert!(cost(&found.into(), &source, &target).sqrt() < 1e-12);
    }

    #[test]
    fn unusable_sets_are_refused() {
        let p = [Vector3::x(), Vector3::y(), Vector3::z()];
        assert_eq!(se3(&p, &p[..2]), Err(UmeyamaError::LengthMismatch { source_len: 3, target_len: 2 }));
        assert_eq!(scale(&p[..2], &p[..2]), Err(UmeyamaError::TooFew(2)));
        let bad = [Vector3::x(), Vector3::y(), Vector3::new(f64::NAN, 0.0, 0.0)];
        assert_eq!(sim3(&bad, &p), Err(UmeyamaError::Degenerate));
    }
}
