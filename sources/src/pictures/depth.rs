//! Depth images: 16-bit grey, a fixed length a step, 0 where there is none.

use geometry::Image;
use geometry::limits::{MAX_BYTES, check_image_size};
use image::DynamicImage;
use std::io::Cursor;
use std::path::Path;

/// Reads a depth image as its 16-bit values.
///
/// # Errors
/// When it cannot be read, is cut short, or has no 16-bit grey values; the message names the file.
pub fn read_depth_image(path: &Path) -> Result<Image<u16>, String> {
    let of_file = |what: String| format!("{}: {what}", path.display());
    let about = std::fs::metadata(path).map_err(|e| of_file(e.to_string()))?;
    if about.len() > MAX_BYTES as u64 {
        return Err(of_file(format!("{} bytes are no image", about.len())));
    }
    let bytes = std::fs::read(path).map_err(|e| of_file(e.to_string()))?;
    decode(&bytes).map_err(of_file)
}

fn decode(bytes: &[u8]) -> Result<Image<u16>, String> {
    let format = image::guess_format(bytes).map_err(|_| "not a PNG, PGM or TIFF image".to_owned())?;
    let reader = || image::ImageReader::with_format(Cursor::new(bytes), format);
    let (width, height) = reader().into_dimensions().map_err(|e| e.to_string())?;
    check_image_size(width as usize, height as usize)?;
    let DynamicImage::ImageLuma16(image) = reader().decode().map_err(|e| e.to_string())? else {
        return Err("is not a 16-bit grey image".into());
    };
    Image::from_vec(width as usize, height as usize, image.into_raw()).ok_or_else(|| "is cut short".into())
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
