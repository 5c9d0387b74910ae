//! Lie groups, cameras and images: the ground the other crates stand on.
//!
//! Frames follow one convention everywhere: camera x right, y down, z forward, pixel centres at
//! integers. A transform is named by what it does: `a_from_b * b_from_c = a_from_c`.

mod image;
mod pinhole;
mod pyramid;
mod se3;
mod sim3;
pub mod umeyama;

pub use image::{GrayImage, Image};
pub use pinhole::Pinhole;
pub use pyramid::Pyramid;
pub use se3::{Se3, hat};
pub use sim3::Sim3;
