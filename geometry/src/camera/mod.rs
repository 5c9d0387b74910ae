//! Real cameras: a pinhole behind a lens that bends.

mod fov;
mod kannala_brandt;
mod radtan;
mod roots;

pub use fov::Fov;
pub use kannala_brandt::KannalaBrandt;
pub use radtan::RadTan;

use crate::Pinhole;
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What the lens does to a ray before the pinhole's focal lengths and principal point apply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Distortion {
    /// An ideal pinhole.
    #[default]
    #[serde(rename = "pinhole")]
    None,
    /// Radial and tangential terms on the normalised plane (OpenCV's default model).
    #[serde(rename = "radtan")]
    RadTan(RadTan),
    /// Kannala–Brandt fisheye: an odd polynomial of the angle from the axis ("equidistant").
    #[serde(rename = "kb4")]
    KannalaBrandt(KannalaBrandt),
    /// Field-of-view model of one angle ("ATAN").
    #[serde(rename = "fov")]
    Fov(Fov),
}

impl Distortion {
    /// Whether rays pass unbent: no distortion, or one whose terms are all zero.
    pub fn is_identity(&self) -> bool {
        match self {
            Self::None => true,
            Self::RadTan(lens) => lens.terms().iter().all(|&term| term == 0.0),
            // Fisheye and field-of-view lenses bend even without terms.
            Self::KannalaBrandt(_) | Self::Fov(_) => false,
        }
    }
}

/// Why numbers do not describe a camera.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CameraError {
    /// A side of the image is shorter than two pixels.
    #[error("the image size {width}×{height} is not usable: both sides must be at least 2 pixels")]
    Size {
        /// Image width, pixels.
        width: usize,
        /// Image height, pixels.
        height: usize,
    },
    /// A focal length is not a positive number.
    #[error("the focal length {name} = {value} must be a positive number of pixels")]
    Focal {
        /// `fx` or `fy`.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// The principal point is not a number or lies outside the image.
    #[error("the principal point {name} = {value} lies outside the image (0 to {limit})")]
    PrincipalPoint {
        /// `cx` or `cy`.
        name: &'static str,
        /// What was given.
        value: f64,
        /// Largest pixel coordinate of the image.
        limit: f64,
    },
    /// A distortion has a number of terms that its model does not know.
    #[error("{model} takes {expected} distortion terms, not {found}")]
    TermCount {
        /// Name of the model.
        model: &'static str,
        /// The counts it takes.
        expected: &'static str,
        /// What was given.
        found: usize,
    },
    /// A distortion term is not finite, or outside its model's range.
    #[error("distortion term {index} of {model} is {value}: {expected}")]
    Term {
        /// Name of the model.
        model: &'static str,
        /// Index of the term, from 0.
        index: usize,
        /// What was given.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
}

/// Bound on distorted coordinates of the normalised plane, far beyond any lens.
const MAX_PLANE_RADIUS: f64 = 1e6;

/// A camera as it is calibrated: image size, focal lengths, principal point and distortion.
///
/// Lengths in pixels, pixel centres at integers; camera x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "CameraParts", into = "CameraParts")]
pub struct Camera {
    intrinsics: Pinhole,
    distortion: Distortion,
}

#[derive(Serialize, Deserialize)]
struct CameraParts {
    intrinsics: Pinhole,
    distortion: Distortion,
}

impl From<Camera> for CameraParts {
    fn from(camera: Camera) -> Self {
        Self { intrinsics: camera.intrinsics, distortion: camera.distortion }
    }
}

impl TryFrom<CameraParts> for Camera {
    type Error = CameraError;
    fn try_from(parts: CameraParts) -> Result<Self, CameraError> {
        Self::new(parts.intrinsics, parts.distortion)
    }
}

impl Camera {
    /// A camera from its parts.
    ///
    /// # Errors
    /// When the image is smaller than 2×2, a focal length is not positive, or the principal point
    /// lies outside the image.
    pub fn new(intrinsics: Pinhole, distortion: Distortion) -> Result<Self, CameraError> {
        check_size_and_focal(&intrinsics)?;
        let Pinhole { width, height, cx, cy, .. } = intrinsics;
        for (name, value, side) in [("cx", cx, width), ("cy", cy, height)] {
            let limit = side as f64 - 1.0;
            if !(0.0..=limit).contains(&value) {
                return Err(CameraError::PrincipalPoint { name, value, limit });
            }
        }
        Ok(Self { intrinsics, distortion })
    }

    /// Image size, focal lengths and principal point.
    pub fn intrinsics(&self) -> &Pinhole {
        &self.intrinsics
    }

    /// What the lens does.
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// Whether a pixel lies in the image, where intensities can be interpolated.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        let (right, bottom) = (self.intrinsics.width as f64 - 1.0, self.intrinsics.height as f64 - 1.0);
        (0.0..=right).contains(&pixel.x) && (0.0..=bottom).contains(&pixel.y)
    }

    /// Projects a point of the camera frame to pixels, possibly outside the image.
    ///
    /// `None` where the model has no meaning: behind the camera (a fisheye sees some of that), or
    /// beyond the radius to which the distortion is one-to-one.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_with_jacobian(point).map(|(pixel, _)| pixel)
    }

    /// As [`project`](Self::project), with the derivative of the pixel by the point (2×3, pixels per unit).
    pub fn project_with_jacobian(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let (bent, bent_by_point) = match &self.distortion {
            Distortion::None => through_plane(point, |plane| Some((plane, Matrix2::identity()))),
            Distortion::RadTan(lens) => through_plane(point, |plane| lens.distort(&plane)),
            Distortion::Fov(lens) => through_plane(point, |plane| Some(lens.distort(&plane))),
            Distortion::KannalaBrandt(lens) => lens.distort(point),
        }?;
        let Pinhole { fx, fy, cx, cy, .. } = self.intrinsics;
        let pixel = Vector2::new(fx * bent.x + cx, fy * bent.y + cy);
        let finite = pixel.x.is_finite() && pixel.y.is_finite();
        finite.then(|| (pixel, Matrix2::from_diagonal(&Vector2::new(fx, fy)) * bent_by_point))
    }

    /// The ray through a pixel, of unit length.
    ///
    /// `None` where no ray projects to the pixel: outside the image of the range in which the
    /// distortion is one-to-one, or for a pixel that is not finite.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let Pinhole { fx, fy, cx, cy, .. } = self.intrinsics;
        let bent = Vector2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy);
        // Farther out (or NaN) a ray could not be told from one across the axis.
        let in_range = bent.norm_squared() < MAX_PLANE_RADIUS * MAX_PLANE_RADIUS;
        if !in_range {
            return None;
        }
        match &self.distortion {
            Distortion::None => Some(bent),
            Distortion::RadTan(lens) => lens.undistort(&bent),
            Distortion::Fov(lens) => lens.undistort(&bent),
            Distortion::KannalaBrandt(lens) => return lens.undistort(&bent),
        }
        .map(|plane| plane.push(1.0).normalize())
    }
}

/// Refuses sizes and focal lengths that no image can have.
pub(crate) fn check_size_and_focal(pinhole: &Pinhole) -> Result<(), CameraError> {
    let Pinhole { width, height, fx, fy, .. } = *pinhole;
    if width < 2 || height < 2 {
        return Err(CameraError::Size { width, height });
    }
    for (name, value) in [("fx", fx), ("fy", fy)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(CameraError::Focal { name, value });
        }
    }
    Ok(())
}

/// Refuses a term that is not finite, or so large that polynomials of it would not be.
fn check_terms(model: &'static str, terms: &[f64]) -> Result<(), CameraError> {
    /// Far beyond the terms of any lens.
    const LARGEST: f64 = 1e12;
    // False for NaN as well.
    match terms.iter().position(|term| !matches!(term.abs(), 0.0..=LARGEST)) {
        None => Ok(()),
        Some(index) => {
            let expected = "it must be a finite number of at most 1e12";
            Err(CameraError::Term { model, index, value: terms[index], expected })
        }
    }
}

/// Divides by depth, then applies a distortion of the normalised plane; chains the derivatives.
fn through_plane(
    point: &Vector3<f64>,
    distort: impl FnOnce(Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)>,
) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    // False for NaN as well.
    let in_front = point.z > 0.0;
    if !in_front {
        return None;
    }
    let iz = 1.0 / point.z;
    let plane = point.xy() * iz;
    let plane_by_point = Matrix2x3::new(iz, 0.0, -plane.x * iz, 0.0, iz, -plane.y * iz);
    let (bent, bent_by_plane) = distort(plane)?;
    Some((bent, bent_by_plane * plane_by_point))
}

#[cfg(test)]
mod tests;
