//! Place recognition: finds the keyframes that show the same place as an image.

pub mod features;
mod thumbnail;

pub use thumbnail::{ThumbnailIndex, ThumbnailParams};
