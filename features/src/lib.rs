//! Local features of a keyframe: key points with SIFT descriptors (Lowe 2004), for recognising places and for
//! matching two keyframes.

pub mod codec;
mod extractor;
mod numbers;
#[cfg(feature = "opencv-sift")]
mod opencv;
mod params;
mod sift;
#[cfg(test)]
mod tests;

pub use extractor::{Extractor, Sift, SiftError};
#[cfg(feature = "opencv-sift")]
pub use opencv::OpenCvSift;
pub use params::SiftParams;

use geometry::GrayImage;

/// Finds and describes the features of an image, strongest first.
///
/// # Errors
/// When the image has no pixels.
pub fn sift(image: &GrayImage, params: &SiftParams) -> Result<Features, SiftError> {
    Sift(params.clone()).extract(image)
}

/// A RootSIFT descriptor (Arandjelović & Zisserman 2012): the square roots of the SIFT histogram after it was
/// normalised to a sum of one, times 256. Euclidean distance between two is the Hellinger distance of the
/// histograms; all have a length of about 256.
pub type Descriptor = [u8; 128];

/// Where a feature was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Position, pixels of the keyframe's image, centres at integers.
    pub pixel: [f32; 2],
    /// Diameter of the described patch, pixels.
    pub size: f32,
    /// Orientation, radians from x towards y.
    pub angle: f32,
}

/// The features of one image; both vectors have one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Where they are.
    pub keypoints: Vec<Keypoint>,
    /// What they look like.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }
}

/// Squared Euclidean distance of two descriptors.
#[inline]
pub fn squared_distance(a: &Descriptor, b: &Descriptor) -> u32 {
    // Eight sums at a time, of differences in 16 bits, which processors multiply and add in one step: twice as fast as
    // one by one.
    let mut sums = [0; 8];
    for (a, b) in a.as_chunks::<8>().0.iter().zip(b.as_chunks::<8>().0) {
        for ((sum, &a), &b) in sums.iter_mut().zip(a).zip(b) {
            *sum += i32::from(i16::from(a) - i16::from(b)).pow(2);
        }
    }
    sums.iter().sum::<i32>() as u32
}
