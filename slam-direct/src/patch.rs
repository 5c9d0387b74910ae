//! Aligning one small patch of a keyframe in another image.
//!
//! The template is cut out of the host keyframe as the other camera would see it (an affine warp for a
//! patch that faces the host), then moved over the image until the photometric error is least:
//! inverse compositional Lucas–Kanade (Baker & Matthews 2004) with a gain and an offset per patch.
//! The Hessian of that error at its minimum is what the patch knows of its own position, and goes to
//! the window optimisation as the observation's information.

use crate::warp::Warp;
use geometry::{GrayImage, Pyramid};

/// Patches are `SIZE × SIZE` pixels.
pub(crate) const SIZE: usize = 8;
const AREA: usize = SIZE * SIZE;
/// Offset of the first pixel from the patch's centre.
const FIRST: f32 = -(SIZE as f32 - 1.0) / 2.0;
/// Side of the sampled square: the patch and a rim for central differences.
const RIM: usize = SIZE + 2;

/// A host patch warped to the view it is looked for in.
pub(crate) struct Template {
    /// Intensities less their mean.
    intensity: [f32; AREA],
    gradient_x: [f32; AREA],
    gradient_y: [f32; AREA],
    mean: f32,
    moments: Moments,
    /// Level of the searched pyramid that matches the template's resolution.
    pub level: usize,
}

/// Central second moments of the template `T` and its gradient, summed over the patch.
struct Moments {
    tt: f32,
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

impl Template {
    /// Cuts the template around `pixel` (level 0 of `host`) for a view related by `warp`.
    /// `None` when the patch leaves the host image.
    pub fn cut(host: &Pyramid, pixel: [f32; 2], warp: &Warp) -> Option<Self> {
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
        let mut samples = [0.0f32; RIM * RIM];
        for j in 0..RIM {
            let dy = FIRST - 1.0 + j as f32;
            for i in 0..RIM {
                let dx = FIRST - 1.0 + i as f32;
                let (x, y) = (cx + m[0] * dx + m[1] * dy, cy + m[2] * dx + m[3] * dy);
                samples[j * RIM + i] = image.bilinear(x, y);
            }
        }
        Some(Self::from_samples(&samples, warp.view_level))
    }

    fn from_samples(samples: &[f32; RIM * RIM], level: usize) -> Self {
        let mut intensity = [0.0; AREA];
        let mut gradient_x = [0.0; AREA];
        let mut gradient_y = [0.0; AREA];
        for j in 0..SIZE {
            for i in 0..SIZE {
                let s = (j + 1) * RIM + i + 1;
                let p = j * SIZE + i;
                intensity[p] = samples[s];
                gradient_x[p] = 0.5 * (samples[s + 1] - samples[s - 1]);
                gradient_y[p] = 0.5 * (samples[s + RIM] - samples[s - RIM]);
            }
        }
        let mean = intensity.iter().sum::<f32>() / AREA as f32;
        for v in &mut intensity {
            *v -= mean;
        }
        let moments = Moments::new(&intensity, &gradient_x, &gradient_y);
        Self { intensity, gradient_x, gradient_y, mean, moments, level }
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
        let level = self.level.min(view.len() - 1);
        let image = view.level(level);
        let scale = (1u32 << level) as f32;
        let origin = [(start[0] + 0.5) / scale - 0.5, (start[1] + 0.5) / scale - 0.5];
        let [xx, xy, yy] = self.moments.position;
        // Along an edge the position is unknown: damping keeps the start there.
        let damping = 1e-3 * (xx + yy) + 1e-3;
        let (dxx, dyy) = (xx + damping, yy + damping);
        let det = dxx * dyy - xy * xy;
        if det <= 0.0 || xx + yy < AREA as f32 {
            return None;
        }
        let mut at = origin;
        let mut residual = self.residual(image, at)?;
        for _ in 0..iterations {
            let (bx, by) = (residual.gradient.0 / residual.gain, residual.gradient.1 / residual.gain);
            let step = [(dyy * bx - xy * by) / det, (dxx * by - xy * bx) / det];
            at = [at[0] - step[0], at[1] - step[1]];
            if (at[0] - origin[0]).hypot(at[1] - origin[1]) > max_shift {
                return None;
            }
            residual = self.residual(image, at)?;
            if step[0] * step[0] + step[1] * step[1] < 0.01 * 0.01 {
                break;
            }
        }
        let inverse = residual.gain * residual.gain / (scale * scale);
        Some(PatchMatch {
            pixel: [(at[0] + 0.5) * scale - 0.5, (at[1] + 0.5) * scale - 0.5],
            information: [xx * inverse, xy * inverse, yy * inverse],
            rmse: residual.mean_square.sqrt(),
            unexplained: residual.unexplained,
        })
    }

    /// Share of the image's variance that the template leaves unexplained at `pixel` (level 0).
    pub fn error_at(&self, view: &Pyramid, pixel: [f32; 2]) -> Option<f32> {
        let level = self.level.min(view.len() - 1);
        let scale = (1u32 << level) as f32;
        let at = [(pixel[0] + 0.5) / scale - 0.5, (pixel[1] + 0.5) / scale - 0.5];
        self.residual(view.level(level), at).map(|r| r.unexplained)
    }

    /// Samples the image at the patch around `at` (fixed bilinear weights: the grid is not rotated).
    fn residual(&self, image: &GrayImage, at: [f32; 2]) -> Option<Residual> {
        let (x, y) = (at[0] + FIRST, at[1] + FIRST);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (x0, y0) = (x as usize, y as usize);
        if x0 + SIZE + 1 > image.width() || y0 + SIZE + 1 > image.height() {
            return None;
        }
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        let mut sampled = [0.0f32; AREA];
        for j in 0..SIZE {
            let top: &[u8; SIZE + 1] = image.row(y0 + j)[x0..x0 + SIZE + 1].try_into().ok()?;
            let bottom: &[u8; SIZE + 1] = image.row(y0 + j + 1)[x0..x0 + SIZE + 1].try_into().ok()?;
            let out = &mut sampled[j * SIZE..(j + 1) * SIZE];
            for i in 0..SIZE {
                out[i] = weights[0] * top[i] as f32
                    + weights[1] * top[i + 1] as f32
                    + weights[2] * bottom[i] as f32
                    + weights[3] * bottom[i + 1] as f32
                    - self.mean;
            }
        }
        self.reduce(&sampled)
    }

    /// Fits gain and offset; `None` when the image has nothing in common with the template.
    /// Sums run in eight fixed lanes, so that the compiler may vectorise them.
    #[allow(clippy::needless_range_loop, reason = "five lanes and four images share the index")]
    fn reduce(&self, sampled: &[f32; AREA]) -> Option<Residual> {
        let mut lanes = [[0.0f32; SIZE]; 5];
        for j in 0..SIZE {
            for i in 0..SIZE {
                let p = j * SIZE + i;
                let v = sampled[p];
                lanes[0][i] += v;
                lanes[1][i] += v * v;
                lanes[2][i] += v * self.intensity[p];
                lanes[3][i] += v * self.gradient_x[p];
                lanes[4][i] += v * self.gradient_y[p];
            }
        }
        let [sum, square, it, ix, iy] = lanes.map(|lane| lane.iter().sum::<f32>());
        let m = &self.moments;
        let mean = sum / AREA as f32;
        let (ii, ix, iy) = (square - mean * sum, ix - mean * m.x, iy - mean * m.y);
        let gain = it / m.tt.max(1e-3);
        if !(MIN_GAIN..=1.0 / MIN_GAIN).contains(&gain) {
            return None;
        }
        let left = (ii - gain * it).max(0.0);
        Some(Residual {
            gradient: (ix - gain * m.tx, iy - gain * m.ty),
            gain,
            mean_square: left / AREA as f32,
            unexplained: left / ii.max(AREA as f32),
        })
    }
}

/// Contrast of the image relative to the template below which they are not the same patch.
const MIN_GAIN: f32 = 0.25;

/// The patch error at one position, gain and offset eliminated.
struct Residual {
    /// `Σ r ∇T`, central.
    gradient: (f32, f32),
    /// Contrast of the image relative to the template.
    gain: f32,
    /// Mean of `r²`.
    mean_square: f32,
    /// `Σ r²` over the image's own central `Σ I²`.
    unexplained: f32,
}

impl Moments {
    fn new(t: &[f32; AREA], gx: &[f32; AREA], gy: &[f32; AREA]) -> Self {
        let dot = |a: &[f32; AREA], b: &[f32; AREA]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let (x, y) = (gx.iter().sum::<f32>(), gy.iter().sum::<f32>());
        let n = AREA as f32;
        let (tt, tx, ty) = (dot(t, t), dot(t, gx), dot(t, gy));
        let (xx, xy, yy) = (dot(gx, gx) - x * x / n, dot(gx, gy) - x * y / n, dot(gy, gy) - y * y / n);
        let s = tt.max(1e-3);
        Self { tt, tx, ty, x, y, position: [xx - tx * tx / s, xy - tx * ty / s, yy - ty * ty / s] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pyramid;

    fn textured(dx: f32, dy: f32, gain: f32, offset: f32) -> GrayImage {
        let mut image = GrayImage::filled(96, 80, 0);
        for y in 0..80 {
            for x in 0..96 {
                let (u, v) = (x as f32 - dx, y as f32 - dy);
                let value = 110.0 + 40.0 * (0.35 * u + 0.1 * v).sin() + 35.0 * (0.27 * v - 0.12 * u).cos();
                image.set(x, y, (gain * value + offset).round() as u8);
            }
        }
        image
    }

    #[test]
    fn finds_a_shift_under_a_brightness_change() {
        let host = Pyramid::new(textured(0.0, 0.0, 1.0, 0.0), 1);
        let view = Pyramid::new(textured(1.37, -0.81, 1.1, -12.0), 1);
        let template = Template::cut(&host, [40.0, 36.0], &Warp::identity()).unwrap();
        let found = template.align(&view, [40.0, 36.0], 5.0, 20).unwrap();
        assert!((found.pixel[0] - 41.37).abs() < 0.03, "{found:?}");
        assert!((found.pixel[1] - 35.19).abs() < 0.03, "{found:?}");
        assert!(found.rmse < 1.5 && found.unexplained < 0.01, "{found:?}");
    }

    #[test]
    fn refuses_a_flat_patch_and_one_outside() {
        let flat = Pyramid::new(GrayImage::filled(64, 64, 90), 1);
        let template = Template::cut(&flat, [30.0, 30.0], &Warp::identity()).unwrap();
        assert!(template.align(&flat, [30.0, 30.0], 5.0, 10).is_none());
        assert!(Template::cut(&flat, [2.0, 30.0], &Warp::identity()).is_none());
    }
}
