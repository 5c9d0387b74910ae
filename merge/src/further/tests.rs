use super::*;
use crate::estimate::Estimate;
use nalgebra::SVector;

fn pairs(count: u32) -> Vec<(KeyframeId, KeyframeId)> {
    (0..count).map(|k| (KeyframeId(k), KeyframeId(100 + k))).collect()
}

fn sources(pairs: Vec<(KeyframeId, KeyframeId)>) -> Vec<u32> {
    pairs.into_iter().map(|(source, _)| source.0).collect()
}

#[test]
fn pairs_are_spread_from_end_to_end() {
    assert_eq!(sources(spread(pairs(9), 3, &[])), [0, 4, 8]);
    assert_eq!(sources(spread(pairs(10), 4, &[])), [0, 3, 6, 9]);
    assert_eq!(sources(spread(pairs(3), 8, &[])), [0, 1, 2]);
    assert_eq!(sources(spread(pairs(3), 1, &[])), [0]);
    assert!(spread(pairs(3), 0, &[]).is_empty() && spread(pairs(0), 0, &[]).is_empty());
}

/// Where an edge is, all that it knows counts; from farther away its turns blur the motion, and its own offset does not.
#[test]
fn edges_know_less_of_a_motion_far_away() {
    let estimate = Estimate { a_from_b: Sim3::identity(), information: SMatrix::identity() };
    let edge = edge(KeyframeId(0), KeyframeId(100), estimate);
    let from = |x: f64| Sim3 { translation: nalgebra::Vector3::new(x, 0.0, 0.0), ..Sim3::identity() };
    let deviations = |edges: &[&Edge], x: f64| {
        let covariance = information_at(edges, |_| Some(from(x))).try_inverse().unwrap();
        covariance.diagonal().map(f64::sqrt)
    };
    let (here, twice) = (deviations(&[&edge], 0.0), deviations(&[&edge, &edge], 0.0));
    assert!((here - SVector::repeat(1.0)).norm() < 1e-12);
    assert!((twice - SVector::repeat(0.5f64.sqrt())).norm() < 1e-12);
    let there = deviations(&[&edge], 3.0);
    // What is left unknown of the turn moves it aside, of the scale along the way.
    let offset = 10f64.sqrt();
    assert!((there - SVector::from([offset, offset, offset, 1.0, 1.0, 1.0, 1.0])).norm() < 1e-9, "{there}");
    assert_eq!(information_at(&[&edge], |_| None), SMatrix::<f64, 7, 7>::zeros());
}

#[test]
fn pairs_with_an_edge_are_not_tested_again() {
    let estimate = Estimate { a_from_b: Sim3::identity(), information: SMatrix::identity() };
    let known =
        [edge(KeyframeId(0), KeyframeId(100), estimate), edge(KeyframeId(1), KeyframeId(102), estimate)];
    assert_eq!(sources(spread(pairs(4), 8, &known)), [1, 2, 3]);
}
