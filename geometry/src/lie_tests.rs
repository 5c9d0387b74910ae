//! Identities that hold in any Lie group, checked on SE(3) and Sim(3).

use crate::{Se3, Sim3};
use nalgebra::{Matrix4, SMatrix, SVector, Vector3};
use proptest::prelude::*;
use std::f64::consts::PI;

type Vector7 = SVector<f64, 7>;

/// Rotations of all sizes: tiny, around the thresholds of the series, ordinary, close to π.
fn angle() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(0.0),
        (-14.0..0.0f64).prop_map(|exponent| 10f64.powf(exponent)),
        0.0..PI,
        (-12.0..-1.0f64).prop_map(|exponent| PI - 10f64.powf(exponent)),
    ]
}

fn direction() -> impl Strategy<Value = Vector3<f64>> {
    (-1.0..1.0f64, 0.0..2.0 * PI).prop_map(|(z, rotation)| {
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * rotation.cos(), r * rotation.sin(), z)
    })
}

fn log_scale() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(0.0),
        (-14.0..0.0f64, any::<bool>())
            .prop_map(|(exponent, negative)| { 10f64.powf(exponent) * if negative { -1.0 } else { 1.0 } }),
        -1.5..1.5f64,
    ]
}

fn tangent() -> impl Strategy<Value = Vector7> {
    (angle(), direction(), (-3.0..3.0, -3.0..3.0, -3.0..3.0), log_scale()).prop_map(
        |(angle, axis, (x, y, z), lambda)| {
            let w = axis * angle;
            Vector7::from([x, y, z, w.x, w.y, w.z, lambda])
        },
    )
}

fn rigid(tangent: &Vector7) -> nalgebra::Vector6<f64> {
    tangent.fixed_rows::<6>(0).into_owned()
}

/// The matrix of the Lie algebra, to exponentiate the plain way.
fn algebra(t: &Vector7) -> Matrix4<f64> {
    let mut matrix = Matrix4::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&crate::hat(&Vector3::new(t[3], t[4], t[5])));
    for i in 0..3 {
        matrix[(i, i)] = t[6];
        matrix[(i, 3)] = t[i];
    }
    matrix
}

/// `Σ Aⁿ / n!`; 60 terms are exact to rounding for |A| < 6.
fn power_series(a: &Matrix4<f64>) -> Matrix4<f64> {
    let (mut sum, mut term) = (Matrix4::identity(), Matrix4::identity());
    for n in 1..60 {
        term = term * a / n as f64;
        sum += term;
    }
    sum
}

fn distance<const R: usize, const C: usize>(a: &SMatrix<f64, R, C>, b: &SMatrix<f64, R, C>) -> f64 {
    (a - b).amax()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn exp_is_the_matrix_exponential(t in tangent()) {
        prop_assert!(distance(&Sim3::exp(&t).to_matrix(), &power_series(&algebra(&t))) < 2e-12);
        let mut without_scale = t;
        without_scale[6] = 0.0;
        let series = power_series(&algebra(&without_scale));
        prop_assert!(distance(&Se3::exp(&rigid(&t)).to_matrix(), &series) < 2e-12);
    }

    #[test]
    fn log_inverts_exp(t in tangent()) {
        let motion = Se3::exp(&rigid(&t));
        prop_assert!(distance(&Se3::exp(&motion.log()).to_matrix(), &motion.to_matrix()) < 1e-11);
        let similarity = Sim3::exp(&t);
        prop_assert!(distance(&Sim3::exp(&similarity.log()).to_matrix(), &similarity.to_matrix()) < 1e-11);
        // The tangent itself is unique below π; at π the axis may flip.
        let w = t.fixed_rows::<3>(3).norm();
        if w < PI - 1e-6 {
            prop_assert!(distance(&motion.log(), &rigid(&t)) < 1e-11);
            prop_assert!(distance(&similarity.log(), &t) < 1e-11);
        }
        prop_assert!(similarity.log().fixed_rows::<3>(3).norm() <= PI + 1e-12);
    }

    #[test]
    fn the_inverse_undoes(t in tangent()) {
        let motion = Se3::exp(&rigid(&t));
        prop_assert!(distance(&(motion * motion.inverse()).to_matrix(), &Matrix4::identity()) < 1e-13);
        prop_assert!(distance(&(motion.inverse() * motion).to_matrix(), &Matrix4::identity()) < 1e-13);
        prop_assert!(distance(&motion.inverse().to_matrix(), &Se3::exp(&-rigid(&t)).to_matrix()) < 1e-11);
        let similarity = Sim3::exp(&t);
        let both = (similarity * similarity.inverse(), similarity.inverse() * similarity);
        prop_assert!(distance(&both.0.to_matrix(), &Matrix4::identity()) < 1e-12);
        prop_assert!(distance(&both.1.to_matrix(), &Matrix4::identity()) < 1e-12);
        prop_assert!(distance(&similarity.inverse().to_matrix(), &Sim3::exp(&-t).to_matrix()) < 1e-11);
    }

    #[test]
    fn products_are_associative_and_agree_with_matrices(a in tangent(), b in tangent(), c in tangent()) {
        let [p, q, r] = [a, b, c].map(|t| Sim3::exp(&t));
        prop_assert!(distance(&((p * q) * r).to_matrix(), &(p * (q * r)).to_matrix()) < 1e-10);
        prop_assert!(distance(&(p * q).to_matrix(), &(p.to_matrix() * q.to_matrix())) < 1e-11);
        let x = Vector3::new(0.3, -1.2, 2.0);
        prop_assert!(distance(&((p * q) * x), &(p * (q * x))) < 1e-10);
        let [p, q, r] = [a, b, c].map(|t| Se3::exp(&rigid(&t)));
        prop_assert!(distance(&((p * q) * r).to_matrix(), &(p * (q * r)).to_matrix()) < 1e-12);
        prop_assert!(distance(&(p * q).to_matrix(), &(p.to_matrix() * q.to_matrix())) < 1e-12);
        prop_assert!(distance(&((p * q) * x), &(p * (q * x))) < 1e-12);
        prop_assert!(distance(&Sim3::from(p).to_matrix(), &p.to_matrix()) == 0.0);
    }

    #[test]
    fn the_adjoint_carries_tangents_across(g in tangent(), t in tangent()) {
        let t = t * 0.2;
        let motion = Se3::exp(&rigid(&g));
        let across = motion * Se3::exp(&rigid(&t)) * motion.inverse();
        let carried = Se3::exp(&(motion.adjoint() * rigid(&t)));
        prop_assert!(distance(&across.to_matrix(), &carried.to_matrix()) < 1e-11);
        let similarity = Sim3::exp(&g);
        let across = similarity * Sim3::exp(&t) * similarity.inverse();
        let carried = Sim3::exp(&(similarity.adjoint() * t));
        prop_assert!(distance(&across.to_matrix(), &carried.to_matrix()) < 1e-10);
    }

    #[test]
    fn tum_values_come_back(t in tangent()) {
        let motion = Se3::exp(&rigid(&t));
        prop_assert!(distance(&Se3::from_tum(motion.to_tum()).to_matrix(), &motion.to_matrix()) < 1e-14);
    }
}
