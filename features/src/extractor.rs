//! Who finds features.

use crate::{Features, SiftParams, sift};
use geometry::GrayImage;

/// Finds and describes the features of images.
pub trait Extractor: Send + Sync {
    /// The features of an image, strongest first.
    ///
    /// # Errors
    /// When the image has none of the pixels that it needs, or the library behind it fails.
    fn extract(&self, image: &GrayImage) -> Result<Features, SiftError>;
}

/// No features could be found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SiftError {
    /// There is nothing to look at.
    #[error("an image of {width}×{height} pixels has no features: give one that has pixels")]
    Empty {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// OpenCV failed.
    #[cfg(feature = "opencv-sift")]
    #[error("OpenCV could not find SIFT features in an image of {width}×{height} pixels")]
    OpenCv {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// What OpenCV says.
        source: ::opencv::Error,
    },
}

/// SIFT in Rust alone.
#[derive(Clone, Debug, Default)]
pub struct Sift(pub SiftParams);

impl Extractor for Sift {
    fn extract(&self, image: &GrayImage) -> Result<Features, SiftError> {
        let (width, height) = (image.width(), image.height());
        if width == 0 || height == 0 {
            return Err(SiftError::Empty { width, height });
        }
        Ok(sift::detect(image, &self.0))
    }
}
