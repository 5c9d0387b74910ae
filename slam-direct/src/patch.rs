//! Aligning one small patch of a keyframe in another image.
//!
//! The template is cut out of the host keyframe as the other camera would see it (an affine warp for a
//! patch that faces the host), then moved over the image until the photometric error is least:
//! inverse compositional Lucas–Kanade (Baker & Matthews 2004) with one brightness offset per patch.
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
    intensity: [f32; AREA],
    gradient_x: [f32; AREA],
    gradient_y: [f32; AREA],
    /// Upper triangle of `Σ J Jᵀ` with `J = (g_x, g_y, 1)`: xx, xy, x, yy, y (the last entry is AREA).
    hessian: [f32; 5],
    /// Level of the searched pyramid that matches the template's resolution.
    pub level: usize,
}

/// Where a template was found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchMatch {
    /// Position at level 0 of the searched image.
    pub pixel: [f32; 2],
    /// Inverse covariance `[xx, xy, yy]` of the position in 1/px² of level 0 for intensity noise of one
    /// grey level.
    pub information: [f32; 3],
    /// Root mean square intensity residual after the offset is removed.
    pub rmse: f32,
    /// Share of the template's variance that the match leaves unexplained, 0 (perfect) and up.
    pub unexplained: f32,
}

impl Template {
    /// Cuts the template around `pixel` (level 0 of `host`) for a view related by `warp`; intensities
    /// are multiplied by `gain`. `None` when the patch leaves the host image.
    pub fn cut(host: &Pyramid, pixel: [f32; 2], warp: &Warp, gain: f32) -> Option<Self> {
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
                samples[j * RIM + i] = gain * image.bilinear(x, y);
            }
        }
        Some(Self::from_samples(&samples, warp.view_level))
    }

    fn from_samples(samples: &[f32; RIM * RIM], level: usize) -> Self {
        let mut intensity = [0.0; AREA];
        let mut gradient_x = [0.0; AREA];
        let mut gradient_y = [0.0; AREA];
        let mut hessian = [0.0f32; 5];
        for j in 0..SIZE {
            for i in 0..SIZE {
                let s = (j + 1) * RIM + i + 1;
                let gx = 0.5 * (samples[s + 1] - samples[s - 1]);
                let gy = 0.5 * (samples[s + RIM] - samples[s - RIM]);
                let p = j * SIZE + i;
                intensity[p] = samples[s];
                gradient_x[p] = gx;
                gradient_y[p] = gy;
                for (h, v) in hessian.iter_mut().zip([gx * gx, gx * gy, gx, gy * gy, gy]) {
                    *h += v;
                }
            }
        }
        Self { intensity, gradient_x, gradient_y, hessian, level }
    }

    /// The 2×2 Hessian of the photometric error over position once the offset is eliminated.
    pub fn position_hessian(&self) -> [f32; 3] {
        let [xx, xy, x, yy, y] = self.hessian;
        let n = AREA as f32;
        [xx - x * x / n, xy - x * y / n, yy - y * y / n]
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
        let [xx, xy, yy] = self.position_hessian();
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
            let (bx, by) = residual.gradient;
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
        let variance = self.variance().max(1.0);
        let inverse = 1.0 / (scale * scale);
        Some(PatchMatch {
            pixel: [(at[0] + 0.5) * scale - 0.5, (at[1] + 0.5) * scale - 0.5],
            information: [xx * inverse, xy * inverse, yy * inverse],
            rmse: residual.mean_square.sqrt(),
            unexplained: residual.mean_square / variance,
        })
    }

    /// Mean squared intensity residual with the template at `pixel` (level 0), offset removed.
    pub fn error_at(&self, view: &Pyramid, pixel: [f32; 2]) -> Option<f32> {
        let level = self.level.min(view.len() - 1);
        let scale = (1u32 << level) as f32;
        let at = [(pixel[0] + 0.5) / scale - 0.5, (pixel[1] + 0.5) / scale - 0.5];
        self.residual(view.level(level), at).map(|r| r.mean_square)
    }

    /// Variance of the template's intensities.
    pub fn variance(&self) -> f32 {
        let n = AREA as f32;
        let mean = self.intensity.iter().sum::<f32>() / n;
        self.intensity.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n
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
        let mut difference = [0.0f32; AREA];
        for j in 0..SIZE {
            let top: &[u8; SIZE + 1] = image.row(y0 + j)[x0..x0 + SIZE + 1].try_into().ok()?;
            let bottom: &[u8; SIZE + 1] = image.row(y0 + j + 1)[x0..x0 + SIZE + 1].try_into().ok()?;
            let out = &mut difference[j * SIZE..(j + 1) * SIZE];
            let template = &self.intensity[j * SIZE..(j + 1) * SIZE];
            for i in 0..SIZE {
                out[i] = weights[0] * top[i] as f32
                    + weights[1] * top[i + 1] as f32
                    + weights[2] * bottom[i] as f32
                    + weights[3] * bottom[i + 1] as f32
                    - template[i];
            }
        }
        Some(self.reduce(&difference))
    }

    /// Sums over the patch in eight fixed lanes, so that the compiler may vectorise them.
    fn reduce(&self, difference: &[f32; AREA]) -> Residual {
        let mut lanes = [[0.0f32; SIZE]; 4];
        for j in 0..SIZE {
            for i in 0..SIZE {
                let p = j * SIZE + i;
                let d = difference[p];
                lanes[0][i] += d;
                lanes[1][i] += d * d;
                lanes[2][i] += d * self.gradient_x[p];
                lanes[3][i] += d * self.gradient_y[p];
            }
        }
        let [sum, square, dx, dy] = lanes.map(|lane| lane.iter().sum::<f32>());
        let mean = sum / AREA as f32;
        Residual {
            gradient: (dx - mean * self.hessian[2], dy - mean * self.hessian[4]),
            mean_square: (square / AREA as f32 - mean * mean).max(0.0),
        }
    }
}

/// The patch error at one position, the brightness offset eliminated.
struct Residual {
    /// `Σ (r − r̄) ∇T`.
    gradient: (f32, f32),
    /// Mean of `(r − r̄)²`.
    mean_square: f32,
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
        let template = Template::cut(&host, [40.0, 36.0], &Warp::identity(), 1.1).unwrap();
        let found = template.align(&view, [40.0, 36.0], 5.0, 20).unwrap();
        assert!((found.pixel[0] - 41.37).abs() < 0.03, "{found:?}");
        assert!((found.pixel[1] - 35.19).abs() < 0.03, "{found:?}");
        assert!(found.rmse < 1.5 && found.unexplained < 0.01, "{found:?}");
    }

    #[test]
    fn refuses_a_flat_patch_and_one_outside() {
        let flat = Pyramid::new(GrayImage::filled(64, 64, 90), 1);
        let template = Template::cut(&flat, [30.0, 30.0], &Warp::identity(), 1.0).unwrap();
        assert!(template.align(&flat, [30.0, 30.0], 5.0, 10).is_none());
        assert!(Template::cut(&flat, [2.0, 30.0], &Warp::identity(), 1.0).is_none());
    }
}
