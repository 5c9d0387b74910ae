//! Derivatives of the rows.

use super::*;
use proptest::prelude::*;

proptest! {
    #[test]
    fn rows_are_derivatives(
        point in prop::array::uniform3(-20.0f64..20.0), centre in prop::array::uniform3(-20.0f64..20.0),
        normal in prop::array::uniform3(-1.0f64..1.0), column in 0usize..6,
    ) {
        let distance = |step: f64| {
            let mut increment = Vector6::zeros();
            increment[column] = step;
            let c = Vector3::from(centre);
            let pose = moved(&Se3::identity(), &c, &increment);
            Vector3::from(normal).dot(&(pose * Vector3::from(point)))
        };
        let h = 1e-5;
        let numeric = (distance(h) - distance(-h)) / (2.0 * h);
        let row = plane_row(point, centre, normal);
        prop_assert!((row[column] - numeric).abs() < 1e-6 * (1.0 + numeric.abs()), "{} {}", row[column], numeric);
    }
}
