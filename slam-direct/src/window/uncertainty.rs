//! The uncertainty of depths beyond the noise of single observations: by the poses, and by what rotations leave
//! behind.

use super::cost::predict;
use super::linear::Normal;
use super::pairs::{Pairs, Relative};
use super::problem::{Problem, WindowPoint};

/// How far a point may lie in an image from where a rotation has it, one standard deviation, as a share of the way that the
/// rotation moves it: focal length, lens and shutter are known to no more. Calibrations of public recordings are off by up to
/// 0.015 at the corner (`mapping.lens_sigma`), and a part of that is taken up by the pose.
const ROTATION_SIGMA: f64 = 0.02;

/// Variance of an inverse depth over its square from which on nothing is known of it.
pub(crate) const UNKNOWN: f64 = 1e4;

/// Variance of a point's inverse depth, squared 1/map unit, that comes of what a view's rotation leaves uncertain: all points of the
/// view have it together, so that many of them know no more than one. A view that only turned says nothing about depth.
pub(crate) fn variance_by_rotation(
    camera: &geometry::Pinhole,
    relative: &Relative,
    ray: &nalgebra::Vector3<f64>,
    inverse_depth: f64,
) -> f64 {
    let Relative { pose, rotation } = relative;
    let at_infinity = predict(camera, rotation, &pose.translation, ray, 0.0, &camera.project(ray).into());
    let seen = predict(camera, rotation, &pose.translation, ray, inverse_depth, &[0.0; 2]);
    let Some((at_infinity, seen)) = at_infinity.zip(seen) else { return f64::INFINITY };
    let square = |[x, y]: [f64; 2]| x * x + y * y;
    let variance = ROTATION_SIGMA.powi(2) * square(at_infinity.residual) / square(seen.by_inverse_depth);
    if variance.is_finite() { variance } else { f64::INFINITY }
}

/// The same of the view that leaves the least, of those that see a point of the problem.
pub(crate) fn least_variance_by_rotation(
    problem: &Problem,
    pairs: &Pairs,
    relative: &[Relative],
    point: &WindowPoint,
) -> f64 {
    let of =
        |i| variance_by_rotation(&problem.camera, &relative[pairs.of(i)], &point.ray, point.inverse_depth);
    point
        .observations
        .clone()
        .map(of)
        .fold(f64::INFINITY, f64::min)
        .min(UNKNOWN * point.inverse_depth.powi(2))
}

/// Variance that the uncertainty of the poses adds to each point's inverse depth, squared 1/map unit: what comes on top of
/// [`WindowPoint::information`](super::WindowPoint::information), which takes the poses for exact.
///
/// The scale of what the free frames see is known only by what they share with the frames that are fixed. Where that is
/// little, all depths among them vary together, and this is large for each of them. A problem that holds fewer than two
/// frames has no scale to compare with: the two oldest hold it then.
///
/// `None` where the frames leave a motion open.
pub(crate) fn variances_by_poses(problem: &Problem, pairs: &Pairs) -> Option<Vec<f64>> {
    let mut anchored = problem.clone();
    anchored.calibration = None;
    let lacking = 2usize.saturating_sub(anchored.fixed.iter().filter(|fixed| **fixed).count());
    anchored.fixed.iter_mut().filter(|fixed| !**fixed).take(lacking).for_each(|fixed| *fixed = true);
    let mut normal = Normal::new(&anchored, pairs).ok()?;
    normal.linearise(&anchored, pairs, &pairs.relative(&anchored.frames));
    normal.variances_by_poses(&anchored, pairs)
}
