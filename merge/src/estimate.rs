//! A similarity with its information, carried between frames and averaged.

use geometry::Sim3;
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// A similarity (Eq. 1) and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Maps points of frame b, in b's unit, to frame a, in a's.
    pub a_from_b: Sim3,
    /// Information of the left perturbation `true = exp(ε) ∘ a_from_b`, tangent order (υ, ω, λ).
    pub information: SMatrix<f64, 7, 7>,
}

impl Estimate {
    /// `c_from_a ∘ a_from_b ∘ b_from_d`, both outer ones taken as exact.
    ///
    /// `None` where the numbers make no information matrix.
    pub fn carried(&self, c_from_a: &Sim3, b_from_d: &Sim3) -> Option<Self> {
        // C exp(ε) A = exp(Ad_C ε) C A.
        let back = c_from_a.inverse().adjoint();
        let information = back.transpose() * self.information * back;
        let information = (information + information.transpose()) * 0.5;
        information.cholesky()?;
        Some(Self { a_from_b: *c_from_a * self.a_from_b * *b_from_d, information })
    }

    /// b_from_a with its information.
    pub fn inverse(&self) -> Self {
        // (exp(ε) T)⁻¹ = exp(−Ad_T⁻¹ ε) T⁻¹.
        let adjoint = self.a_from_b.adjoint();
        let information = adjoint.transpose() * self.information * adjoint;
        Self { a_from_b: self.a_from_b.inverse(), information: (information + information.transpose()) * 0.5 }
    }

    /// The squared Mahalanobis distance to another estimate of the same similarity, χ² with 7 degrees of freedom
    /// where both are right and independent. `allowance` is added to the covariance of the difference. `None`
    /// where a matrix is singular.
    pub fn squared_distance(&self, other: &Self, allowance: &SVector<f64, 7>) -> Option<f64> {
        let difference = (self.a_from_b * other.a_from_b.inverse()).log();
        let covariance = self.information.try_inverse()?
            + other.information.try_inverse()?
            + SMatrix::from_diagonal(&allowance.component_mul(allowance));
        Some(difference.dot(&covariance.cholesky()?.solve(&difference)))
    }
}

/// Steps of the mean; it converges quadratically.
const MEAN_STEPS: usize = 10;

/// The information-weighted mean of estimates of one similarity, taken as independent. `None` for no estimates
/// and where they are so far apart that there is no mean.
pub fn mean(estimates: &[Estimate]) -> Option<Estimate> {
    let mut a_from_b = estimates.first()?.a_from_b;
    let mut information = SMatrix::<f64, 7, 7>::zeros();
    for _ in 0..MEAN_STEPS {
        information = SMatrix::zeros();
        let mut gradient = SVector::<f64, 7>::zeros();
        for estimate in estimates {
            information += estimate.information;
            gradient += estimate.information * (estimate.a_from_b * a_from_b.inverse()).log();
        }
        let step = information.cholesky()?.solve(&gradient);
        a_from_b = Sim3::exp(&step) * a_from_b;
        if step.norm() < 1e-12 {
            break;
        }
    }
    a_from_b.is_valid().then_some(Estimate { a_from_b, information })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::Numbers;

    fn similarity(numbers: &mut Numbers) -> Sim3 {
        Sim3::new(numbers.rotation(1.0), numbers.vector(3.0), numbers.uniform(-1.0, 1.0).exp())
    }

    fn information(numbers: &mut Numbers) -> SMatrix<f64, 7, 7> {
        let root = SMatrix::<f64, 7, 7>::from_fn(|_, _| numbers.uniform(-1.0, 1.0));
        root * root.transpose() * 50.0 + SMatrix::identity() * 20.0
    }

    #[test]
    fn carrying_there_and_back_changes_nothing() {
        for seed in 0..20 {
            let numbers = &mut Numbers::new(seed);
            let estimate = Estimate { a_from_b: similarity(numbers), information: information(numbers) };
            let (left, right) = (similarity(numbers), similarity(numbers));
            let back =
                estimate.carried(&left, &right).unwrap().carried(&left.inverse(), &right.inverse()).unwrap();
            assert!((back.a_from_b * estimate.a_from_b.inverse()).log().norm() < 1e-12);
            assert!((back.information - estimate.information).norm() < 1e-8 * estimate.information.norm());
            let twice = estimate.inverse().inverse();
            assert!((twice.information - estimate.information).norm() < 1e-8 * estimate.information.norm());
        }
    }

    /// The distance of two estimates is the same in whichever frames they are compared.
    #[test]
    fn distances_do_not_depend_on_the_frames() {
        for seed in 0..20 {
            let numbers = &mut Numbers::new(seed);
            let one = Estimate { a_from_b: similarity(numbers), information: information(numbers) };
            let step = SVector::<f64, 7>::from_fn(|_, _| numbers.uniform(-1e-4, 1e-4));
            let other =
                Estimate { a_from_b: Sim3::exp(&step) * one.a_from_b, information: information(numbers) };
            let (left, right) = (similarity(numbers), similarity(numbers));
            let none = SVector::zeros();
            let here = one.squared_distance(&other, &none).unwrap();
            let carried = |e: &Estimate| e.carried(&left, &right).unwrap();
            let there = carried(&one).squared_distance(&carried(&other), &none).unwrap();
            let inverted = one.inverse().squared_distance(&other.inverse(), &none).unwrap();
            assert!((here / there - 1.0).abs() < 1e-3, "{here} {there}");
            assert!((here / inverted - 1.0).abs() < 1e-3, "{here} {inverted}");
        }
    }

    #[test]
    fn the_mean_lies_where_the_information_is() {
        let numbers = &mut Numbers::new(3);
        let truth = similarity(numbers);
        let at = |size: f64, weight: f64| Estimate {
            a_from_b: Sim3::exp(&SVector::from([size, -size, 0.0, size, 0.0, 0.0, size])) * truth,
            information: SMatrix::identity() * weight,
        };
        let mean = mean(&[at(0.0, 3.0), at(0.004, 1.0)]).unwrap();
        let expected = at(0.001, 1.0).a_from_b;
        assert!((mean.a_from_b * expected.inverse()).log().norm() < 1e-6);
        assert!((mean.information - SMatrix::identity() * 4.0).norm() < 1e-12);
        assert_eq!(super::mean(&[]), None);
    }
}
