//! Why views do not make a calibration.

use super::Estimate;
use thiserror::Error;

/// Why views do not make a calibration; each message says how to mend it, after a line break.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Refusal {
    /// Too few views show enough of the board.
    #[error(
        "{usable} of {given} images show enough of the board, {needed} are needed\nhint: take 15 to 30 sharp images \
         with the board near, far, in every corner of the image and tilted each way"
    )]
    TooFewViews {
        /// Views with enough corners.
        usable: usize,
        /// Views given.
        given: usize,
        /// Fewest views.
        needed: usize,
    },
    /// A view names a corner that the board has not.
    #[error("{view}: corner {index} is not on the board, which has {count}\nhint: check --board")]
    NoSuchCorner {
        /// Name of the image.
        view: String,
        /// Number of the corner.
        index: usize,
        /// Corners of the board.
        count: usize,
    },
    /// A calibration that is to be checked has terms that no model has.
    #[error(
        "the calibration has the terms k4 k5 k6, which cannot be checked\nhint: give one with at most k1 k2 p1 p2 k3, or of \
         another model"
    )]
    NoSuchModel,
    /// No focal length makes sense of the views.
    #[error(
        "no camera explains the corners that were found\nhint: check --board (its columns, rows and, for an aprilgrid, \
         spacing) and --model, and that all images are from one camera at one zoom"
    )]
    NoStart,
    /// The board was always seen from the same direction, so that the focal length is not determined.
    #[error(
        "the focal length is not determined (fx = {:.0} ± {:.0}): the board was seen from one direction only, all tilts lie \
         within {spread:.0}°\nhint: add images with the board tilted by 20° to 45° to the left, the right, up and down",
        .fx.value, .fx.sigma
    )]
    OneDirection {
        /// Largest angle between two directions of the board, degrees.
        spread: f64,
        /// The focal length.
        fx: Estimate,
    },
    /// A parameter is too uncertain.
    #[error(
        "{} is not determined well enough: {:.2} ± {:.2}\nhint: add images, with the board larger in the image, tilted by 20° \
         to 45° each way and in every corner of the image",
        .0.name, .0.value, .0.sigma
    )]
    NotDetermined(Estimate),
    /// The equations have no single solution.
    #[error(
        "the views do not determine the camera: all tilts of the board lie within {spread:.0}°\nhint: add images with the \
         board tilted by 20° to 45° to the left, the right, up and down, and in every corner of the image"
    )]
    Singular {
        /// Largest angle between two directions of the board, degrees.
        spread: f64,
    },
    /// The residuals are far beyond what finding corners leaves.
    #[error(
        "the corners do not fit the board and the model: rms {rms:.1} px after adjustment\nhint: check --board (for an \
         aprilgrid its spacing), try another --model (kb4 for wide lenses), and make sure that the board is flat"
    )]
    PoorFit {
        /// Root mean square residual, pixels.
        rms: f64,
    },
    /// Most views do not fit together.
    #[error(
        "only {kept} of {usable} images fit one camera\nhint: check --board, and that all images are from one camera at one \
         zoom and focus"
    )]
    FewFit {
        /// Views that fit.
        kept: usize,
        /// Views with enough corners.
        usable: usize,
    },
}
