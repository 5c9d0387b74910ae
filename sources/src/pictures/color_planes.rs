//! The colours of a picture as two planes.

use geometry::GrayImage;
use map::Luma;

/// The differences of blue and of red from the grey level, as [`Luma::differences`] stores them; a plane each, of the
/// picture's size.
pub type ColorPlanes = (Luma, [GrayImage; 2]);

/// The two planes of pixels that have a pair of values each.
pub(super) fn two_planes(
    width: usize,
    height: usize,
    pixels: impl Iterator<Item = [u8; 2]>,
) -> Option<[GrayImage; 2]> {
    let [mut blue, mut red] = [0, 1].map(|_| Vec::with_capacity(width * height));
    for [of_blue, of_red] in pixels {
        blue.push(of_blue);
        red.push(of_red);
    }
    Some([GrayImage::from_vec(width, height, blue)?, GrayImage::from_vec(width, height, red)?])
}
