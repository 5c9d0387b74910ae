//! Depth at key points: what turns a key point of a keyframe into a 3-D point (Loop-box, §IV-C2).
//!
//! SIFT finds the middles of blobs, semi-dense depth lies on their edges. The depth of a key point is therefore
//! that of the plane through the depths around it: the inverse depth of a plane is linear in the pixel.

use crate::scale_filter::MeasuredPoint;
use geometry::Pinhole;
use map::SemiDense;
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// How depth at key points is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyPointParams {
    /// Half the width of the window in which depths are taken, pixels. Default 5; 1 to 12. Wider finds depth
    /// for more key points, and more that lie across a depth edge.
    pub radius: usize,
    /// Fewest pixels with depth in the window. Default 5; at least 3.
    pub min_pixels: usize,
    /// Largest difference from the median of the window that one surface explains, relative. Default 0.05;
    /// 0.01 to 0.3. Higher takes steeper surfaces and more depth edges.
    pub max_relative_gap: f64,
    /// Least share of the window's depths that lie on one surface. Default 0.7; 0.5 to 1.
    pub min_share: f64,
    /// Standard deviation of the plane's slope, relative to the inverse depth, 1/pixel. Default 0.005, that of
    /// walls seen at 65° for a focal length of 420 pixels; above 0.
    pub slope_deviation: f64,
    /// Standard deviation of a key point's position, pixels. Default 0.7; above 0.
    pub pixel_deviation: f64,
    /// Floor of the relative standard deviation of an inverse depth. Default 0.004; 0 or more. Neighbouring
    /// depths share errors that their variances do not tell.
    pub min_depth_deviation: f64,
}

impl Default for KeyPointParams {
    fn default() -> Self {
        Self {
            radius: 5,
            min_pixels: 5,
            max_relative_gap: 0.05,
            min_share: 0.7,
            slope_deviation: 0.005,
            pixel_deviation: 0.7,
            min_depth_deviation: 0.004,
        }
    }
}

/// Semi-dense inverse depth laid out as an image, to look up by pixel.
pub struct DepthGrid {
    width: usize,
    height: usize,
    /// `(inverse depth, variance)`; an inverse depth of 0 stands for none.
    cells: Vec<(f32, f32)>,
}

impl DepthGrid {
    /// Lays out `semi_dense` for images of `camera`. Pixels outside the image and numbers that are not
    /// positive and finite are left out.
    pub fn new(semi_dense: &SemiDense, camera: &Pinhole) -> Self {
        let mut cells = vec![(0.0, 0.0); camera.width * camera.height];
        let positive = |v: f32| v.is_finite() && v > 0.0;
        for (pixel, inverse_depth, variance) in semi_dense.iter() {
            if let Some(cell) = cells.get_mut(pixel as usize)
                && positive(inverse_depth)
                && positive(variance)
            {
                *cell = (inverse_depth, variance);
            }
        }
        Self { width: camera.width, height: camera.height, cells }
    }

    /// `(inverse depth, variance)` at a pixel; `None` outside the image and where there is none.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> Option<(f32, f32)> {
        let inside = x < self.width && y < self.height;
        inside.then(|| self.cells[y * self.width + x]).filter(|cell| cell.0 > 0.0)
    }

    /// The inverse depth and its variance at a key point, of the plane through the depths around it; `None`
    /// where there are too few, or where they lie on more than one surface.
    pub fn at_key_point(&self, pixel: [f32; 2], params: &KeyPointParams) -> Option<(f64, f64)> {
        let window = self.window(pixel, params.radius);
        if window.len() < params.min_pixels.max(3) {
            return None;
        }
        let mut sorted: Vec<f64> = window.iter().map(|sample| sample.inverse_depth).collect();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2];
        let near =
            |sample: &&Sample| (sample.inverse_depth - median).abs() <= params.max_relative_gap * median;
        let surface: Vec<&Sample> = window.iter().filter(near).collect();
        if (surface.len() as f64) < params.min_share * window.len() as f64 {
            return None;
        }
        plane(&surface, median, params)
    }

    /// The depths within `radius` of a pixel.
    fn window(&self, pixel: [f32; 2], radius: usize) -> Vec<Sample> {
        let (x, y) = (f64::from(pixel[0]), f64::from(pixel[1]));
        let range = |centre: f64, size: usize| {
            let first = (centre - radius as f64).ceil().max(0.0) as usize;
            let last = (centre + radius as f64).floor().min(size as f64 - 1.0);
            first..if last < 0.0 { 0 } else { last as usize + 1 }
        };
        let mut samples = Vec::new();
        for v in range(y, self.height) {
            for u in range(x, self.width) {
                if let Some((inverse_depth, variance)) = self.at(u, v) {
                    samples.push(Sample {
                        offset: Vector2::new(u as f64 - x, v as f64 - y),
                        inverse_depth: f64::from(inverse_depth),
                        variance: f64::from(variance),
                    });
                }
            }
        }
        samples
    }
}

/// A depth beside a key point.
struct Sample {
    /// Pixels from the key point.
    offset: Vector2<f64>,
    inverse_depth: f64,
    variance: f64,
}

/// The plane's inverse depth at the key point, with variance: least squares weighted by variance, with a prior
/// on the slope that decides where the samples lie on a line.
fn plane(samples: &[&Sample], median: f64, params: &KeyPointParams) -> Option<(f64, f64)> {
    let slope = (params.slope_deviation * median).powi(2).recip();
    let mut normal = Matrix3::from_diagonal(&Vector3::new(0.0, slope, slope));
    let (mut right, mut information) = (Vector3::zeros(), 0.0);
    for sample in samples {
        let row = Vector3::new(1.0, sample.offset.x, sample.offset.y);
        let weight = sample.variance.recip();
        normal += row * row.transpose() * weight;
        right += row * (weight * sample.inverse_depth);
        information += weight;
    }
    let covariance = normal.try_inverse()?;
    let solution = covariance * right;
    let chi2: f64 = samples
        .iter()
        .map(|s| (s.inverse_depth - solution[0] - s.offset.dot(&solution.yz())).powi(2) / s.variance)
        .sum();
    let count = samples.len() as f64;
    // Neighbours share their errors: their number does not make the depth better, nor does leaving the window's
    // middle empty make it worse by less than the fit says.
    let residual_scale = (chi2 / count).max(1.0);
    let correlated = (count / information).max(covariance[(0, 0)]) * residual_scale;
    let floor = (params.min_depth_deviation * solution[0]).powi(2);
    (solution[0] > 0.0).then_some((solution[0], correlated + floor))
}

/// The 3-D points of key points that have depth, in the keyframe's camera frame and unit.
pub fn measure(
    pixel: [f32; 2],
    depth: &DepthGrid,
    camera: &Pinhole,
    params: &KeyPointParams,
) -> Option<MeasuredPoint> {
    let (inverse_depth, variance) = depth.at_key_point(pixel, params)?;
    let position = Vector2::new(f64::from(pixel[0]), f64::from(pixel[1]));
    MeasuredPoint::unproject(camera, position, inverse_depth, params.pixel_deviation.powi(2), variance)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };

    /// Depth on every third pixel, by position.
    fn grid(inverse_depth: impl Fn(usize, usize) -> f32) -> DepthGrid {
        let mut semi_dense = SemiDense::default();
        for y in 0..CAMERA.height {
            for x in (y % 3..CAMERA.width).step_by(3) {
                semi_dense.pixel.push((y * CAMERA.width + x) as u32);
                semi_dense.inverse_depth.push(inverse_depth(x, y));
                semi_dense.variance.push(1e-8);
            }
        }
        DepthGrid::new(&semi_dense, &CAMERA)
    }

    #[test]
    fn a_slanted_plane_is_met_between_the_pixels() {
        let depth = grid(|x, y| 0.2 + 0.0004 * x as f32 - 0.0003 * y as f32);
        let (found, variance) = depth.at_key_point([30.4, 20.7], &KeyPointParams::default()).unwrap();
        assert!((found - (0.2 + 0.0004 * 30.4 - 0.0003 * 20.7)).abs() < 2e-5, "{found}");
        assert!(variance > 0.0 && variance.sqrt() < 0.01 * found, "{variance}");
    }

    #[test]
    fn a_depth_edge_has_no_depth() {
        let depth = grid(|x, _| if x < 30 { 0.2 } else { 0.4 });
        assert_eq!(depth.at_key_point([29.5, 20.0], &KeyPointParams::default()), None);
        assert!(depth.at_key_point([20.0, 20.0], &KeyPointParams::default()).is_some());
    }

    #[test]
    fn nothing_is_found_far_outside_or_where_there_is_no_depth() {
        let depth = grid(|_, _| 0.2);
        for pixel in [[-40.0, 10.0], [10.0, 400.0], [f32::NAN, 3.0], [f32::INFINITY, 3.0]] {
            assert_eq!(depth.at_key_point(pixel, &KeyPointParams::default()), None);
        }
        let empty = DepthGrid::new(&SemiDense::default(), &CAMERA);
        assert_eq!(empty.at_key_point([10.0, 10.0], &KeyPointParams::default()), None);
    }

    #[test]
    fn noise_that_the_variances_do_not_tell_widens_the_result() {
        let smooth = grid(|_, _| 0.2);
        let rough = grid(|x, y| 0.2 + if (x + y) % 2 == 0 { 0.004 } else { -0.004 });
        let params = KeyPointParams::default();
        let deviation = |depth: &DepthGrid| depth.at_key_point([20.0, 20.0], &params).unwrap().1.sqrt();
        assert!(deviation(&rough) > 2.0 * deviation(&smooth));
    }
}
