//! The errors of an agent.

use super::Agent;
use backend::ParameterError;
use geometry::{GrayImage, Pinhole};
use thiserror::Error;

/// Why an agent cannot be made, or a frame not be processed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AgentError {
    /// A parameter cannot be worked with.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The camera cannot be worked with.
    #[error(
        "a camera of {width}×{height} pixels with focal lengths {fx} and {fy} cannot be worked with: \
         each side must have {MIN_SIDE} pixels at least and the focal lengths be positive; calibrate it anew"
    )]
    Camera {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
        /// Focal length in x, pixels.
        fx: f64,
        /// Focal length in y, pixels.
        fy: f64,
    },
    /// A map from an earlier run cannot be resumed.
    #[error("the map cannot be gone on with: {0}")]
    Map(String),
    /// A mask is not of the size of the camera.
    #[error(
        "the mask has {} × {} pixels, the camera {} × {}: undistort or scale it as the images are",
        mask.0, mask.1, camera.0, camera.1
    )]
    MaskSize {
        /// Width and height of the mask, pixels.
        mask: (usize, usize),
        /// Those of the camera.
        camera: (usize, usize),
    },
    /// An image is not of the size of the camera.
    #[error(
        "frame {index} has {} × {} pixels, the camera {} × {}: undistort or scale it to the camera",
        image.0, image.1, camera.0, camera.1
    )]
    Size {
        /// Index of the frame.
        index: u64,
        /// Width and height of its image, pixels.
        image: (usize, usize),
        /// Those of the camera.
        camera: (usize, usize),
    },
}

/// Least side of an image, pixels: patches and their margins must fit in.
const MIN_SIDE: usize = 32;

/// Refuses a camera that would lead to a division by zero or an index out of bounds.
pub(super) fn check_camera(camera: &Pinhole) -> Result<(), AgentError> {
    let Pinhole { width, height, fx, fy, cx, cy } = *camera;
    let is_good = width.min(height) >= MIN_SIDE
        && fx > 0.0
        && fy > 0.0
        && [fx, fy, cx, cy].iter().all(|v| v.is_finite());
    if is_good { Ok(()) } else { Err(AgentError::Camera { width, height, fx, fy }) }
}

impl Agent {
    /// Refuses an image that is not of the camera's size.
    pub(super) fn check_size(&self, index: u64, image: &GrayImage) -> Result<(), AgentError> {
        let image = (image.width(), image.height());
        let camera = (self.camera.width, self.camera.height);
        if image == camera { Ok(()) } else { Err(AgentError::Size { index, image, camera }) }
    }
}
