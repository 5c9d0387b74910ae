//! Depth images: 16-bit grey, a fixed length a step, 0 where there is none.

use super::{decode_any, read_file};
use geometry::Image;
use image::DynamicImage;
use std::path::Path;

/// Reads a depth image as its 16-bit values.
///
/// # Errors
/// When it cannot be read, is cut short, or has no 16-bit grey values; the message names the file.
pub fn read_depth_image(path: &Path) -> Result<Image<u16>, String> {
    read_file(path, |bytes| decode(&bytes))
}

fn decode(bytes: &[u8]) -> Result<Image<u16>, String> {
    let DynamicImage::ImageLuma16(image) = decode_any(bytes, "PNG, PGM or TIFF")? else {
        return Err("is not a 16-bit grey image".into());
    };
    let (width, height) = (image.width() as usize, image.height() as usize);
    Image::from_vec(width, height, image.into_raw()).ok_or_else(|| "is cut short".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_and_what_is_no_depth_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let pixels = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(4, 3, |x, y| {
            image::Luma([1000 * x as u16 + y as u16])
        });
        pixels.save(&path).unwrap();
        let depth = read_depth_image(&path).unwrap();
        assert_eq!((depth.width(), depth.height(), depth.get(3, 2)), (4, 3, 3002));
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        assert!(read_depth_image(&path).unwrap_err().contains("depth.png"));
        image::GrayImage::new(4, 3).save(&path).unwrap();
        assert!(read_depth_image(&path).unwrap_err().contains("16-bit"));
        assert!(read_depth_image(&folder.path().join("none.png")).is_err());
    }
}
