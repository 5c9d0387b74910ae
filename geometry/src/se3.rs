//! Rigid motions, SE(3).

use nalgebra::{Matrix3, Matrix4, Matrix6, Quaternion, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::ops::Mul;

/// A rigid motion `x ↦ R x + t`, in f64.
///
/// Tangent vectors are ordered translation first: `ξ = (υ, ω)`, updates are left-multiplicative,
/// `ξ ← exp(δ) ∘ ξ` (Engel 2014, §2.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Se3 {
    /// Rotation part.
    pub rotation: UnitQuaternion<f64>,
    /// Translation part, in the unit of the target frame.
    pub translation: Vector3<f64>,
}

impl Se3 {
    /// A motion from its parts.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// The motion that does nothing.
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros())
    }

    /// From `(tx, ty, tz, qx, qy, qz, qw)`, the order of TUM trajectory files; the quaternion is normalised.
    pub fn from_tum(values: [f64; 7]) -> Self {
        let [tx, ty, tz, qx, qy, qz, qw] = values;
        Self::new(UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz)), Vector3::new(tx, ty, tz))
    }

    /// As `(tx, ty, tz, qx, qy, qz, qw)`, the order of TUM trajectory files.
    pub fn to_tum(&self) -> [f64; 7] {
        let (t, q) = (&self.translation, self.rotation.quaternion());
        [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
    }

    /// Exponential map of a twist `(υ, ω)`.
    pub fn exp(twist: &Vector6<f64>) -> Self {
        let (v, w) = (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
        Self::new(UnitQuaternion::from_scaled_axis(w), left_jacobian_so3(&w) * v)
    }

    /// Logarithm: the twist `(υ, ω)` with `exp(log(g)) = g`, |ω| ≤ π.
    pub fn log(&self) -> Vector6<f64> {
        let w = self.rotation.scaled_axis();
        let v = left_jacobian_so3_inverse(&w) * self.translation;
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }

    /// The inverse motion.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(rotation, -(rotation * self.translation))
    }

    /// Adjoint: `g exp(δ) g⁻¹ = exp(Ad_g δ)`, twists ordered `(υ, ω)`.
    pub fn adjoint(&self) -> Matrix6<f64> {
        let r = self.rotation.to_rotation_matrix().into_inner();
        let mut ad = Matrix6::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
        ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&(hat(&self.translation) * r));
        ad
    }

    /// The 4×4 homogeneous matrix.
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation_matrix());
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        m
    }

    /// The 3×3 rotation matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    /// The same motion with its quaternion brought back to unit length (long products drift).
    pub fn renormalized(&self) -> Self {
        Self::new(UnitQuaternion::new_normalize(self.rotation.into_inner()), self.translation)
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.to_tum().iter().all(|v| v.is_finite())
    }
}

impl Mul for Se3 {
    type Output = Se3;
    fn mul(self, rhs: Se3) -> Se3 {
        Se3::new(self.rotation * rhs.rotation, self.rotation * rhs.translation + self.translation)
    }
}

impl Mul<Vector3<f64>> for Se3 {
    type Output = Vector3<f64>;
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }
}

/// The skew-symmetric matrix `[v]×` with `[v]× w = v × w`.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Left Jacobian of SO(3): `I + (1−cosθ)/θ² [ω]× + (θ−sinθ)/θ³ [ω]×²`.
fn left_jacobian_so3(w: &Vector3<f64>) -> Matrix3<f64> {
    let theta2 = w.norm_squared();
    let (b, c) = if theta2 < 1e-8 {
        (0.5 - theta2 / 24.0, 1.0 / 6.0 - theta2 / 120.0)
    } else {
        let theta = theta2.sqrt();
        ((1.0 - theta.cos()) / theta2, (theta - theta.sin()) / (theta2 * theta))
    };
    let k = hat(w);
    Matrix3::identity() + k * b + k * k * c
}

/// Inverse of [`left_jacobian_so3`]: `I − ½[ω]× + (1/θ² − (1+cosθ)/(2θ sinθ)) [ω]×²`.
fn left_jacobian_so3_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let theta2 = w.norm_squared();
    let c = if theta2 < 1e-6 {
        1.0 / 12.0 + theta2 / 720.0
    } else {
        let half = 0.5 * theta2.sqrt();
        (1.0 - half / half.tan()) / theta2
    };
    let k = hat(w);
    Matrix3::identity() - k * 0.5 + k * k * c
}
