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

geometry::multiversion! {
    /// Doubled magnitudes of the gradient along the middle of three rows, which are longer by a pixel at each end.
    fn magnitudes(rows: [&[u8]; 3], out: &mut [u8]) {
        for (x, out) in out.iter_mut().enumerate() {
            let (gx, gy) = doubled_gradient(rows, x + 1);
            *out = ((gx * gx + gy * gy) as f32).sqrt().min(255.0) as u8;
        }
    }
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
        let inner = BORDER..width - BORDER;
        let rows = [y - 1, y, y + 1].map(|y| &image.row(y)[inner.start - 1..inner.end + 1]);
        let out = &mut magnitude[y * width..(y + 1) * width][inner];
        magnitudes(rows, out);
        out.iter().for_each(|&m| histogram[m as usize] += 1);
    }
    let threshold = threshold(&histogram, params, width * height);
    let count: u32 = histogram[threshold as usize..].iter().sum();
    let mut candidates = Candidates::with_capacity(count as usize);
    // One place more than there are in a row: each pixel is put down, and the next one over it unless it is a candidate.
    let mut columns = vec![0; width + 1];
    for y in BORDER..height - BORDER {
        let mut found = 0;
        for (x, &magnitude) in (0..).zip(&magnitude[y * width..(y + 1) * width]) {
            columns[found] = x;
            found += usize::from(magnitude >= threshold);
        }
        let rows = [y - 1, y, y + 1].map(|y| image.row(y));
        candidates.extend(y, &columns[..found], rows);
    }
    candidates
}

impl Candidates {
    fn with_capacity(count: usize) -> Self {
        let (position, gradient) = (Vec::with_capacity(count), Vec::with_capacity(count));
        Self { pixel: Vec::with_capacity(count), position, gradient }
    }

    /// Leaves out the candidates whose positions do not count.
    pub fn retain(&mut self, counts: impl Fn([f32; 2]) -> bool) {
        let kept: Vec<usize> = (0..self.pixel.len()).filter(|&i| counts(self.position[i])).collect();
        self.pixel = kept.iter().map(|&i| self.pixel[i]).collect();
        self.gradient = kept.iter().map(|&i| self.gradient[i]).collect();
        self.position = kept.iter().map(|&i| self.position[i]).collect();
    }

    /// Adds pixels of row `y`, which is the middle one of three.
    fn extend(&mut self, y: usize, columns: &[u32], rows: [&[u8]; 3]) {
        let start = (y * rows[1].len()) as u32;
        self.pixel.extend(columns.iter().map(|x| start + x));
        self.position.extend(columns.iter().map(|&x| [x as f32, y as f32]));
        self.gradient.extend(columns.iter().map(|&x| {
            let (gx, gy) = doubled_gradient(rows, x as usize);
            [0.5 * gx as f32, 0.5 * gy as f32]
        }));
    }
}

/// The pixels of an image whose gradient is strong enough for a depth, as indices `y · width + x`, ascending.
pub fn candidate_pixels(image: &GrayImage, params: &DepthParams) -> Vec<u32> {
    select(image, params).pixel
}

/// A keyframe of which a smaller share of the edges has a depth says nothing for its pose: they were found at no place that agrees with
/// it. Of twenty recordings' maps that agree with a ground truth or with those from other first frames less than one keyframe in ten is
/// such, but where the camera only turned; of most wrong ones one in seven or more.
const HARDLY_ANY: f64 = 0.01;

/// Whether this number of depths is hardly any for the edges of an image.
pub fn has_hardly_any(image: &GrayImage, depths: usize) -> bool {
    let params = DepthParams::default();
    let is_less_than = |count: f64| (depths as f64) < HARDLY_ANY * count;
    // Most keyframes have so many that nobody needs to count the edges.
    is_less_than(f64::from(params.max_candidate_share) * image.data().len() as f64)
        && is_less_than(candidate_pixels(image, &params).len() as f64)
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
