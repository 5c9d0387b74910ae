//! Key images with their inverse depth, spread over the run.

use super::cloud::evenly;
use super::pack::Packed;
use anyhow::Context;
use geometry::GrayImage;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use map::Keyframe;
use serde::Serialize;

/// Most pictures in a report.
pub const MAX_PICTURES: usize = 24;
/// Most pixels of a picture; larger images are shrunk by a whole factor.
const MAX_PIXELS: usize = 520_000;
/// Most depths drawn over a picture; two bytes each.
const MAX_DEPTHS: usize = 80_000;
/// Most bytes of a picture; the quality falls until it fits.
const MAX_BYTES: usize = 130_000;
/// JPEG qualities, tried in turn.
const QUALITIES: [u8; 5] = [85, 70, 50, 25, 10];

/// A key image.
#[derive(Serialize)]
pub struct Picture {
    /// Index of the keyframe in the scene.
    keyframe: usize,
    width: usize,
    height: usize,
    /// The image, in colour where the keyframe has colours.
    jpeg: Packed,
    /// The depths in memory order, as pairs of bytes: pixels to go on, colour 1–255. Colour 0 only goes on.
    depth: Packed,
}

/// Pictures of at most [`MAX_PICTURES`] keyframes; `inverse_depth` is the world range that the colours span.
pub fn pictures(keyframes: &[&Keyframe], inverse_depth: [f32; 2]) -> anyhow::Result<Vec<Picture>> {
    let drawable = |k: &&Keyframe| k.image.width() > 0 && k.image.height() > 0;
    let indices: Vec<usize> = (0..keyframes.len()).filter(|&i| drawable(&keyframes[i])).collect();
    spread(&indices, MAX_PICTURES).into_iter().map(|i| picture(i, keyframes[i], inverse_depth)).collect()
}

/// At most `count` of the items, the first and the last among them.
fn spread(items: &[usize], count: usize) -> Vec<usize> {
    if items.len() <= count {
        return items.to_vec();
    }
    (0..count).map(|i| items[i * (items.len() - 1) / (count - 1)]).collect()
}

fn picture(index: usize, keyframe: &Keyframe, inverse_depth: [f32; 2]) -> anyhow::Result<Picture> {
    let Shrunk { factor, width, height, jpeg } = shrunk_jpeg(keyframe, MAX_PIXELS, MAX_BYTES)?;
    let depth = depth_pairs(keyframe, factor, width, height, inverse_depth);
    Ok(Picture { keyframe: index, width, height, jpeg, depth })
}

/// A keyframe's image, made smaller for a page.
pub struct Shrunk {
    /// Pixels of the image that make one here, in either direction.
    pub factor: usize,
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// The image, in colour where the keyframe has colours.
    pub jpeg: Packed,
}

/// A keyframe's image shrunk by a whole factor to at most `max_pixels`, as JPEG of at most `max_bytes` where the
/// worst quality allows.
///
/// # Errors
/// When it cannot be encoded; the message names the keyframe.
pub fn shrunk_jpeg(keyframe: &Keyframe, max_pixels: usize, max_bytes: usize) -> anyhow::Result<Shrunk> {
    let factor = shrink_factor(&keyframe.image, max_pixels);
    let image = shrunk(&keyframe.image, factor);
    let jpeg = match keyframe.colors() {
        Some(colors) => {
            let planes = colors.planes(keyframe.image.width(), keyframe.image.height());
            let painted = colors.painted(&image, &planes.map(|plane| shrunk(&plane, factor)));
            encode_pixels((&painted, ExtendedColorType::Rgb8), (image.width(), image.height()), max_bytes)
        }
        None => encode(&image, max_bytes),
    };
    let jpeg =
        jpeg.with_context(|| format!("the image of keyframe {} cannot be written as JPEG", keyframe.id.0))?;
    Ok(Shrunk { factor, width: image.width(), height: image.height(), jpeg: Packed(jpeg) })
}

/// The smallest whole factor that brings an image to at most `max_pixels`.
fn shrink_factor(image: &GrayImage, max_pixels: usize) -> usize {
    let fits = |k: usize| (image.width() / k).max(1) * (image.height() / k).max(1) <= max_pixels;
    let longer = image.width().max(image.height());
    (1..=longer).find(|&k| fits(k)).unwrap_or(longer)
}

/// The image with blocks of `factor × factor` pixels averaged; what is left over at the far edges goes.
fn shrunk(image: &GrayImage, factor: usize) -> GrayImage {
    if factor == 1 {
        return image.clone();
    }
    let (width, height) = ((image.width() / factor).max(1), (image.height() / factor).max(1));
    let mut small = GrayImage::filled(width, height, 0);
    for y in 0..height {
        for x in 0..width {
            let rows = y * factor..((y + 1) * factor).min(image.height());
            let columns = x * factor..((x + 1) * factor).min(image.width());
            let count = (rows.len() * columns.len()).max(1);
            let sum: usize = rows.flat_map(|y| &image.row(y)[columns.clone()]).map(|&v| v as usize).sum();
            small.set(x, y, (sum / count) as u8);
        }
    }
    small
}

/// The image as JPEG, of the best quality that fits `max_bytes`, or else the worst there is.
pub fn encode(image: &GrayImage, max_bytes: usize) -> image::ImageResult<Vec<u8>> {
    encode_pixels((image.data(), ExtendedColorType::L8), (image.width(), image.height()), max_bytes)
}

/// The same of pixels of some kind.
fn encode_pixels(
    (pixels, kind): (&[u8], ExtendedColorType),
    (width, height): (usize, usize),
    max_bytes: usize,
) -> image::ImageResult<Vec<u8>> {
    let mut jpeg = Vec::new();
    for quality in QUALITIES {
        jpeg.clear();
        let encoder = JpegEncoder::new_with_quality(&mut jpeg, quality);
        encoder.write_image(pixels, width as u32, height as u32, kind)?;
        if jpeg.len() <= max_bytes {
            break;
        }
    }
    Ok(jpeg)
}

/// The depths of a keyframe on its shrunk picture.
fn depth_pairs(keyframe: &Keyframe, factor: usize, width: usize, height: usize, range: [f32; 2]) -> Packed {
    let full_width = keyframe.image.width();
    let scale = keyframe.world_from_keyframe.scale as f32;
    let mut depths: Vec<(usize, u8)> = keyframe
        .semi_dense
        .iter()
        .filter(|(_, d, _)| d.is_finite() && *d > 0.0)
        .filter_map(|(pixel, d, _)| {
            let (x, y) = (pixel as usize % full_width / factor, pixel as usize / full_width / factor);
            let t = (d / scale - range[0]) / (range[1] - range[0]);
            let colour = 1 + (t.clamp(0.0, 1.0) * 254.0).round() as u8;
            (x < width && y < height).then_some((y * width + x, colour))
        })
        .collect();
    depths.sort_by_key(|&(pixel, _)| pixel);
    depths.dedup_by_key(|&mut (pixel, _)| pixel);
    evenly(&mut depths, MAX_DEPTHS);
    Packed(pairs(&depths))
}

/// `(steps, colour)` byte pairs that visit ascending pixels from pixel 0 on.
fn pairs(depths: &[(usize, u8)]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(depths.len() * 2);
    let mut at = 0;
    for &(pixel, colour) in depths {
        while pixel - at > 255 {
            bytes.extend([255, 0]);
            at += 255;
        }
        bytes.extend([(pixel - at) as u8, colour]);
        at = pixel;
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_spread_from_first_to_last() {
        let items: Vec<usize> = (0..100).collect();
        let chosen = spread(&items, 24);
        assert_eq!((chosen.len(), chosen[0], chosen[23]), (24, 0, 99));
        assert!(chosen.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(spread(&items[..3], 24), [0, 1, 2]);
    }

    #[test]
    fn pairs_lead_back_to_the_pixels() {
        let depths = [(0, 1), (1, 9), (256, 3), (1000, 255)];
        let (mut at, mut found) = (0, Vec::new());
        for pair in pairs(&depths).chunks(2) {
            at += pair[0] as usize;
            if pair[1] > 0 {
                found.push((at, pair[1]));
            }
        }
        assert_eq!(found, depths);
    }

    #[test]
    fn noise_fits_the_size_and_large_images_shrink() {
        let mut random = geometry::Random::new(1);
        let noise = (0..1920 * 1080).map(|_| random.bits() as u8);
        let image = GrayImage::from_vec(1920, 1080, noise.collect()).unwrap();
        let factor = shrink_factor(&image, MAX_PIXELS);
        assert_eq!(factor, 2);
        let small = shrunk(&image, factor);
        assert_eq!((small.width(), small.height()), (960, 540));
        assert!(encode(&small, MAX_BYTES).unwrap().len() <= MAX_BYTES);
    }

    #[test]
    fn shrinking_averages() {
        let image = GrayImage::from_vec(4, 2, vec![0, 4, 10, 10, 8, 4, 10, 10]).unwrap();
        assert_eq!(shrunk(&image, 2).data(), [4, 10]);
    }
}
