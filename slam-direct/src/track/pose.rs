//! A frame's pose by the points that are matched in it: refined by their reprojection errors, with its covariance.

use super::{TrackParams, View};
use crate::local_map::{LocalMap, Matched};
use crate::window::{
    PoseSolver, SeenPoint, add_residual, covariance, mahalanobis, predict, robust_covariance, robust_weight,
};
use geometry::sensor::Twist;
use geometry::{Se3, median};
use nalgebra::{Matrix6, SMatrix, SVector, Vector2};

/// The solver that refines a frame's pose.
pub(crate) const TRACKING: PoseSolver =
    PoseSolver { iterations: 12, wide: 5, settled: 1e-14, rotation_only: false };

/// Squared normalised residual below which a match agrees with the frame's pose.
pub(crate) const INLIER: f64 = 41.0;
/// The value to which the median of the squared normalised residuals is brought. It lies above that of χ² (0.45 for
/// one degree of freedom, 1.39 for two): the positional uncertainty follows the better matches, so that well-textured
/// patches keep their weight and the Cauchy kernel rejects the rest.
const MEDIAN_SQUARED: f64 = 4.0;
/// Residuals larger than this times the assumed variance are errors, not noise.
const MAX_RESIDUAL_SCALE: f64 = 9.0;

/// Refines a pose by the reprojection errors of matched points with fixed depths (robust Gauss–Newton), and marks the
/// inliers.
///
/// If all residuals are larger than assumed (a fast rotation under a rolling shutter, blur), the information of the
/// matches is lowered to what the frame shows.
///
/// Second value: the median of the squared residuals over the assumed one.
pub(crate) fn refine_pose(map: &LocalMap, view: &View, matched: &mut [Matched]) -> (Se3, f64) {
    let mut points: Vec<SeenPoint> =
        matched.iter().map(|m| world_point(map, &view.camera_from_world, &view.motion, m)).collect();
    let mut pose = view.camera_from_world;
    let mut assumed = None;
    for _ in 0..2 {
        pose = TRACKING.solve(&map.camera, &pose, &points);
        let mut squared: Vec<f32> = points.iter().map(|p| p.squared(&map.camera, &pose) as f32).collect();
        let residual_scale = median(&mut squared).map_or(1.0, |m| f64::from(m) / MEDIAN_SQUARED);
        assumed.get_or_insert(residual_scale);
        if residual_scale <= 1.0 {
            break;
        }
        let factor = 1.0 / residual_scale.min(MAX_RESIDUAL_SCALE);
        for (m, p) in matched.iter_mut().zip(&mut points) {
            m.information = m.information.map(|v| v * factor as f32);
            p.information = p.information.map(|v| v * factor);
        }
    }
    for (m, p) in matched.iter_mut().zip(&points) {
        m.squared = p.squared(&map.camera, &pose);
        m.inlier = m.squared < INLIER;
    }
    (pose, assumed.unwrap_or(1.0))
}

/// A pose is told against keyframes, which were frames and err as much.
const ERRING: f64 = 2.0;

/// Covariance of a frame's pose relative to the keyframes around it, of a right perturbation `(υ, ω)` of `world_from_camera`: in the
/// axes of the camera, map units and radians. It rests on the points that agree with the pose, and on how far they do; `None` where they leave
/// a motion open. What the map errs from one place to another is not in it.
pub(crate) fn pose_covariance(
    map: &LocalMap,
    camera_from_world: &Se3,
    motion: &Twist,
    matched: &[Matched],
) -> Option<Matrix6<f64>> {
    let points = inlier_points(map, camera_from_world, motion, matched);
    Some(robust_covariance(&map.camera, camera_from_world, &points)? * ERRING)
}

/// The points that agree with a pose.
fn inlier_points(
    map: &LocalMap,
    camera_from_world: &Se3,
    motion: &Twist,
    matched: &[Matched],
) -> Vec<SeenPoint> {
    let inliers = matched.iter().filter(|m| m.inlier);
    inliers.map(|m| world_point(map, camera_from_world, motion, m)).collect()
}

/// Standard deviation of a camera's position at a pose, along its least certain axis, from the points that agree and
/// over their median depth; infinite where they leave a motion open.
pub(crate) fn position_deviation(
    map: &LocalMap,
    camera_from_world: &Se3,
    motion: &Twist,
    matched: &[Matched],
) -> f64 {
    let points = inlier_points(map, camera_from_world, motion, matched);
    let depth = |p: &SeenPoint| {
        let direction =
            camera_from_world.rotation * p.direction + camera_from_world.translation * p.inverse_depth;
        (direction.z / p.inverse_depth) as f32
    };
    let depth = median(&mut points.iter().map(depth).collect::<Vec<f32>>());
    let Some((depth, covariance)) = depth.zip(covariance(&map.camera, camera_from_world, &points)) else {
        return f64::INFINITY;
    };
    let of_position = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    of_position.symmetric_eigenvalues().max().sqrt() / f64::from(depth)
}

/// The camera's motion while this frame is read, from its rows: the motion of the `view` with another rotation, whose
/// prior is that of the view with a standard deviation of `sigma` radians a second.
pub(crate) fn motion_by_rows(map: &LocalMap, view: &View, matched: &[Matched], sigma: f64) -> Twist {
    let mut h = SMatrix::<f64, 9, 9>::identity() * 1e-6;
    let mut g = SVector::<f64, 9>::zeros();
    (6..9).for_each(|k| h[(k, k)] = 1.0 / (sigma * sigma));
    let (rotation, translation) =
        (view.camera_from_world.rotation_matrix(), view.camera_from_world.translation);
    for m in matched.iter().filter(|m| m.inlier) {
        let point = world_point(map, &view.camera_from_world, &view.motion, m);
        let seen = predict(
            &map.camera,
            &rotation,
            &translation,
            &point.direction,
            point.inverse_depth,
            &point.pixel,
        );
        let Some(seen) = seen else { continue };
        let distorted = m.pixel.map(f64::from);
        let delay = map.sensor.delay(distorted);
        let by_rotation: [Vector2<f64>; 3] = std::array::from_fn(|k| {
            let mut rotated = Twist::zeros();
            rotated[3 + k] = 1.0;
            map.sensor.velocity(distorted, &rotated, 0.0) * delay
        });
        let row = |r: usize| {
            let [a, b, c, d, e, f] = seen.by_twist[r];
            SVector::<f64, 9>::from([
                a,
                b,
                c,
                d,
                e,
                f,
                by_rotation[0][r],
                by_rotation[1][r],
                by_rotation[2][r],
            ])
        };
        let weight = robust_weight(mahalanobis(&seen.residual, &point.information));
        let information = point.information.map(|v| v * weight);
        add_residual((&mut h, &mut g), &[row(0), row(1)], &seen.residual, information);
    }
    let mut motion = view.motion;
    if let Some(factor) = h.cholesky() {
        let step = -factor.solve(&g);
        (0..3).for_each(|k| motion[3 + k] += step[6 + k]);
    }
    motion
}

/// The positional uncertainty learnt from one more frame: it follows what the frames show, slowly, within
/// `params.least_position_sigma` and 1 pixel.
pub(crate) fn learn_position_sigma(params: &TrackParams, residual_scale: f64) -> f32 {
    const RATE: f64 = 0.05;
    let learnt = params.position_sigma * residual_scale.clamp(0.05, 20.0).powf(RATE) as f32;
    learnt.clamp(params.least_position_sigma, 1.0)
}

/// A match prepared for pose refinement: its point in the world, uncertain depth in its information.
pub(crate) fn world_point(
    map: &LocalMap,
    camera_from_world: &Se3,
    motion: &Twist,
    matched: &Matched,
) -> SeenPoint {
    let host = &map.keyframes[matched.at.host];
    let point = map.point(matched.at);
    let world_from_host = host.camera_from_world.inverse();
    let direction = world_from_host.rotation * point.ray + world_from_host.translation * point.inverse_depth;
    let mut information = matched.information.map(f64::from);
    let relative = *camera_from_world * world_from_host;
    let rotation = relative.rotation_matrix();
    let depth = (rotation * point.ray + relative.translation * point.inverse_depth).z;
    let distorted = matched.pixel.map(f64::from);
    let pixel = map.sensor.undistorted_pixel(distorted, motion, point.inverse_depth / depth);
    let predicted =
        predict(&map.camera, &rotation, &relative.translation, &point.ray, point.inverse_depth, &pixel);
    if let Some(p) = predicted {
        information = with_depth_variance(&information, &p.by_inverse_depth, point.variance);
    }
    SeenPoint { direction, inverse_depth: point.inverse_depth, pixel, information }
}

/// `(Λ⁻¹ + j jᵀ V)⁻¹` by Sherman–Morrison: the remaining information of a position when the depth is uncertain.
pub(crate) fn with_depth_variance(information: &[f64; 3], j: &[f64; 2], variance: f64) -> [f64; 3] {
    let [a, b, c] = *information;
    let w = [a * j[0] + b * j[1], b * j[0] + c * j[1]];
    let scale = variance / (1.0 + variance * (w[0] * j[0] + w[1] * j[1]));
    [a - scale * w[0] * w[0], b - scale * w[0] * w[1], c - scale * w[1] * w[1]]
}
