//! Numbers that describe others.

use num_traits::float::TotalOrder;

/// The median, of an even number of values the upper of the two in the middle; `None` of none. Reorders its input.
///
/// ```
/// assert_eq!(geometry::median(&mut [3.0, 1.0, 2.0]), Some(2.0));
/// ```
pub fn median<T: Copy + TotalOrder>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, T::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_upper_of_two_is_the_median_and_nothing_has_none() {
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median(&mut [5.0_f32, -1.0, 2.0]), Some(2.0));
        assert_eq!(median::<f64>(&mut []), None);
        assert!(median(&mut [f64::NAN, f64::INFINITY]).is_some_and(f64::is_nan), "NaN is the largest");
    }
}
