//! A keyframe's points as viewers get them: small, and in an order that any beginning of is an even sample.

use geometry::{GrayImage, Pinhole, Random};
use map::{Color, DEFAULT_MAX_RELATIVE_VARIANCE, SemiDense};
use nalgebra::Vector3;

/// Bytes of a point: pixel x, y and inverse depth as u16, intensity and uncertainty as u8; little-endian.
pub const POINT_BYTES: usize = 8;

/// Relative standard deviations of inverse depth (σ/d) that codes 0 and 255 stand for; logarithmic between.
pub const SIGMA_RANGE: [f32; 2] = [1e-3, 1.0];

/// The points of one keyframe, relative to it.
///
/// A point is its pixel and its inverse depth rather than x, y, z: exact to the pixel, and points that went astray to
/// far away cost the others no precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// The camera of its pixels.
    pub camera: Pinhole,
    /// Inverse depths that codes 0 and 65535 stand for, 1/keyframe unit.
    pub inverse_depth: [f32; 2],
    /// The points, [`POINT_BYTES`] each, shuffled.
    pub points: Vec<u8>,
    /// Red, green and blue of each point in their order, where the image has colours; else nothing.
    pub colors: Vec<u8>,
}

impl Chunk {
    /// The points whose depth is as certain as those of an exported cloud. The same keyframe gives the same bytes.
    pub fn new(camera: &Pinhole, image: &GrayImage, color: Option<&Color>, depth: &SemiDense) -> Self {
        let mut kept: Vec<(u32, f32, f32, u8)> = depth
            .iter()
            .filter_map(|(pixel, d, variance)| {
                let certain = variance / (d * d) <= DEFAULT_MAX_RELATIVE_VARIANCE;
                let &intensity = image.data().get(pixel as usize).filter(|_| certain && d > 0.0)?;
                d.is_finite().then_some((pixel, d, variance, intensity))
            })
            .collect();
        shuffle(&mut kept);
        let (low, high) =
            kept.iter().fold((f32::INFINITY, 0.0f32), |(low, high), p| (low.min(p.1), high.max(p.1)));
        let inverse_depth = if kept.is_empty() { [0.0, 1.0] } else { [low, high.max(low * 1.001)] };
        let mut points = Vec::with_capacity(kept.len() * POINT_BYTES);
        let width = image.width().max(1) as u32;
        let decoded = color.and_then(|color| color.decoded((image.width(), image.height())).ok());
        let mut colors = Vec::new();
        for (pixel, d, variance, intensity) in kept {
            let code = (d - inverse_depth[0]) / (inverse_depth[1] - inverse_depth[0]);
            for v in [(pixel % width) as u16, (pixel / width) as u16, (code * 65535.0).round() as u16] {
                points.extend(v.to_le_bytes());
            }
            points.extend([intensity, sigma_code(variance.sqrt() / d)]);
            let at = ((pixel % width) as usize, (pixel / width) as usize);
            colors.extend(decoded.iter().flat_map(|colors| colors.at(at.0, at.1, intensity)));
        }
        Self { camera: *camera, inverse_depth, points, colors }
    }

    /// How many points it has.
    pub fn len(&self) -> usize {
        self.points.len() / POINT_BYTES
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Pixel x and y and inverse depth of each point, in the shuffled order.
    pub fn depths(&self) -> impl Iterator<Item = [f32; 3]> + '_ {
        let [low, high] = self.inverse_depth;
        let unit = (high - low) / 65535.0;
        self.points.chunks_exact(POINT_BYTES).map(move |point| {
            let number = |at: usize| f32::from(u16::from_le_bytes([point[at], point[at + 1]]));
            [number(0), number(2), low + number(4) * unit]
        })
    }

    /// The points in the keyframe's frame with their inverse depths, in the shuffled order.
    pub fn positions(&self) -> impl Iterator<Item = (Vector3<f64>, f32)> + '_ {
        self.depths().map(|[x, y, d]| (self.camera.unproject(x.into(), y.into()) / f64::from(d), d))
    }

    /// The intensities, in the shuffled order.
    pub fn intensities(&self) -> impl Iterator<Item = u8> + '_ {
        self.points.chunks_exact(POINT_BYTES).map(|point| point[6])
    }
}

/// The code of a relative standard deviation; unknown (NaN) counts as the worst.
fn sigma_code(sigma: f32) -> u8 {
    let [best, worst] = SIGMA_RANGE;
    let t = (sigma / best).ln() / (worst / best).ln();
    if t.is_nan() { 255 } else { (t.clamp(0.0, 1.0) * 255.0).round() as u8 }
}

/// Fisher and Yates's shuffle, the same each time.
fn shuffle<T>(items: &mut [T]) {
    let mut random = Random::new(0);
    for i in (1..items.len()).rev() {
        items.swap(i, random.index(i + 1));
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub const CAMERA: Pinhole = Pinhole { width: 100, height: 80, fx: 90.0, fy: 90.0, cx: 49.5, cy: 39.5 };

    /// Depth in every pixel.
    pub fn dense() -> (GrayImage, SemiDense) {
        let count = (CAMERA.width * CAMERA.height) as u32;
        let image =
            GrayImage::from_vec(CAMERA.width, CAMERA.height, (0..count).map(|i| (i % 251) as u8).collect());
        let depth = SemiDense {
            pixel: (0..count).collect(),
            inverse_depth: (0..count).map(|i| 0.1 + i as f32 * 1e-4).collect(),
            variance: vec![1e-6; count as usize].into(),
        };
        (image.expect("the numbers fit"), depth)
    }

    #[test]
    fn points_come_back_where_they_were() {
        let (image, depth) = dense();
        let chunk = Chunk::new(&CAMERA, &image, None, &depth);
        assert_eq!(chunk.len(), depth.len());
        for (position, d) in chunk.positions() {
            let pixel = CAMERA.project(&position);
            let index = pixel.y.round() as usize * CAMERA.width + pixel.x.round() as usize;
            assert!((d - depth.inverse_depth[index]).abs() < 2e-5, "{d}");
            assert!((position.z * f64::from(d) - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn points_have_the_colours_of_their_pixels() {
        let (image, depth) = dense();
        let plane = |value| GrayImage::filled(CAMERA.width, CAMERA.height, value);
        let color = Color::of_planes(map::Luma::Rec709, [&plane(90), &plane(180)]).unwrap();
        let colors = color.decoded((CAMERA.width, CAMERA.height)).unwrap();
        let chunk = Chunk::new(&CAMERA, &image, Some(&color), &depth);
        assert_eq!(chunk.colors.len(), 3 * chunk.len());
        for ((found, intensity), [x, y, _]) in
            chunk.colors.chunks(3).zip(chunk.intensities()).zip(chunk.depths())
        {
            assert_eq!(found, colors.at(x as usize, y as usize, intensity));
        }
        assert!(Chunk::new(&CAMERA, &image, None, &depth).colors.is_empty());
    }

    #[test]
    fn any_beginning_is_an_even_sample_of_the_image() {
        let (image, depth) = dense();
        let chunk = Chunk::new(&CAMERA, &image, None, &depth);
        for share in [10, 40, 4] {
            let taken = chunk.len() / share;
            let mut quarters = [0usize; 4];
            for (position, _) in chunk.positions().take(taken) {
                let pixel = CAMERA.project(&position);
                quarters[usize::from(pixel.x > CAMERA.cx) + 2 * usize::from(pixel.y > CAMERA.cy)] += 1;
            }
            let fair = taken as f64 / 4.0;
            assert!(quarters.iter().all(|&n| (n as f64 - fair).abs() < 4.0 * fair.sqrt()), "{quarters:?}");
        }
    }

    #[test]
    fn uncertain_and_impossible_depths_are_left_out() {
        let (image, mut depth) = dense();
        depth.variance[0] = 1.0;
        depth.variance[1] = f32::NAN;
        depth.inverse_depth[2] = f32::INFINITY;
        depth.inverse_depth[3] = -1.0;
        assert_eq!(Chunk::new(&CAMERA, &image, None, &depth).len(), depth.len() - 4);
        assert!(Chunk::new(&CAMERA, &image, None, &SemiDense::default()).is_empty());
    }
}
