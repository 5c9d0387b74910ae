//! An image that is bent: by a focal length that is off, a lens that is not the map's, rows that a moving camera reads one after the other.
//!
//! What bends an image moves its parts against one another as things that move do, but evenly: one smooth change of the whole image explains
//! it. What moves has an edge, which no smooth change has.

use crate::track::{INLIER, TRACKING};
use crate::window::{SeenPoint, add_residual, mahalanobis, predict, robust_weight};
use geometry::{Pinhole, Se3};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// The pose of the middle row (six), how it changes from the first row to the last (six), the logarithm of the focal length, the first radial
/// distortion (Brown, *Decentering distortion of lenses*, 1966), and how much longer lengths are to the right and further down (two): a turn that is
/// seen with a focal length that is off.
const UNKNOWNS: usize = 16;

/// A point's residual in pixels, and its derivative by what bends an image, two rows.
struct Row {
    index: usize,
    residual: [f64; 2],
    derivative: [SVector<f64, UNKNOWNS>; 2],
    information: [f64; 3],
}

impl Row {
    fn of(
        camera: &Pinhole,
        (rotation, translation): &(Matrix3<f64>, Vector3<f64>),
        point: &SeenPoint,
        index: usize,
    ) -> Option<Self> {
        let seen =
            predict(camera, rotation, translation, &point.direction, point.inverse_depth, &point.pixel)?;
        let [u, v] = [point.pixel[0] - camera.cx, point.pixel[1] - camera.cy];
        let row = v / camera.height as f64;
        let (x, y) = (u / camera.fx, v / camera.fy);
        let derivative = [(0, u), (1, v)].map(|(axis, from_middle): (usize, f64)| {
            let pose = seen.by_twist[axis];
            SVector::from_fn(|k, _| match k {
                0..6 => pose[k],
                6..12 => row * pose[k - 6],
                12 => from_middle,
                13 => from_middle * (x * x + y * y),
                14 => from_middle * x,
                _ => from_middle * y,
            })
        });
        Some(Self { index, residual: seen.residual, derivative, information: point.information })
    }

    fn residual(&self, bend: &SVector<f64, UNKNOWNS>) -> [f64; 2] {
        [0, 1].map(|axis| self.residual[axis] + self.derivative[axis].dot(bend))
    }

    fn squared(&self, bend: &SVector<f64, UNKNOWNS>) -> f64 {
        mahalanobis(&self.residual(bend), &self.information)
    }
}

/// The `points`, by their numbers in order, that agree with one bent image seen from near `pose`: robust Gauss–Newton, linear about the pose, with the
/// steps and the kernel that refine a frame's pose.
pub(super) fn inliers(camera: &Pinhole, pose: &Se3, points: &[SeenPoint]) -> Vec<usize> {
    let pose = (pose.rotation_matrix(), pose.translation);
    let rows: Vec<Row> =
        points.iter().enumerate().filter_map(|(i, point)| Row::of(camera, &pose, point, i)).collect();
    let mut bend = SVector::<f64, UNKNOWNS>::zeros();
    for step in 0..TRACKING.iterations {
        let mut h = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::identity() * 1e-6;
        let mut g = SVector::<f64, UNKNOWNS>::zeros();
        for row in &rows {
            let residual = row.residual(&bend);
            let weight = robust_weight(mahalanobis(&residual, &row.information) / TRACKING.widening(step));
            let information = row.information.map(|v| v * weight);
            add_residual((&mut h, &mut g), &row.derivative, &residual, information);
        }
        let Some(factor) = h.cholesky() else { break };
        bend -= factor.solve(&g);
    }
    rows.iter().filter(|row| row.squared(&bend) < INLIER).map(|row| row.index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Random;
    use nalgebra::Vector6;

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 410.0, cx: 319.5, cy: 239.5 };
    const COUNT: usize = 200;

    /// Points before a camera at the origin, each seen where `project` says from its position.
    fn seen(project: impl Fn(&Vector3<f64>) -> [f64; 2]) -> Vec<SeenPoint> {
        let mut random = Random::new(3);
        let point = |_| {
            let direction = CAMERA.unproject(640.0 * random.unit(), 480.0 * random.unit());
            let inverse_depth = 0.2 + 0.4 * random.unit();
            let information = [25.0, 0.0, 25.0];
            SeenPoint { direction, inverse_depth, pixel: project(&(direction / inverse_depth)), information }
        };
        (0..COUNT).map(point).collect()
    }

    fn explained(points: &[SeenPoint]) -> usize {
        inliers(&CAMERA, &Se3::identity(), points).len()
    }

    fn by(camera: &Pinhole, motion: &Vector6<f64>, at: &Vector3<f64>) -> [f64; 2] {
        let pixel = camera.project(&(Se3::exp(motion) * *at));
        [pixel.x, pixel.y]
    }

    #[test]
    fn what_bends_an_image_explains_all_of_it() {
        let still = Vector6::zeros();
        let unbent = seen(|at| by(&CAMERA, &still, at));
        assert_eq!(explained(&unbent), COUNT);
        // Lengths of 4 % more, and rows that are read while the camera goes and turns: several pixels from where they belong.
        let longer = Pinhole { fx: 1.04 * CAMERA.fx, fy: 1.04 * CAMERA.fy, ..CAMERA };
        assert_eq!(explained(&seen(|at| by(&longer, &still, at))), COUNT);
        let turning = Vector6::new(0.03, 0.0, 0.0, 0.005, 0.02, 0.01);
        let rolling =
            |at: &Vector3<f64>| by(&CAMERA, &(turning * (by(&CAMERA, &still, at)[1] / 480.0 - 0.5)), at);
        let rolling = seen(rolling);
        assert!(rolling.iter().any(|point| point.squared(&CAMERA, &Se3::identity()) > INLIER));
        assert_eq!(explained(&rolling), COUNT);
    }

    #[test]
    fn what_drives_off_in_the_middle_of_the_view_is_not_explained() {
        let (still, driven) = (Vector6::zeros(), Vector6::new(0.08, 0.0, 0.04, 0.0, 0.0, 0.0));
        let is_in_the_middle = |at: &Vector3<f64>| (at.x / at.z).abs() < 0.3 && (at.y / at.z).abs() < 0.35;
        let points = seen(|at| by(&CAMERA, if is_in_the_middle(at) { &driven } else { &still }, at));
        let moved: Vec<usize> =
            (0..COUNT).filter(|&i| points[i].squared(&CAMERA, &Se3::identity()) > INLIER).collect();
        let explained = inliers(&CAMERA, &Se3::identity(), &points);
        let of_it = moved.iter().filter(|i| explained.binary_search(i).is_ok()).count();
        assert!(moved.len() > COUNT / 5 && 3 * of_it < moved.len(), "{of_it} of {}", moved.len());
        assert!(explained.len() - of_it > 9 * (COUNT - moved.len()) / 10, "the rest agrees");
    }
}
