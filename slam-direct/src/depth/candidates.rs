//! Which pixels of a keyframe get a hypothesis: those with a strong gradient.

use super::DepthParams;
use geometry::GrayImage;

/// Candidates keep this distance from the image border, so that their template fits into the image, pixels.
pub(super) const BORDER: usize = 5;

/// Candidate pixels in memory order, structure of arrays.
#[derive(Clone, Debug, Default)]
pub(super) struct Candidates {
    /// Pixel index `y · width + x`, ascending.
    pub pixel: Vec<u32>,
    /// The same as `(x, y)`.
    pub position: Vec<[f32; 2]>,
    /// Central-difference gradient `(x, y)`, grey levels per pixel.
    pub gradient: Vec<[f32; 2]>,
}

/// Central-difference gradient, doubled, of pixel `x` of the middle row.
#[inline]
pub(crate) fn doubled_gradient(rows: [&[u8]; 3], x: usize) -> (i32, i32) {
    (rows[1][x + 1] as i32 - rows[1][x - 1] as i32, rows[2][x] as i32 - rows[0][x] as i32)
}

/// Selects the pixels whose gradient passes `params.min_gradient`, at most `params.max_candidate_share`
/// of the image: a threshold from the histogram of gradients keeps the strongest.
pub(super) fn select(image: &GrayImage, params: &DepthParams) -> Candidates {
    let (width, height) = (image.width(), image.height());
    if width <= 2 * BORDER || height <= 2 * BORDER {
        return Candidates::default();
    }
    let mut histogram = [0u32; 256];
    let mut magnitude = vec![0u8; width * height];
    for y in BORDER..height - BORDER {
        let rows = [image.row(y - 1), image.row(y), image.row(y + 1)];
        let out = &mut magnitude[y * width..(y + 1) * width];
        for (x, out) in (BORDER..width - BORDER).zip(&mut out[BORDER..]) {
            let (gx, gy) = doubled_gradient(rows, x);
            *out = ((gx * gx + gy * gy) as f32).sqrt().min(255.0) as u8;
        }
        out[BORDER..width - BORDER].iter().for_each(|&m| histogram[m as usize] += 1);
    }
    let threshold = threshold(&histogram, params, width * height);
    let count: u32 = histogram[threshold as usize..].iter().sum();
    let mut all = Candidates {
        pixel: Vec::with_capacity(count as usize),
        position: Vec::with_capacity(count as usize),
        gradient: Vec::with_capacity(count as usize),
    };
    for y in BORDER..height - BORDER {
        let rows = [image.row(y - 1), image.row(y), image.row(y + 1)];
        let row = &magnitude[y * width..(y + 1) * width];
        for (x, &magnitude) in (BORDER..width - BORDER).zip(&row[BORDER..]) {
            if magnitude >= threshold {
                let (gx, gy) = doubled_gradient(rows, x);
                all.pixel.push((y * width + x) as u32);
                all.position.push([x as f32, y as f32]);
                all.gradient.push([0.5 * gx as f32, 0.5 * gy as f32]);
            }
        }
    }
    all
}

/// The pixels of an image whose gradient is strong enough for a depth, as indices `y · width + x`, ascending.
pub fn candidate_pixels(image: &GrayImage, params: &DepthParams) -> Vec<u32> {
    select(image, params).pixel
}

/// The least doubled gradient of a candidate.
fn threshold(histogram: &[u32; 256], params: &DepthParams, pixels: usize) -> u8 {
    let least = (2.0 * params.min_gradient).clamp(1.0, 255.0) as usize;
    let most = (params.max_candidate_share.clamp(0.0, 1.0) * pixels as f32) as u32;
    let mut count = 0;
    for level in (least..256).rev() {
        count += histogram[level];
        if count > most {
            return (level + 1).min(255) as u8;
        }
    }
    least as u8
}
