//! Bringing the estimate into the frame and unit of the ground truth.

use crate::{Associated, EvalError};
use geometry::Sim3;
use geometry::umeyama::{self, UmeyamaError};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// What may be adjusted before errors are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlignMode {
    /// Nothing: both are in one frame and unit.
    None,
    /// Rotation and translation.
    Se3,
    /// Rotation, translation and scale: what a monocular estimate leaves open.
    #[default]
    Sim3,
    /// The scale alone, taken from the Sim(3) alignment.
    Scale,
}

/// Aligns the estimate with the ground truth over all camera positions (Umeyama 1991) and returns the
/// transform `truth_from_estimate` beside the aligned pairs.
pub fn align(pairs: &Associated, mode: AlignMode) -> Result<(Sim3, Associated), EvalError> {
    let truth_from_estimate = alignment(pairs, mode)?;
    Ok((truth_from_estimate, pairs.transformed(&truth_from_estimate)))
}

/// The transform `truth_from_estimate` alone, see [`align`].
pub(crate) fn alignment(pairs: &Associated, mode: AlignMode) -> Result<Sim3, UmeyamaError> {
    let (source, target) = pairs.positions();
    Ok(match mode {
        AlignMode::None => Sim3::identity(),
        AlignMode::Se3 => umeyama::se3(&source, &target)?.into(),
        AlignMode::Sim3 => umeyama::sim3(&source, &target)?,
        AlignMode::Scale => {
            let scale = umeyama::scale(&source, &target)?;
            Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), scale)
        }
    })
}
