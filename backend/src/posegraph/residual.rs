//! The residual of an edge and its exact Jacobians.

use geometry::{Sim3, hat};
use nalgebra::{SMatrix, SVector, Vector3};

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

/// Residual of an edge with Jacobians, tangent order (υ, ω, λ).
#[derive(Clone, Debug)]
pub struct EdgeResidual {
    /// `log(predicted ∘ measured⁻¹)`: the left perturbation that turns the measured `from_from_to`
    /// into the one that the nodes predict, so it is what the edge's information weighs.
    pub residual: Vector7,
    /// Derivative by δ of `from_from_world ← exp(δ) ∘ from_from_world`.
    pub by_from: Matrix7,
    /// Ad(from_from_to) as the nodes predict it: it takes the one derivative to the other.
    pub adjoint: Matrix7,
}

impl EdgeResidual {
    /// Derivative by δ of `to_from_world ← exp(δ) ∘ to_from_world`.
    pub fn by_to(&self) -> Matrix7 {
        -self.by_from * self.adjoint
    }
}

/// Only the residual: `log(from_from_world ∘ to_from_world⁻¹ ∘ from_from_to⁻¹)`.
pub(super) fn residual(from_from_world: &Sim3, to_from_world: &Sim3, from_from_to: &Sim3) -> Vector7 {
    (*from_from_world * to_from_world.inverse() * from_from_to.inverse()).log()
}

/// Residual and Jacobians of an edge.
///
/// With `E = K_f K_t⁻¹ M⁻¹` a left update of `K_f` multiplies E from the left, and one of `K_t`
/// moves it by `−Ad(K_f K_t⁻¹)` from the left too; the left Jacobian of Sim(3) takes both through
/// the logarithm. Poses are updated in the keyframe's frame, so the conditioning does not depend on
/// where in the world the keyframe lies.
pub fn evaluate_edge(from_from_world: &Sim3, to_from_world: &Sim3, from_from_to: &Sim3) -> EdgeResidual {
    let predicted = *from_from_world * to_from_world.inverse();
    let residual = (predicted * from_from_to.inverse()).log();
    EdgeResidual { residual, by_from: inverse_left_jacobian(&residual), adjoint: predicted.adjoint() }
}

/// Bernoulli numbers over factorials, `B₂ₖ / (2k)!` for k = 1, 2, …: the even part of `x / (eˣ − 1)`.
const BERNOULLI: [f64; 6] = [
    1.0 / 12.0,
    -1.0 / 720.0,
    1.0 / 30_240.0,
    -1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    -691.0 / 1_307_674_368_000.0,
];

/// Norm of ad(ξ) up to which six Bernoulli terms are exact to rounding: they shrink by (norm / 2π)².
const SMALL: f64 = 0.4;

/// Inverse left Jacobian of Sim(3): `log(exp(δ) exp(ξ)) ≈ ξ + J⁻¹ δ`.
///
/// Of small ξ, as nearly all edges have, by its own series `Σ Bₙ ad(ξ)ⁿ / n!`.
fn inverse_left_jacobian(tangent: &Vector7) -> Matrix7 {
    let ad = adjoint_of_algebra(tangent);
    if ad.norm() > SMALL {
        // The left Jacobian is singular only at rotations of a full turn, which a logarithm never has.
        return left_jacobian(&ad).try_inverse().unwrap_or_else(Matrix7::identity);
    }
    let square = ad * ad;
    let (mut power, mut sum) = (square, Matrix7::identity() - ad * 0.5);
    for factor in BERNOULLI {
        let term = power * factor;
        sum += term;
        if term.amax() <= f64::EPSILON {
            break;
        }
        power *= square;
    }
    sum
}

/// Left Jacobian of Sim(3) from ad(ξ), `Σ ad(ξ)ⁿ / (n+1)!`.
fn left_jacobian(ad: &Matrix7) -> Matrix7 {
    let mut term = Matrix7::identity();
    let mut sum = term;
    // The series converges everywhere; 60 terms are far beyond what |ω| ≤ π and sane scales need.
    for n in 1..60 {
        term = term * ad / (n + 1) as f64;
        sum += term;
        if term.amax() <= f64::EPSILON * sum.amax() {
            break;
        }
    }
    sum
}

/// `ad(ξ)`: the matrix of the Lie bracket, the derivative of the adjoint at the identity.
fn adjoint_of_algebra(tangent: &Vector7) -> Matrix7 {
    let v = Vector3::new(tangent[0], tangent[1], tangent[2]);
    let rotation = hat(&Vector3::new(tangent[3], tangent[4], tangent[5]));
    let mut ad = Matrix7::zeros();
    ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&(rotation + nalgebra::Matrix3::identity() * tangent[6]));
    ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&hat(&v));
    ad.fixed_view_mut::<3, 1>(0, 6).copy_from(&(-v));
    ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    ad
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tangent(translation: f64, rotation: f64, scale: f64) -> impl Strategy<Value = Vector7> {
        let unit = || -1.0..1.0;
        prop::array::uniform7(unit()).prop_map(move |v: [f64; 7]| {
            let mut t = Vector7::from(v);
            t.fixed_rows_mut::<3>(0).scale_mut(translation);
            t.fixed_rows_mut::<3>(3).scale_mut(rotation);
            t[6] *= scale;
            t
        })
    }

    fn numeric(residual_at: impl Fn(&Sim3) -> Vector7, node: &Sim3) -> Matrix7 {
        let h = 1e-5;
        let mut jacobian = Matrix7::zeros();
        for column in 0..7 {
            let step = |size: f64| {
                let mut delta = Vector7::zeros();
                delta[column] = size;
                residual_at(&(Sim3::exp(&delta) * *node))
            };
            // Fourth-order central difference.
            let slope = (step(-2.0 * h) - step(-h) * 8.0 + step(h) * 8.0 - step(2.0 * h)) / (12.0 * h);
            jacobian.set_column(column, &slope);
        }
        jacobian
    }

    proptest! {
        #[test]
        fn the_series_of_small_errors_is_the_inverse(error in tangent(0.2, 0.2, 0.1)) {
            let product = left_jacobian(&adjoint_of_algebra(&error)) * inverse_left_jacobian(&error);
            prop_assert!((product - Matrix7::identity()).amax() < 1e-14, "{product}");
        }

        #[test]
        fn jacobians_match_numeric_ones(
            from in tangent(5.0, 1.5, 0.7),
            to in tangent(5.0, 1.5, 0.7),
            error in tangent(0.5, 0.8, 0.4),
        ) {
            let (from, to) = (Sim3::exp(&from), Sim3::exp(&to));
            let measured = Sim3::exp(&-error) * from * to.inverse();
            let analytic = evaluate_edge(&from, &to, &measured);
            prop_assert!((analytic.residual - error).norm() < 1e-7, "{}", analytic.residual - error);
            let by_from = numeric(|from| residual(from, &to, &measured), &from);
            let by_to = numeric(|to| residual(&from, to, &measured), &to);
            let tolerance = 1e-6 * (1.0 + by_to.amax());
            prop_assert!((analytic.by_from - by_from).amax() < tolerance, "{}", analytic.by_from - by_from);
            prop_assert!((analytic.by_to() - by_to).amax() < tolerance, "{}", analytic.by_to() - by_to);
        }
    }
}
