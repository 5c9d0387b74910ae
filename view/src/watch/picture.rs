//! The live image with the depth that the map has for it.

use super::chunk::Chunk;
use geometry::{GrayImage, Pinhole, Sim3};
use nalgebra::{Matrix3, Vector3};

/// Wider images are halved, thirded, … for viewers.
const MAX_WIDTH: usize = 640;
/// Depths drawn over an image at most.
const MAX_DEPTHS: usize = 15_000;

/// The newest image and the depths in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Index of the frame in the recording.
    pub frame_index: u64,
    /// Its time stamp, seconds.
    pub timestamp: f64,
    /// Columns, after shrinking.
    pub width: usize,
    /// Rows, after shrinking.
    pub height: usize,
    /// Intensities, row by row.
    pub grey: Vec<u8>,
    /// Pixels with a depth, x and y.
    pub pixels: Vec<[u16; 2]>,
    /// Their inverse depths over `range`, 0–255.
    pub codes: Vec<u8>,
    /// Inverse depths that codes 0 and 255 stand for, 1/map unit.
    pub range: [f32; 2],
}

/// A keyframe's points as seen from the live camera.
pub struct VisibleKeyframe<'a> {
    /// The points.
    pub chunk: &'a Chunk,
    /// Where the live camera is relative to them.
    pub camera_from_keyframe: Sim3,
}

impl Picture {
    /// An image without depths.
    pub fn new(frame_index: u64, timestamp: f64, image: &GrayImage) -> Self {
        let by = image.width().div_ceil(MAX_WIDTH).max(1);
        let (width, height) = (image.width() / by, image.height() / by);
        let grey = if by == 1 { image.data().to_vec() } else { shrunk(image, by) };
        let (pixels, codes, range) = (Vec::new(), Vec::new(), [0.0, 1.0]);
        Self { frame_index, timestamp, width, height, grey, pixels, codes, range }
    }

    /// Draws the points of keyframes into it; the colours' range follows that of `before` smoothly.
    pub fn overlay(&mut self, camera: &Pinhole, seen: &[VisibleKeyframe], before: Option<[f32; 2]>) {
        let shrink = self.width as f32 / camera.width.max(1) as f32;
        let mut depths = Vec::with_capacity(MAX_DEPTHS);
        for VisibleKeyframe { chunk, camera_from_keyframe } in seen {
            let project = Projection::new(camera, &chunk.camera, camera_from_keyframe);
            for point in chunk.depths().take(MAX_DEPTHS / seen.len()) {
                let Some([x, y, d]) = project.point(point) else { continue };
                let (x, y) = ((x * shrink).round(), (y * shrink).round());
                if x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32 {
                    self.pixels.push([x as u16, y as u16]);
                    depths.push(d);
                }
            }
        }
        let Some(range) = bulk(&depths) else { return };
        let follow = |i: usize| before.map_or(range[i], |b| b[i] + 0.15 * (range[i] - b[i]));
        self.range = [follow(0), follow(1)];
        let span = (self.range[1] - self.range[0]).max(f32::MIN_POSITIVE);
        let code = |d: &f32| ((d - self.range[0]) / span * 255.0).clamp(0.0, 255.0).round() as u8;
        self.codes = depths.iter().map(code).collect();
    }
}

/// From a pixel and inverse depth in one camera to those in another.
///
/// The point at inverse depth d along the ray r of a pixel lies at s·R·r/d + t for the other camera; times d, which
/// changes no pixel, that is s·R·r + t·d: no division but the last one.
struct Projection {
    ray_from_pixel: Matrix3<f32>,
    translation: Vector3<f32>,
    camera: [f32; 4],
}

impl Projection {
    fn new(to: &Pinhole, from: &Pinhole, to_from_from: &Sim3) -> Self {
        let ray = Matrix3::new(
            1.0 / from.fx,
            0.0,
            -from.cx / from.fx, //
            0.0,
            1.0 / from.fy,
            -from.cy / from.fy, //
            0.0,
            0.0,
            1.0,
        );
        let rotation = to_from_from.rigid().rotation_matrix() * to_from_from.scale;
        Self {
            ray_from_pixel: (rotation * ray).cast(),
            translation: to_from_from.translation.cast(),
            camera: [to.fx, to.fy, to.cx, to.cy].map(|v| v as f32),
        }
    }

    /// Pixel and inverse depth; `None` behind the camera.
    fn point(&self, [x, y, d]: [f32; 3]) -> Option<[f32; 3]> {
        let at = self.ray_from_pixel * Vector3::new(x, y, 1.0) + self.translation * d;
        let [fx, fy, cx, cy] = self.camera;
        // Also refuses NaN.
        (at.z > 1e-9 && d > 0.0).then(|| [fx * at.x / at.z + cx, fy * at.y / at.z + cy, d / at.z])
    }
}

/// The 3 and 97 % quantiles; `None` of too few.
fn bulk(depths: &[f32]) -> Option<[f32; 2]> {
    if depths.len() < 20 {
        return None;
    }
    let mut sample: Vec<f32> = depths.iter().step_by(depths.len().div_ceil(1000)).copied().collect();
    sample.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| sample[((sample.len() - 1) as f64 * share) as usize];
    Some([at(0.03), at(0.97).max(at(0.03) * 1.01)])
}

/// Means of `by × by` pixels.
fn shrunk(image: &GrayImage, by: usize) -> Vec<u8> {
    let (width, height) = (image.width() / by, image.height() / by);
    let mut out = Vec::with_capacity(width * height);
    let mut sums = vec![0u32; width];
    for y in 0..height {
        sums.fill(0);
        for row in (y * by..(y + 1) * by).map(|row| image.row(row)) {
            for (sum, pixels) in sums.iter_mut().zip(row.chunks_exact(by)) {
                *sum += pixels.iter().map(|&p| u32::from(p)).sum::<u32>();
            }
        }
        out.extend(sums.iter().map(|sum| (sum / (by * by) as u32) as u8));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::{CAMERA, dense};
    use super::*;

    #[test]
    fn depths_fall_on_the_pixels_they_came_from() {
        let (image, depth) = dense();
        let chunk = Chunk::new(&CAMERA, &image, None, &depth);
        let mut picture = Picture::new(3, 0.5, &image);
        let seen = VisibleKeyframe { chunk: &chunk, camera_from_keyframe: Sim3::identity() };
        picture.overlay(&CAMERA, &[seen], None);
        assert_eq!(picture.pixels.len(), chunk.len());
        assert_eq!(picture.codes.len(), chunk.len());
        // Inverse depth grows with the row.
        for (pixel, code) in picture.pixels.iter().zip(&picture.codes) {
            let expected = (f32::from(pixel[1]) / CAMERA.height as f32 - 0.03) / 0.94 * 255.0;
            assert!((f32::from(*code) - expected.clamp(0.0, 255.0)).abs() < 6.0, "{pixel:?} {code}");
        }
    }

    #[test]
    fn wide_images_are_shrunk() {
        let image = GrayImage::from_vec(1300, 4, (0..5200).map(|i| (i % 2) as u8 * 100).collect());
        let picture = Picture::new(0, 0.0, &image.expect("the numbers fit"));
        assert_eq!((picture.width, picture.height), (433, 1));
        assert!(picture.grey.iter().all(|&p| (33..=67).contains(&p)));
    }

    #[test]
    fn points_behind_the_camera_are_not_drawn() {
        let (image, depth) = dense();
        let chunk = Chunk::new(&CAMERA, &image, None, &depth);
        let mut picture = Picture::new(0, 0.0, &image);
        let back = Sim3::new(
            nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), std::f64::consts::PI),
            nalgebra::Vector3::zeros(),
            1.0,
        );
        picture.overlay(&CAMERA, &[VisibleKeyframe { chunk: &chunk, camera_from_keyframe: back }], None);
        assert!(picture.pixels.is_empty() && picture.codes.is_empty());
    }
}
