//! Similarity transforms, Sim(3).

use crate::{Se3, hat};
use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::ops::Mul;

/// A similarity `x ↦ s R x + t`, in f64: T of Loop-box, Eq. 1, whose σ is the [`scale`](Self::scale).
///
/// Tangent vectors are `(υ, ω, λ)` with `s = e^λ`; updates are left-multiplicative (Engel 2014, §2.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sim3 {
    /// Rotation part.
    pub rotation: UnitQuaternion<f64>,
    /// Translation part, in the unit of the target frame.
    pub translation: Vector3<f64>,
    /// Scale: target units per source unit, > 0.
    pub scale: f64,
}

impl Sim3 {
    /// A similarity from its parts.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>, scale: f64) -> Self {
        Self { rotation, translation, scale }
    }

    /// The similarity that does nothing.
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros(), 1.0)
    }

    /// The rigid part, scale dropped: where the frame's origin is and how it is turned.
    pub fn rigid(&self) -> Se3 {
        Se3::new(self.rotation, self.translation)
    }

    /// Exponential map of `(υ, ω, λ)`.
    pub fn exp(tangent: &SVector<f64, 7>) -> Self {
        let v = Vector3::new(tangent[0], tangent[1], tangent[2]);
        let w = Vector3::new(tangent[3], tangent[4], tangent[5]);
        let lambda = tangent[6];
        Self::new(UnitQuaternion::from_scaled_axis(w), translation_jacobian(&w, lambda) * v, lambda.exp())
    }

    /// Logarithm: the tangent `(υ, ω, λ)` with `exp(log(g)) = g`, |ω| ≤ π.
    pub fn log(&self) -> SVector<f64, 7> {
        let w = self.rotation.scaled_axis();
        let lambda = self.scale.ln();
        let v = translation_jacobian(&w, lambda)
            .try_inverse()
            .map_or(self.translation, |inverse| inverse * self.translation);
        SVector::<f64, 7>::from([v.x, v.y, v.z, w.x, w.y, w.z, lambda])
    }

    /// The inverse similarity.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self::new(rotation, -(rotation * self.translation) * scale, scale)
    }

    /// Adjoint: `g exp(δ) g⁻¹ = exp(Ad_g δ)`, tangents ordered `(υ, ω, λ)`.
    pub fn adjoint(&self) -> SMatrix<f64, 7, 7> {
        let r = self.rotation.to_rotation_matrix().into_inner();
        let mut ad = SMatrix::<f64, 7, 7>::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&(r * self.scale));
        ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&(hat(&self.translation) * r));
        ad.fixed_view_mut::<3, 1>(0, 6).copy_from(&(-self.translation));
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
        ad[(6, 6)] = 1.0;
        ad
    }

    /// The 4×4 homogeneous matrix.
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut m = Matrix4::identity();
        let r = self.rotation.to_rotation_matrix().into_inner() * self.scale;
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        m
    }

    /// Whether all numbers are finite and the scale positive.
    pub fn is_valid(&self) -> bool {
        self.rigid().is_finite() && self.scale.is_finite() && self.scale > 0.0
    }
}

impl From<Se3> for Sim3 {
    fn from(rigid: Se3) -> Self {
        Self::new(rigid.rotation, rigid.translation, 1.0)
    }
}

impl Mul for Sim3 {
    type Output = Sim3;
    fn mul(self, rhs: Sim3) -> Sim3 {
        Sim3::new(self.rotation * rhs.rotation, self * rhs.translation, self.scale * rhs.scale)
    }
}

impl Mul<Vector3<f64>> for Sim3 {
    type Output = Vector3<f64>;
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.translation
    }
}

/// `∫₀¹ exp(τ(λI + [ω]×)) dτ = A [ω]× + B [ω]×² + C I`, the map from υ to the translation.
fn translation_jacobian(w: &Vector3<f64>, lambda: f64) -> Matrix3<f64> {
    let k = hat(w);
    let theta2 = w.norm_squared();
    let d = theta2 + lambda * lambda;
    if d < 0.25 {
        // The closed form cancels here. Σ (λI + [ω]×)ⁿ / (n + 1)!, innermost term first.
        let generator = Matrix3::identity() * lambda + k;
        return (2..=16)
            .rev()
            .fold(Matrix3::identity(), |sum, n| Matrix3::identity() + generator * sum / n as f64);
    }
    let theta = theta2.sqrt();
    let c = if lambda == 0.0 { 1.0 } else { lambda.exp_m1() / lambda };
    let (sin, cos) = (lambda.exp() * theta.sin(), lambda.exp() * theta.cos());
    let (a, b) = if theta < 1e-8 {
        // [ω]×² is below rounding.
        (((lambda - 1.0) * lambda.exp() + 1.0) / (lambda * lambda), 0.0)
    } else {
        let a = (sin * lambda + (1.0 - cos) * theta) / (theta * d);
        (a, (c - ((cos - 1.0) * lambda + sin * theta) / d) / theta2)
    };
    k * a + k * k * b + Matrix3::identity() * c
}
