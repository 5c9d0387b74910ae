//! Lie groups, cameras and images: the base of the other crates.
//!
//! Frames follow one convention everywhere: camera x right, y down, z forward, pixel centres at
//! integers. A transform is named by what it does: `a_from_b * b_from_c = a_from_c`.

mod buffer;
mod camera;
mod image;
pub mod lanes;
pub mod limits;
mod multiversion;
mod photometric;
mod pinhole;
pub mod pnp;
pub mod pose_alignment;
mod pyramid;
mod random;
mod sampler;
mod se3;
pub mod sensor;
mod sim3;
mod statistics;
pub mod umeyama;
mod undistort;

pub use buffer::{Buffer, Swap, Swapped};
pub use camera::{Camera, CameraError, Distortion, Fov, KannalaBrandt, RadTan};
pub use image::{GrayImage, Image};
pub use photometric::{PhotometricCalibration, PhotometricError};
pub use pinhole::Pinhole;
pub use pyramid::{Pyramid, halved};
pub use random::Random;
pub use sampler::{Sampler, samples_needed};
pub use se3::{Se3, hat};
pub use sim3::Sim3;
pub use statistics::median;
pub use undistort::{Crop, ImageSizeError, Undistorter};

#[cfg(test)]
mod lie_tests;
