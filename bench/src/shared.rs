//! How much of their way two cameras have in common.

use nalgebra::Vector3;

/// Cameras nearer to each other's path than this are on a common way, metres.
pub const NEAR: f64 = 1.0;

/// The length of path that two cameras share, in the unit of their positions: that of either's steps whose both ends
/// are nearer than `near` to the path of the other, whichever of the two lengths is larger.
pub fn shared_length(a: &[Vector3<f64>], b: &[Vector3<f64>], near: f64) -> f64 {
    length_near(a, b, near).max(length_near(b, a, near))
}

/// The length of those steps of `a` that are near to `b`.
fn length_near(a: &[Vector3<f64>], b: &[Vector3<f64>], near: f64) -> f64 {
    let is_near: Vec<bool> = a.iter().map(|position| distance(position, b) < near).collect();
    let steps = a.windows(2).zip(is_near.windows(2)).filter(|(_, near)| near[0] && near[1]);
    steps.map(|(step, _)| (step[1] - step[0]).norm()).sum()
}

/// How far a position is from a path; infinitely from none.
fn distance(position: &Vector3<f64>, path: &[Vector3<f64>]) -> f64 {
    let from_first = path.first().map_or(f64::INFINITY, |first| (position - first).norm());
    path.windows(2).map(|step| from_step(position, &step[0], &step[1])).fold(from_first, f64::min)
}

/// How far a position is from the line between two others.
fn from_step(position: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> f64 {
    let step = to - from;
    let along = (position - from).dot(&step) / step.norm_squared();
    // A step of no length has no direction.
    let along = if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.0 };
    (position - from - along * step).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(from: f64, to: f64, aside: f64, steps: usize) -> Vec<Vector3<f64>> {
        let at = |i: usize| from + (to - from) * i as f64 / steps as f64;
        (0..=steps).map(|i| Vector3::new(at(i), aside, 0.0)).collect()
    }

    #[test]
    fn paths_side_by_side_share_their_common_stretch() {
        let (a, b) = (line(0.0, 10.0, 0.0, 100), line(8.0, 20.0, 0.6, 120));
        // From 7.2 on `a` is within 1 m of where `b` begins: 0.6 aside, 0.8 before.
        assert!((shared_length(&a, &b, 1.0) - 2.8).abs() < 0.11, "{}", shared_length(&a, &b, 1.0));
        assert_eq!(shared_length(&a, &b, 1.0), shared_length(&b, &a, 1.0));
        assert_eq!(shared_length(&a, &b, 0.5), 0.0);
    }

    #[test]
    fn the_direction_of_travel_does_not_matter() {
        let a = line(0.0, 10.0, 0.0, 100);
        let mut b = line(8.0, 20.0, 0.3, 120);
        let same = shared_length(&a, &b, 1.0);
        b.reverse();
        assert!((shared_length(&a, &b, 1.0) - same).abs() < 1e-12);
    }

    #[test]
    fn between_two_far_positions_lies_a_path() {
        let (a, b) = (line(4.0, 6.0, 0.0, 20), line(0.0, 10.0, 0.5, 1));
        assert!((shared_length(&a, &b, 1.0) - 2.0).abs() < 1e-12);
        assert_eq!(shared_length(&a, &[], 1.0), 0.0);
    }
}
