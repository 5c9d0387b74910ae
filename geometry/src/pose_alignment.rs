//! The alignment of two trajectories of one body: the similarity between their worlds, from positions and rotations.
//!
//! Points on one line do not fix the rotation about it ([`umeyama`](crate::umeyama)). Poses do, so a robot that
//! drives straight on is enough. The method is robust least squares. Rotation, scale and translation start at the
//! values on which most pairs agree. Then all seven degrees of freedom are refined together with Cauchy weights,
//! whose widths are estimated from the residuals.

use crate::{Se3, Sim3, hat, median};
use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

/// Pairs that the search begins with, spread over all.
const STARTS: usize = 64;
/// Steps of the refinement; they end earlier where nothing moves any more.
const STEPS: usize = 30;
/// A standard deviation along an axis by the median length of three normal numbers.
const BY_MEDIAN_LENGTH: f64 = 0.6501;
/// Cauchy's kernel, 95 % efficient for normal residuals, in standard deviations.
const CAUCHY: f64 = 2.385;

/// One body at one instant, in two worlds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// Its pose in the target's world.
    pub target_from_body: Se3,
    /// Its pose in the source's world.
    pub source_from_body: Se3,
}

/// The relative pose and scale of two worlds, with the evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseAlignment {
    /// Maps points of the source's world into the target's.
    pub target_from_source: Sim3,
    /// Pairs of poses.
    pub pairs: usize,
    /// How far the body is from the middle of its way in the target's world, root mean square, target units.
    pub reach: f64,
    /// Median distance between the positions, target units.
    pub distance: f64,
    /// Median angle between the poses, radians.
    pub angle: f64,
}

impl PoseAlignment {
    /// The uncertainty of the scale, as a share of it. Errors of successive pairs are alike, so this counts all pairs
    /// as no more than one.
    pub fn scale_doubt(&self) -> f64 {
        self.distance / self.reach
    }
}

/// Why trajectories cannot be aligned.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PoseAlignmentError {
    /// Three pairs are the fewest that show whether they agree.
    #[error("cannot align {0} pairs of poses: at least 3 are needed")]
    TooFew(usize),
    /// In one of the worlds the body stays where it is, it goes against its way in the other, or a number is not finite: no
    /// scale brings them together.
    #[error(
        "cannot align the poses: in one world the body stays in one place, or goes against its way in the other"
    )]
    Degenerate,
}

/// The similarity between the worlds of two trajectories that most of `pairs` agree on.
///
/// # Errors
/// With fewer than three pairs, or where the scale is open.
pub fn align_poses(pairs: &[PosePair]) -> Result<PoseAlignment, PoseAlignmentError> {
    if pairs.len() < 3 {
        return Err(PoseAlignmentError::TooFew(pairs.len()));
    }
    let is_finite = |pair: &PosePair| pair.target_from_body.is_finite() && pair.source_from_body.is_finite();
    if !pairs.iter().all(is_finite) {
        return Err(PoseAlignmentError::Degenerate);
    }
    let rotation = rotation(pairs);
    let start = scale_and_translation(pairs, rotation).ok_or(PoseAlignmentError::Degenerate)?;
    let target_from_source = refined(pairs, start).ok_or(PoseAlignmentError::Degenerate)?;
    let positions = || pairs.iter().map(|pair| pair.target_from_body.translation);
    let middle = positions().sum::<Vector3<f64>>() / pairs.len() as f64;
    let square = positions().map(|p| (p - middle).norm_squared()).sum::<f64>() / pairs.len() as f64;
    let residuals = residuals(pairs, &target_from_source);
    Ok(PoseAlignment {
        target_from_source,
        pairs: pairs.len(),
        reach: square.sqrt(),
        distance: median_of(residuals.iter().map(|r| r.position.norm())),
        angle: median_of(residuals.iter().map(|r| r.rotation_error.norm())),
    })
}

/// The rotation between the worlds as one pair has it.
fn rotation_of(pair: &PosePair) -> UnitQuaternion<f64> {
    pair.target_from_body.rotation * pair.source_from_body.rotation.inverse()
}

/// The rotation between the worlds with the least median angle to those of the pairs, of a few of them.
fn rotation(pairs: &[PosePair]) -> UnitQuaternion<f64> {
    let step = pairs.len().div_ceil(STARTS).max(1);
    let starts = || pairs.iter().step_by(step).map(rotation_of);
    let off = |start: &UnitQuaternion<f64>| median_of(starts().map(|other| start.angle_to(&other)));
    starts().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_default()
}

/// Scale and translation at a rotation with the least median distance, of those that two instants half or a third of the way
/// apart say (Rousseeuw, "Least median of squares regression", JASA 1984): of wrong poses a third and more does not matter.
fn scale_and_translation(pairs: &[PosePair], rotation: UnitQuaternion<f64>) -> Option<Sim3> {
    let step = pairs.len().div_ceil(STARTS).max(1);
    let point =
        |pair: &PosePair| [rotation * pair.source_from_body.translation, pair.target_from_body.translation];
    let points: Vec<[Vector3<f64>; 2]> = pairs.iter().step_by(step).map(point).collect();
    let from = |i: usize, apart: usize| {
        let (a, b) = (points[i], points[(i + apart) % points.len()]);
        let (source, target) = (b[0] - a[0], b[1] - a[1]);
        let scale = source.dot(&target) / source.norm_squared();
        let start = Sim3::new(rotation, a[1] - a[0] * scale, scale);
        (scale.is_finite() && scale > 0.0).then_some(start)
    };
    let off = |start: &Sim3| {
        median_of(points.iter().map(|p| (p[0] * start.scale + start.translation - p[1]).norm()))
    };
    let aparts = [points.len() / 2, points.len().div_ceil(3)];
    let starts = (0..points.len()).flat_map(|i| aparts.map(|apart| from(i, apart)));
    starts.flatten().min_by(|a, b| off(a).total_cmp(&off(b)))
}

/// What a pair says against an alignment.
struct Residual {
    /// Where the alignment has the body, target units.
    at: Vector3<f64>,
    /// From the target's position to that.
    position: Vector3<f64>,
    /// The turn from the target's pose to the aligned one, in the target's world, radians.
    rotation_error: Vector3<f64>,
}

fn residuals(pairs: &[PosePair], target_from_source: &Sim3) -> Vec<Residual> {
    let residual = |pair: &PosePair| {
        let at = *target_from_source * pair.source_from_body.translation;
        let rotation_error = (target_from_source.rotation * rotation_of(pair).inverse()).scaled_axis();
        Residual { at, position: at - pair.target_from_body.translation, rotation_error }
    };
    pairs.iter().map(residual).collect()
}

/// All seven degrees of freedom by Gauss–Newton, about the middle of the way, where they hardly mix.
fn refined(pairs: &[PosePair], start: Sim3) -> Option<Sim3> {
    let mut target_from_source = start;
    for _ in 0..STEPS {
        let residuals = residuals(pairs, &target_from_source);
        let middle = residuals.iter().map(|r| r.at).sum::<Vector3<f64>>() / residuals.len() as f64;
        let reach = residuals.iter().map(|r| (r.at - middle).norm()).fold(0.0, f64::max);
        // Exact poses have widths of rounding; no width at all would divide by zero.
        let width = |residuals: &mut dyn Iterator<Item = f64>, unit: f64| {
            (CAUCHY * BY_MEDIAN_LENGTH * median_of(residuals)).max(1e-9 * unit)
        };
        let far = width(&mut residuals.iter().map(|r| r.position.norm()), reach);
        let turned = width(&mut residuals.iter().map(|r| r.rotation_error.norm()), 1.0);
        if !(far > 0.0 && far.is_finite() && turned.is_finite()) {
            return None;
        }
        let (mut information, mut gradient) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
        for residual in &residuals {
            let (at, mut by) = (residual.at - middle, SMatrix::<f64, 6, 7>::zeros());
            by.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            by.fixed_view_mut::<3, 3>(0, 3).copy_from(&-hat(&at));
            by.fixed_view_mut::<3, 1>(0, 6).copy_from(&at);
            by.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
            let mut off = SVector::<f64, 6>::zeros();
            off.fixed_rows_mut::<3>(0).copy_from(&residual.position);
            off.fixed_rows_mut::<3>(3).copy_from(&residual.rotation_error);
            let cauchy = |off: f64, width: f64| 1.0 / (width * width + off * off);
            let (near, straight) =
                (cauchy(residual.position.norm(), far), cauchy(residual.rotation_error.norm(), turned));
            let weights = SVector::<f64, 6>::from([near, near, near, straight, straight, straight]);
            let weighted = SMatrix::<f64, 6, 6>::from_diagonal(&weights);
            information += by.transpose() * weighted * by;
            gradient += by.transpose() * weighted * off;
        }
        let step = -(information.cholesky()?.solve(&gradient));
        let centred = Sim3 { translation: -middle, ..Sim3::identity() };
        target_from_source = centred.inverse() * Sim3::exp(&step) * centred * target_from_source;
        target_from_source.rotation.renormalize();
        let moved =
            step.fixed_rows::<3>(0).norm() / reach.max(f64::MIN_POSITIVE) + step.fixed_rows::<4>(3).norm();
        if moved < 1e-10 {
            break;
        }
    }
    target_from_source.is_valid().then_some(target_from_source)
}

/// The median; 0 of none.
fn median_of(values: impl Iterator<Item = f64>) -> f64 {
    median(&mut values.collect::<Vec<_>>()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    /// A body on its way, turning as `rotation_error` says, seen from two worlds.
    fn pairs(count: usize, swing: f64, target_from_source: &Sim3) -> Vec<PosePair> {
        let pair = |i: usize| {
            let s = i as f64 / count as f64;
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.1 * swing * s, swing * s, 0.3));
            let source = Se3::new(rotation, Vector3::new(4.0 * s, swing * (5.0 * s).sin(), 0.0));
            let target = (*target_from_source * Sim3::from(source)).rigid();
            PosePair { target_from_body: target, source_from_body: source }
        };
        (0..count).map(pair).collect()
    }

    proptest! {
        #[test]
        fn worlds_are_aligned_on_straight_paths_too(
            tangent in prop::array::uniform6(-1.0f64..1.0), scale in 0.05f64..40.0, swing in prop::sample::select(vec![0.0, 1.5]),
        ) {
            let rigid = Se3::exp(&(Vector6::from(tangent) * 2.0));
            let truth = Sim3::new(rigid.rotation, rigid.translation * 10.0, scale);
            let found = align_poses(&pairs(40, swing, &truth)).unwrap();
            prop_assert!((found.target_from_source.inverse() * truth).log().norm() < 1e-7, "{found:?}");
            prop_assert!(found.scale_doubt() < 1e-7 && found.angle < 1e-7);
        }
    }

    #[test]
    fn a_third_of_wrong_poses_does_not_matter() {
        let truth =
            Sim3::new(UnitQuaternion::from_euler_angles(0.1, 1.0, -2.0), Vector3::new(3.0, 1.0, 2.0), 2.5);
        let mut pairs = pairs(90, 1.0, &truth);
        for pair in pairs.iter_mut().step_by(3) {
            pair.source_from_body =
                Se3::exp(&Vector6::new(7.0, 0.0, 3.0, 1.0, 1.0, 0.0)) * pair.source_from_body;
        }
        let found = align_poses(&pairs).unwrap();
        assert!((found.target_from_source.inverse() * truth).log().norm() < 1e-3, "{found:?}");
    }

    /// Residuals as large as the way say that the scale is a guess.
    #[test]
    fn what_does_not_belong_together_is_in_doubt_and_rest_is_refused() {
        let mut pairs = pairs(40, 1.0, &Sim3::identity());
        for (i, pair) in pairs.iter_mut().enumerate() {
            let wild = |k: f64| (k * i as f64).sin();
            pair.source_from_body.translation = Vector3::new(wild(12.9), wild(78.2), wild(37.7));
        }
        if let Ok(found) = align_poses(&pairs) {
            assert!(found.scale_doubt() > 0.3, "{found:?}");
        }
        pairs.iter_mut().for_each(|pair| pair.source_from_body.translation = Vector3::zeros());
        assert_eq!(align_poses(&pairs), Err(PoseAlignmentError::Degenerate));
        assert_eq!(align_poses(&pairs[..2]), Err(PoseAlignmentError::TooFew(2)));
        pairs[3].target_from_body.translation.x = f64::NAN;
        assert_eq!(align_poses(&pairs), Err(PoseAlignmentError::Degenerate));
    }
}
