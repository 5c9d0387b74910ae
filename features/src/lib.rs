//! Local features of a keyframe: key points with SIFT descriptors (Lowe 2004), for recognising places and for
//! matching two keyframes.
//!
//! [`sift()`] finds them, with nothing but Rust; as an [`Extractor`], `OpenCvSift` does by the system's OpenCV where the
//! feature `opencv-sift` is on. Their features match each other. [`codec`] writes features as few bytes. To read in
//! this order: this page, `extractor`, `sift`, `codec`.
//!
//! **Why our own is the default.** Measured by the example `compare` at the default parameters: matches within 3 pixels
//! of the true epipolar line, mean of the pairs; time of one image on one core.
//!
//! | pairs | OpenCV 4.6 | loopbox | one of either | time, ms: OpenCV, loopbox |
//! |---|---|---|---|---|
//! | 26 of tum_fr1_xyz, 20 frames apart | 100.5 | 94.1 | 95.7 | 24, 10 |
//! | 24 of tum_fr1_desk, 15 apart | 57.1 | 54.5 | 55.2 | 22, 9 |
//! | 25 of kitti00_first201, 4 apart | 200.0 | 197.4 | 194.6 | 40, 18 |
//! | 29 of kitti09_first350, 4 apart | 104.7 | 104.1 | 101.5 | 29, 11 |
//! | 40 of tum_fr1_xyz and tum_fr1_desk | 57.0 | 57.3 | 56.6 | 19, 6 |
//! | 30 of parking_a and parking_b | 124.5 | 140.9 | 129.5 | 24, 8 |
//! | 37 of parking_a and parking_c | 68.4 | 72.1 | 68.1 | 24, 8 |
//! | 18 of parking_b and parking_c | 65.9 | 86.2 | 71.9 | 24, 8 |

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
