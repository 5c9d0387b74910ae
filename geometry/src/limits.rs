//! The largest sizes of foreign data. Every reader of files and messages refuses more before it allocates memory.

/// Pixels of an image: 64 megapixels, several times what cameras of robots and telephones record. Grids of floats
/// over so many take a gigabyte.
pub const MAX_PIXELS: usize = 64_000_000;

/// Bytes of one record, message or image file: as many as an image of [`MAX_PIXELS`] has at the eight bytes of the
/// widest pixel (RGBA of 16 bits).
pub const MAX_BYTES: usize = 8 * MAX_PIXELS;

/// Points of a LiDAR's scan: some times what the densest send in a turn (128 rings of 4096).
pub const MAX_SCAN_POINTS: usize = 2_000_000;

/// Whether an image may have this size; the error says why not.
///
/// # Errors
/// When it has no pixels or too many.
pub fn check_image_size(width: usize, height: usize) -> Result<(), String> {
    match width.checked_mul(height) {
        Some(1..=MAX_PIXELS) => Ok(()),
        Some(0) => Err(format!("{width}×{height} pixels are no image")),
        _ => Err(format!(
            "{width}×{height} pixels are more than the {} million that an image may have",
            MAX_PIXELS / 1_000_000
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_bounded() {
        assert!(check_image_size(8000, 8000).is_ok() && check_image_size(1, MAX_PIXELS).is_ok());
        for (width, height) in [(0, 5), (5, 0), (8001, 8000), (usize::MAX, 2), (1 << 16, 1 << 16)] {
            assert!(check_image_size(width, height).is_err(), "{width}×{height}");
        }
    }
}
