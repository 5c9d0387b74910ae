//! Where a polynomial changes sign, and the inverse of a growing function.

/// The smallest `x` in `(0, end)` where the polynomial of ascending coefficients changes sign.
pub(super) fn first_sign_change(coefficients: &[f64], end: f64) -> Option<f64> {
    sign_changes(coefficients, end).first().copied()
}

/// All sign changes in `(0, end)`, ascending: between two extrema there is at most one.
fn sign_changes(coefficients: &[f64], end: f64) -> Vec<f64> {
    if coefficients.len() < 2 {
        return Vec::new();
    }
    let derivative: Vec<f64> = coefficients.iter().enumerate().skip(1).map(|(i, c)| i as f64 * c).collect();
    let mut knots = vec![0.0];
    knots.extend(sign_changes(&derivative, end));
    knots.push(end);
    let value = |x: f64| polynomial(coefficients, x);
    knots
        .windows(2)
        .filter(|ends| value(ends[0]).signum() != value(ends[1]).signum())
        .map(|ends| {
            let (mut low, mut high) = (ends[0], ends[1]);
            let sign = value(low).signum();
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                if middle <= low || middle >= high {
                    break;
                }
                if value(middle).signum() == sign { low = middle } else { high = middle }
            }
            low
        })
        .collect()
}

/// Value of the polynomial of ascending coefficients.
pub(super) fn polynomial(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// The `x` in `[0, end]` with `f(x) = target`, for `f` growing from `f(0) = 0`; `f` returns value and
/// derivative. Newton's steps, halved into the bracket where they leave it. `None` beyond `f(end)`.
pub(super) fn invert_increasing(f: impl Fn(f64) -> (f64, f64), target: f64, end: f64) -> Option<f64> {
    if !(target >= 0.0 && target <= f(end).0) {
        return None;
    }
    let (mut low, mut high) = (0.0, end);
    let mut x = target.min(end);
    for _ in 0..100 {
        let (value, slope) = f(x);
        if value > target {
            high = x
        } else {
            low = x
        }
        let newton = x - (value - target) / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() <= 1e-15 * (1.0 + x) {
            return Some(next);
        }
        x = next;
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_first_of_several_roots() {
        // (x − 1)(x − 2)(x − 5) = x³ − 8x² + 17x − 10
        let cubic = [-10.0, 17.0, -8.0, 1.0];
        assert!((first_sign_change(&cubic, 10.0).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(sign_changes(&cubic, 10.0).len(), 3);
        assert_eq!(first_sign_change(&cubic, 0.5), None);
        assert_eq!(first_sign_change(&[1.0, 0.0, 1.0], 1e6), None);
    }

    #[test]
    fn inverts_through_flat_places() {
        let cube = |x: f64| (x * x * x, 3.0 * x * x);
        for target in [0.0f64, 1e-9, 0.3, 7.9, 8.0] {
            let x = invert_increasing(cube, target, 2.0).unwrap();
            assert!((x * x * x - target).abs() < 1e-12, "{target}");
        }
        assert_eq!(invert_increasing(cube, 8.1, 2.0), None);
        assert_eq!(invert_increasing(cube, f64::NAN, 2.0), None);
    }
}
