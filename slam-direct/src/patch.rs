//! Aligning one small patch of a keyframe in another image.
//!
//! The template is cut out of the host keyframe as the other camera would see it (an affine warp for a patch that
//! faces the host). Then it is moved over the image until the photometric error is least: inverse compositional
//! Lucas–Kanade (Baker & Matthews 2004) with a gain and an offset per patch. The Hessian of that error at its minimum
//! is the information of the patch's position, and goes to the window optimisation as the information of the
//! observation.

use crate::warp::Warp;
use geometry::lanes::{LANES, Lanes, Processor};
use geometry::{GrayImage, Pyramid};

/// Patches are `SIZE × SIZE` pixels.
pub(crate) const SIZE: usize = LANES;
const AREA: usize = SIZE * SIZE;
/// Offset of the first pixel from the patch's centre.
const FIRST: f32 = -(SIZE as f32 - 1.0) / 2.0;
/// Side of the sampled square: the patch and a rim for central differences.
const RIM: usize = SIZE + 2;

/// What a host patch looks like in the view it is looked for in.
pub(crate) struct Appearance {
    /// Intensities less their mean.
    intensity: [f32; AREA],
    mean: f32,
    /// Sum of their squares.
    square: f32,
    /// Level of the searched pyramid that matches the patch's resolution.
    pub level: usize,
}

/// A host patch warped to the view it is looked for in, with what aligning it takes.
pub(crate) struct Template {
    appearance: Appearance,
    gradient_x: [f32; AREA],
    gradient_y: [f32; AREA],
    moments: Moments,
}

/// Central second moments of the template `T` and its gradient, summed over the patch.
struct Moments {
    tx: f32,
    ty: f32,
    /// Sums of the gradient.
    x: f32,
    y: f32,
    /// Hessian of position once gain and offset are eliminated: xx, xy, yy.
    position: [f32; 3],
}

/// Where a template was found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchMatch {
    /// Position at level 0 of the searched image.
    pub pixel: [f32; 2],
    /// Inverse covariance `[xx, xy, yy]` of the position in 1/px² of level 0 for intensity noise of one
    /// grey level.
    pub information: [f32; 3],
    /// Root mean square intensity residual after gain and offset are fitted.
    pub rmse: f32,
    /// Share of the image patch's variance that the match leaves unexplained: 0 is perfect, 1 no match.
    pub unexplained: f32,
}

geometry::multiversion! {
    /// Intensities of `host` around `pixel` (level 0) as a view related by `warp` shows them; `None` when the patch with
    /// its rim leaves the image.
    fn patch(host: &Pyramid, pixel: [f32; 2], warp: &Warp) -> Option<[[f32; SIZE]; SIZE]> {
        sampled(host, pixel, warp)
    }
}

geometry::multiversion! {
    /// As [`patch`], with the rim.
    fn patch_with_rim(host: &Pyramid, pixel: [f32; 2], warp: &Warp) -> Option<[[f32; RIM]; RIM]> {
        sampled(host, pixel, warp)
    }
}

/// A square of samples in the middle of the patch and its rim.
#[inline(always)]
fn sampled<const SIDE: usize>(host: &Pyramid, pixel: [f32; 2], warp: &Warp) -> Option<[[f32; SIDE]; SIDE]> {
    let host_level = warp.host_level.min(host.len() - 1);
    let image = host.level(host_level);
    let down = 1.0 / (1u32 << host_level) as f32;
    let up = (1u32 << warp.view_level) as f32;
    // Steps in the host level for one pixel right / down in the view level.
    let m = warp.host_from_view.map(|v| v * up * down);
    let (cx, cy) = ((pixel[0] + 0.5) * down - 0.5, (pixel[1] + 0.5) * down - 0.5);
    let reach = FIRST.abs() + 1.0;
    let (rx, ry) = (reach * (m[0].abs() + m[1].abs()), reach * (m[2].abs() + m[3].abs()));
    if !(image.contains(cx - rx, cy - ry, 0.0) && image.contains(cx + rx, cy + ry, 0.0)) {
        return None;
    }
    let first = -(SIDE as f32 - 1.0) / 2.0;
    let (mut xs, mut ys) = ([[0.0f32; SIDE]; SIDE], [[0.0f32; SIDE]; SIDE]);
    for j in 0..SIDE {
        let dy = first + j as f32;
        for i in 0..SIDE {
            let dx = first + i as f32;
            (xs[j][i], ys[j][i]) = (cx + m[0] * dx + m[1] * dy, cy + m[2] * dx + m[3] * dy);
        }
    }
    let mut samples = [[0.0f32; SIDE]; SIDE];
    // SAFETY: the corners of a larger square lie in the image.
    unsafe { bilinear(image, xs.as_flattened(), ys.as_flattened(), samples.as_flattened_mut()) };
    Some(samples)
}

/// [`GrayImage::bilinear`] at as many places, in steps in which the processor can work on several side by side.
///
/// # Safety
/// All places must be finite, and lie in the image but for rounding.
#[inline(always)]
unsafe fn bilinear(image: &GrayImage, xs: &[f32], ys: &[f32], samples: &mut [f32]) {
    const MOST: usize = RIM * RIM;
    let count = samples.len().min(MOST);
    let (width, data) = (image.width(), image.data());
    let last = [width as i32 - 2, image.height() as i32 - 2];
    let mut first = [0i32; MOST];
    let (mut dx, mut dy) = ([0.0f32; MOST], [0.0f32; MOST]);
    for i in 0..count {
        // SAFETY: places in an image are finite and small.
        let at = unsafe { [xs[i].to_int_unchecked::<i32>(), ys[i].to_int_unchecked::<i32>()] };
        let (x, y) = (at[0].min(last[0]), at[1].min(last[1]));
        first[i] = y * width as i32 + x;
        (dx[i], dy[i]) = (xs[i] - x as f32, ys[i] - y as f32);
    }
    let mut corners = [[0u8; MOST]; 4];
    for (i, &first) in first[..count].iter().enumerate() {
        let first = first as usize;
        let (top, bottom) = (&data[first..first + 2], &data[first + width..first + width + 2]);
        (corners[0][i], corners[1][i]) = (top[0], top[1]);
        (corners[2][i], corners[3][i]) = (bottom[0], bottom[1]);
    }
    for i in 0..count {
        let [a, b, c, d] = [0, 1, 2, 3].map(|corner: usize| f32::from(corners[corner][i]));
        let (top, bottom) = (a + dx[i] * (b - a), c + dx[i] * (d - c));
        samples[i] = top + dy[i] * (bottom - top);
    }
}

impl Appearance {
    /// How the patch around `pixel` (level 0 of `host`) looks in a view related by `warp`. `None` when it leaves the host
    /// image.
    pub fn cut(host: &Pyramid, pixel: [f32; 2], warp: &Warp) -> Option<Self> {
        Some(Self::new(patch(host, pixel, warp)?, warp.view_level))
    }

    fn new(samples: [[f32; SIZE]; SIZE], level: usize) -> Self {
        let mut intensity: [f32; AREA] = std::array::from_fn(|p| samples[p / SIZE][p % SIZE]);
        let mean = intensity.iter().sum::<f32>() / AREA as f32;
        for v in &mut intensity {
            *v -= mean;
        }
        Self { intensity, mean, square: dot(&intensity, &intensity), level }
    }

    /// Share of the image's variance that the patch leaves unexplained at each of `pixels` (level 0); `None` outside
    /// of the image, and where it has nothing in common with the patch.
    pub fn errors_at(&self, view: &Pyramid, pixels: &[[f32; 2]]) -> Vec<Option<f32>> {
        errors_at(self, view, pixels)
    }

    /// The level of a pyramid that has the patch's resolution, and how many pixels of level 0 one of it is wide.
    #[inline(always)]
    fn level_of<'a>(&self, view: &'a Pyramid) -> (&'a GrayImage, f32) {
        let level = self.level.min(view.len() - 1);
        (view.level(level), (1u32 << level) as f32)
    }

    /// Sums over the patch around `at` (fixed bilinear weights: the grid is not rotated) of the image's intensities `v` less
    /// the patch's mean: `[Σv, Σv², ΣvT]`, and `Σvg` for each of the images `g`, each in as many lanes as a row has pixels.
    #[inline(always)]
    fn sums<const N: usize>(
        &self,
        processor: impl Processor,
        image: &GrayImage,
        at: [f32; 2],
        others: [&[f32; AREA]; N],
    ) -> Option<([f32; 3], [f32; N])> {
        let (x, y) = (at[0] + FIRST, at[1] + FIRST);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (x0, y0, width) = (x as u32, y as u32, image.width());
        let (left, top) = (x0 as usize, y0 as usize);
        if left + SIZE + 1 > width || top + SIZE + 1 > image.height() {
            return None;
        }
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        let [w00, w01, w10, w11] = weights.map(|weight| processor.splat(weight));
        let mean = processor.splat(self.mean);
        // From the first pixel to the last: looked up once, as looking up each row takes as long as working on it.
        let block = &image.data()[top * width + left..][..SIZE * width + SIZE + 1];
        let row = |j: usize| {
            // SAFETY: the first pixel of row `j` ≤ SIZE and the SIZE pixels behind it lie in the block.
            let [own, next] = unsafe {
                let first = block.as_ptr().add(j * width);
                [&*first.cast(), &*first.add(1).cast()]
            };
            (processor.load_bytes(own), processor.load_bytes(next))
        };
        let (intensity, others) = (rows(&self.intensity), others.map(rows));
        let zero = processor.splat(0.0);
        let (mut sum, mut square, mut product, mut by_others) = (zero, zero, zero, [zero; N]);
        let mut upper = row(0);
        for j in 0..SIZE {
            let lower = row(j + 1);
            let v = w00 * upper.0 + w01 * upper.1 + w10 * lower.0 + w11 * lower.1 - mean;
            (sum, square) = (sum + v, square + v * v);
            product = product + v * processor.load(&intensity[j]);
            for (sum, other) in by_others.iter_mut().zip(&others) {
                *sum = *sum + v * processor.load(&other[j]);
            }
            upper = lower;
        }
        Some(([sum, square, product].map(Lanes::sum), by_others.map(Lanes::sum)))
    }

    /// Fits gain and offset to such sums; `None` when the image has nothing in common with the patch.
    #[inline(always)]
    fn fit(&self, [sum, square, it]: [f32; 3]) -> Option<Fit> {
        let mean = sum / AREA as f32;
        let ii = square - mean * sum;
        let gain = it / self.square.max(1e-3);
        if !(MIN_GAIN..=1.0 / MIN_GAIN).contains(&gain) {
            return None;
        }
        let left = (ii - gain * it).max(0.0);
        Some(Fit { mean, gain, mean_square: left / AREA as f32, unexplained: left / ii.max(AREA as f32) })
    }
}

geometry::multiversion! {
    fn errors_at[processor](patch: &Appearance, view: &Pyramid, pixels: &[[f32; 2]]) -> Vec<Option<f32>> {
        let (image, scale) = patch.level_of(view);
        let mut errors = Vec::with_capacity(pixels.len());
        for pixel in pixels {
            let sums = patch.sums(processor, image, pixel.map(|v| (v + 0.5) / scale - 0.5), []);
            errors.push(sums.and_then(|(sums, [])| patch.fit(sums)).map(|fit| fit.unexplained));
        }
        errors
    }
}

impl Template {
    /// Cuts the template around `pixel` (level 0 of `host`) for a view related by `warp`.
    /// `None` when the patch leaves the host image.
    pub fn cut(host: &Pyramid, pixel: [f32; 2], warp: &Warp) -> Option<Self> {
        Some(Self::new(&patch_with_rim(host, pixel, warp)?, warp.view_level))
    }

    fn new(samples: &[[f32; RIM]; RIM], level: usize) -> Self {
        let mut inner = [[0.0; SIZE]; SIZE];
        let mut gradient_x = [0.0; AREA];
        let mut gradient_y = [0.0; AREA];
        for j in 0..SIZE {
            let (above, row, below) = (&samples[j], &samples[j + 1], &samples[j + 2]);
            for i in 0..SIZE {
                inner[j][i] = row[i + 1];
                gradient_x[j * SIZE + i] = 0.5 * (row[i + 2] - row[i]);
                gradient_y[j * SIZE + i] = 0.5 * (below[i + 1] - above[i + 1]);
            }
        }
        let appearance = Appearance::new(inner, level);
        let moments = Moments::new(&appearance, &gradient_x, &gradient_y);
        Self { appearance, gradient_x, gradient_y, moments }
    }

    /// Level of the searched pyramid that matches the template's resolution.
    pub fn level(&self) -> usize {
        self.appearance.level
    }

    /// Aligns the template in `view` from a start at level 0; `None` when it leaves the image, has no
    /// texture or strays more than `max_shift` pixels (of its level).
    pub fn align(
        &self,
        view: &Pyramid,
        start: [f32; 2],
        max_shift: f32,
        iterations: usize,
    ) -> Option<PatchMatch> {
        align(self, view, start, max_shift, iterations)
    }

    /// Gain and error of the image at the patch around `at`, with `Σ r ∇T`.
    #[inline(always)]
    fn residual(
        &self,
        processor: impl Processor,
        image: &GrayImage,
        at: [f32; 2],
    ) -> Option<(Fit, [f32; 2])> {
        let gradient = [&self.gradient_x, &self.gradient_y];
        let (sums, [ix, iy]) = self.appearance.sums(processor, image, at, gradient)?;
        let (fit, m) = (self.appearance.fit(sums)?, &self.moments);
        Some((fit, [ix - fit.mean * m.x - fit.gain * m.tx, iy - fit.mean * m.y - fit.gain * m.ty]))
    }
}

geometry::multiversion! {
    fn align[processor](
        template: &Template,
        view: &Pyramid,
        start: [f32; 2],
        max_shift: f32,
        iterations: usize,
    ) -> Option<PatchMatch> {
        let (image, scale) = template.appearance.level_of(view);
        let origin = start.map(|v| (v + 0.5) / scale - 0.5);
        let [xx, xy, yy] = template.moments.position;
        // Along an edge the position is unknown: damping keeps the start there.
        let damping = 1e-3 * (xx + yy) + 1e-3;
        let (dxx, dyy) = (xx + damping, yy + damping);
        let det = dxx * dyy - xy * xy;
        if det <= 0.0 || xx + yy < AREA as f32 {
            return None;
        }
        let mut at = origin;
        let (mut fit, mut gradient) = template.residual(processor, image, at)?;
        for _ in 0..iterations {
            let (bx, by) = (gradient[0] / fit.gain, gradient[1] / fit.gain);
            let step = [(dyy * bx - xy * by) / det, (dxx * by - xy * bx) / det];
            at = [at[0] - step[0], at[1] - step[1]];
            let (dx, dy) = (at[0] - origin[0], at[1] - origin[1]);
            if dx * dx + dy * dy > max_shift * max_shift {
                return None;
            }
            (fit, gradient) = template.residual(processor, image, at)?;
            if step[0] * step[0] + step[1] * step[1] < 0.01 * 0.01 {
                break;
            }
        }
        let inverse = fit.gain * fit.gain / (scale * scale);
        Some(PatchMatch {
            pixel: at.map(|v| (v + 0.5) * scale - 0.5),
            information: [xx * inverse, xy * inverse, yy * inverse],
            rmse: fit.mean_square.sqrt(),
            unexplained: fit.unexplained,
        })
    }
}

/// Contrast of the image relative to the template below which they are not the same patch.
const MIN_GAIN: f32 = 0.25;

/// The patch error at one position, gain and offset eliminated.
#[derive(Clone, Copy)]
struct Fit {
    /// Mean of the image less that of the patch.
    mean: f32,
    /// Contrast of the image relative to the patch.
    gain: f32,
    /// Mean of `r²`.
    mean_square: f32,
    /// `Σ r²` over the image's own central `Σ I²`.
    unexplained: f32,
}

impl Moments {
    fn new(patch: &Appearance, gx: &[f32; AREA], gy: &[f32; AREA]) -> Self {
        let (x, y) = (gx.iter().sum::<f32>(), gy.iter().sum::<f32>());
        let n = AREA as f32;
        let (tx, ty) = (dot(&patch.intensity, gx), dot(&patch.intensity, gy));
        let (xx, xy, yy) = (dot(gx, gx) - x * x / n, dot(gx, gy) - x * y / n, dot(gy, gy) - y * y / n);
        let s = patch.square.max(1e-3);
        Self { tx, ty, x, y, position: [xx - tx * tx / s, xy - tx * ty / s, yy - ty * ty / s] }
    }
}

/// The rows of a patch.
#[inline(always)]
fn rows(patch: &[f32; AREA]) -> &[[f32; SIZE]] {
    patch.as_chunks().0
}

fn dot(a: &[f32; AREA], b: &[f32; AREA]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests;
