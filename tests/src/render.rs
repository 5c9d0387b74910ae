//! The renderer: one ray a pixel against boxes, mip-mapped textures, more rays where edges show.

use crate::world::FACE_SHIFT;
use crate::{Cuboid, World};
use geometry::{GrayImage, Image, Pinhole, Random, Se3};
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Side of the square of pixels that shares one list of boxes.
const TILE: usize = 32;
/// Rays per side of a pixel in which an outline shows.
const EDGE_RAYS: usize = 3;
/// Intensity where no ray meets anything.
const SKY: f32 = 200.0;
/// Nothing nearer than this is seen, metres.
const NEAR: f64 = 0.02;
/// Brightness of the faces −x +x −y +y −z +z of every box.
const SHADE: [f32; 6] = [0.82, 0.9, 1.0, 0.6, 0.96, 0.76];

/// What a pinhole camera at `world_from_camera` sees: the grey image, and the exact inverse depth 1/z [1/m]
/// along the ray of each pixel's centre, 0 where there is only sky.
pub fn render(world: &World, camera: &Pinhole, world_from_camera: &Se3) -> (GrayImage, Image<f32>) {
    let mut canvas = Canvas::new(camera);
    canvas.paint(world, camera, world_from_camera, 0..camera.height);
    let data = canvas.intensity.data().iter().map(|&v| (v + 0.5) as u8).collect();
    let image = GrayImage::from_vec(camera.width, camera.height, data).expect("one value per pixel");
    (image, canvas.inverse_depth)
}

/// Intensities of these rows of what a camera sees, grey levels, row by row.
pub(crate) fn render_rows(
    world: &World,
    camera: &Pinhole,
    world_from_camera: &Se3,
    rows: Range<usize>,
) -> Vec<f32> {
    let mut canvas = Canvas::new(camera);
    canvas.paint(world, camera, world_from_camera, rows.clone());
    canvas.intensity.data()[rows.start * camera.width..rows.end * camera.width].to_vec()
}

/// What is painted.
struct Canvas {
    intensity: Image<f32>,
    inverse_depth: Image<f32>,
    /// Which face of which box each pixel shows.
    face_seen: Image<u32>,
}

impl Canvas {
    fn new(camera: &Pinhole) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self {
            intensity: Image::filled(width, height, SKY),
            inverse_depth: Image::filled(width, height, 0.0f32),
            face_seen: Image::filled(width, height, u32::MAX),
        }
    }

    /// Paints these rows, and leaves the others.
    fn paint(&mut self, world: &World, camera: &Pinhole, world_from_camera: &Se3, rows: Range<usize>) {
        let mut views: Vec<View> =
            world.cuboids.iter().filter_map(|c| View::new(c, camera, world_from_camera)).collect();
        views.sort_by(|a, b| a.nearest.total_cmp(&b.nearest));
        let (width, height) = (camera.width, camera.height);
        let caster = Caster { world, camera, views: &views };
        let mut candidates = Vec::new();
        // Outlines are told by the neighbours above and below as well.
        let around = rows.start.saturating_sub(1)..(rows.end + 1).min(height);
        for_each_tile(width, around, |x0, of_tile| {
            caster.candidates(x0, of_tile.start, &mut candidates);
            for y in of_tile {
                for x in x0..(x0 + TILE).min(width) {
                    if let Some(hit) = caster.cast(&candidates, x as f32, y as f32) {
                        self.intensity.set(x, y, caster.shade(&hit));
                        self.inverse_depth.set(x, y, 1.0 / hit.depth);
                        self.face_seen.set(x, y, (hit.view * 6 + hit.face) as u32);
                    }
                }
            }
        });
        for_each_tile(width, rows, |x0, of_tile| {
            caster.candidates(x0, of_tile.start, &mut candidates);
            for y in of_tile {
                for x in x0..(x0 + TILE).min(width) {
                    if on_outline(&self.face_seen, x, y) {
                        self.intensity.set(x, y, caster.mean_over_pixel(&candidates, x, y));
                    }
                }
            }
        });
    }
}

/// An image with normally distributed noise of this standard deviation, grey levels; another seed gives other noise.
pub fn with_noise(image: &GrayImage, deviation: f64, seed: u64) -> GrayImage {
    let mut random = Random::new(seed);
    let mut noisy = image.clone();
    for pixel in noisy.data_mut() {
        *pixel = (f64::from(*pixel) + deviation * random.normal()).round().clamp(0.0, 255.0) as u8;
    }
    noisy
}

fn for_each_tile(width: usize, rows: Range<usize>, mut work: impl FnMut(usize, Range<usize>)) {
    for y in rows.clone().step_by(TILE) {
        for x in (0..width).step_by(TILE) {
            work(x, y..(y + TILE).min(rows.end));
        }
    }
}

/// Whether a neighbour of the pixel shows another face.
fn on_outline(face_seen: &Image<u32>, x: usize, y: usize) -> bool {
    let face = face_seen.get(x, y);
    (x > 0 && face_seen.get(x - 1, y) != face)
        || (x + 1 < face_seen.width() && face_seen.get(x + 1, y) != face)
        || (y > 0 && face_seen.get(x, y - 1) != face)
        || (y + 1 < face_seen.height() && face_seen.get(x, y + 1) != face)
}

/// A box as this camera sees it.
struct View<'a> {
    cuboid: &'a Cuboid,
    /// Turns ray directions into the box's axes.
    rotation: Matrix3<f32>,
    /// The camera's centre in the box's axes.
    origin: Vector3<f32>,
    half: Vector3<f32>,
    /// Pixels it may cover: left, top, right, bottom.
    bounds: [f64; 4],
    /// Depth that no point of it is nearer than, metres.
    nearest: f32,
}

impl<'a> View<'a> {
    /// `None` when the box is out of sight.
    fn new(cuboid: &'a Cuboid, camera: &Pinhole, world_from_camera: &Se3) -> Option<Self> {
        let cuboid_from_camera = cuboid.world_from_cuboid.inverse() * *world_from_camera;
        let corners = corners(cuboid, &cuboid_from_camera.inverse());
        let bounds = bounds(camera, &corners)?;
        // What single precision rounds is less than a thousandth of it.
        let nearest = 0.999 * corners.iter().map(|c| c.z).fold(f64::INFINITY, f64::min).max(0.0);
        Some(Self {
            cuboid,
            rotation: cuboid_from_camera.rotation_matrix().cast(),
            origin: cuboid_from_camera.translation.cast(),
            half: cuboid.half.cast(),
            bounds,
            nearest: nearest as f32,
        })
    }
}

/// The corners of a box in the camera's frame.
fn corners(cuboid: &Cuboid, camera_from_cuboid: &Se3) -> [Vector3<f64>; 8] {
    let sign = |bit: usize, i: usize| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
    std::array::from_fn(|i| {
        let signs = Vector3::new(sign(0, i), sign(1, i), sign(2, i));
        *camera_from_cuboid * cuboid.half.component_mul(&signs)
    })
}

/// The rectangle of pixels a box with these corners may cover; `None` when it lies outside the image or behind the camera.
fn bounds(camera: &Pinhole, corners: &[Vector3<f64>; 8]) -> Option<[f64; 4]> {
    if corners.iter().all(|c| c.z < NEAR) {
        return None;
    }
    let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for corner in corners {
        if corner.z < NEAR {
            return Some([0.0, 0.0, camera.width as f64, camera.height as f64]);
        }
        let pixel = camera.project(corner);
        bounds =
            [bounds[0].min(pixel.x), bounds[1].min(pixel.y), bounds[2].max(pixel.x), bounds[3].max(pixel.y)];
    }
    let visible = bounds[2] >= -1.0
        && bounds[3] >= -1.0
        && bounds[0] <= camera.width as f64
        && bounds[1] <= camera.height as f64;
    visible.then_some(bounds)
}

/// Where a ray meets a box.
struct Hit {
    view: usize,
    /// −x +x −y +y −z +z as 0–5.
    face: usize,
    /// Along the optical axis, metres.
    depth: f32,
    /// In the box's axes.
    point: Vector3<f32>,
    /// |cosine| between ray and face normal.
    cosine: f32,
}

struct Caster<'a> {
    world: &'a World,
    camera: &'a Pinhole,
    views: &'a [View<'a>],
}

impl Caster<'_> {
    /// The boxes that a pixel of the tile at `(x0, y0)` may show, the nearest first.
    fn candidates(&self, x0: usize, y0: usize, candidates: &mut Vec<usize>) {
        let (left, top) = (x0 as f64 - 1.0, y0 as f64 - 1.0);
        let (right, bottom) = ((x0 + TILE) as f64, (y0 + TILE) as f64);
        candidates.clear();
        candidates.extend((0..self.views.len()).filter(|&i| {
            let b = &self.views[i].bounds;
            b[0] <= right && b[1] <= bottom && b[2] >= left && b[3] >= top
        }));
    }

    /// The nearest face on the ray through `(x, y)`.
    fn cast(&self, candidates: &[usize], x: f32, y: f32) -> Option<Hit> {
        let camera = self.camera;
        let ray = Vector3::new(
            (x - camera.cx as f32) / camera.fx as f32,
            (y - camera.cy as f32) / camera.fy as f32,
            1.0,
        );
        let mut nearest: Option<(usize, usize, f32)> = None;
        for &i in candidates {
            let view = &self.views[i];
            if nearest.is_some_and(|(_, _, depth)| depth < view.nearest) {
                break;
            }
            let direction = view.rotation * ray;
            let Some((axis, depth)) = enter(&view.origin, &direction, &view.half) else { continue };
            if nearest.is_none_or(|(_, _, d)| depth < d) {
                nearest = Some((i, axis, depth));
            }
        }
        let (i, axis, depth) = nearest?;
        let view = &self.views[i];
        let direction = view.rotation * ray;
        Some(Hit {
            view: i,
            face: 2 * axis + usize::from(direction[axis] < 0.0),
            depth,
            point: view.origin + direction * depth,
            cosine: direction[axis].abs() / ray.norm(),
        })
    }

    fn shade(&self, hit: &Hit) -> f32 {
        let cuboid = self.views[hit.view].cuboid;
        let axis = hit.face / 2;
        let (u, v) = match axis {
            0 => (hit.point.z, hit.point.y),
            1 => (hit.point.x, hit.point.z),
            _ => (hit.point.x, hit.point.y),
        };
        // Opposite and neighbouring faces show other parts of the texture.
        let shift = FACE_SHIFT * hit.face as f32;
        let texels = 1.0 / cuboid.texel as f32;
        // A pixel covers depth/f across and that over the cosine along: the mip level takes their geometric mean.
        let footprint = hit.depth / self.camera.fx as f32 / hit.cosine.max(0.02).sqrt() * texels;
        let texture = &self.world.textures[cuboid.texture];
        let (u, v) = (u * texels + cuboid.offset[0] + shift, v * texels + cuboid.offset[1] + shift);
        texture.sample(u, v, footprint) * SHADE[hit.face]
    }

    fn mean_over_pixel(&self, candidates: &[usize], x: usize, y: usize) -> f32 {
        let at = |i: usize| (i as f32 + 0.5) / EDGE_RAYS as f32 - 0.5;
        let mut sum = 0.0;
        for i in 0..EDGE_RAYS * EDGE_RAYS {
            let (sx, sy) = (x as f32 + at(i % EDGE_RAYS), y as f32 + at(i / EDGE_RAYS));
            sum += self.cast(candidates, sx, sy).map_or(SKY, |hit| self.shade(&hit));
        }
        sum / (EDGE_RAYS * EDGE_RAYS) as f32
    }
}

/// Where a ray from outside enters the box of half extents `half` around the origin: the axis of the face, and
/// how many `direction`s away it is.
fn enter(origin: &Vector3<f32>, direction: &Vector3<f32>, half: &Vector3<f32>) -> Option<(usize, f32)> {
    let (mut axis, mut near, mut far) = (0, f32::NEG_INFINITY, f32::INFINITY);
    for i in 0..3 {
        let inverse = 1.0 / direction[i];
        let (a, b) = ((-half[i] - origin[i]) * inverse, (half[i] - origin[i]) * inverse);
        let (first, last) = if a < b { (a, b) } else { (b, a) };
        if first > near {
            (axis, near) = (i, first);
        }
        far = far.min(last);
    }
    (near <= far && near > NEAR as f32).then_some((axis, near))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 210.0, fy: 210.0, cx: 159.5, cy: 119.5 };

    /// The image of one pose, moved to another by the exact depth, must look like that other's image.
    #[test]
    fn depth_and_intensity_agree_between_views() {
        let world = World::yard(1);
        let poses = trajectory::sideways(30, 3.0);
        let (first, inverse_depth) = render(&world, &CAMERA, &poses[0]);
        let (second, _) = render(&world, &CAMERA, &poses[3]);
        let second_from_first = poses[3].inverse() * poses[0];
        let mut differences = Vec::new();
        for y in 0..CAMERA.height {
            for x in 0..CAMERA.width {
                let d = inverse_depth.get(x, y) as f64;
                if d == 0.0 {
                    continue;
                }
                let point = second_from_first * (CAMERA.unproject(x as f64, y as f64) / d);
                let pixel = CAMERA.project(&point).cast::<f32>();
                if second.contains(pixel.x, pixel.y, 1.0) {
                    differences.push((second.bilinear(pixel.x, pixel.y) - first.get(x, y) as f32).abs());
                }
            }
        }
        assert!(differences.len() > 50_000, "{} pixels in both views", differences.len());
        differences.sort_by(f32::total_cmp);
        let median = differences[differences.len() / 2];
        let ninth_decile = differences[differences.len() * 9 / 10];
        assert!(median < 2.0 && ninth_decile < 10.0, "median {median}, 90 % {ninth_decile}");
    }

    #[test]
    fn depth_of_the_wall_ahead_is_exact() {
        let world = World::yard(1);
        let pose = Se3::new(nalgebra::UnitQuaternion::identity(), Vector3::new(0.0, -4.0, 5.0));
        let (_, inverse_depth) = render(&world, &CAMERA, &pose);
        assert!((inverse_depth.get(160, 120) - 1.0 / 7.0).abs() < 1e-6);
    }

    #[test]
    fn rows_are_those_of_the_whole_image() {
        let (world, pose) = (World::yard(1), trajectory::sideways(30, 3.0)[7]);
        let (whole, _) = render(&world, &CAMERA, &pose);
        for rows in [0..10, 115..125, 230..240] {
            let painted = render_rows(&world, &CAMERA, &pose, rows.clone());
            let expected = &whole.data()[rows.start * CAMERA.width..rows.end * CAMERA.width];
            assert!(painted.iter().zip(expected).all(|(a, b)| (a + 0.5) as u8 == *b), "{rows:?}");
        }
    }

    #[test]
    fn the_same_call_gives_the_same_image() {
        let pose = trajectory::sideways(2, 1.0)[1];
        assert_eq!(render(&World::yard(3), &CAMERA, &pose), render(&World::yard(3), &CAMERA, &pose));
        assert_ne!(render(&World::yard(3), &CAMERA, &pose).0, render(&World::yard(4), &CAMERA, &pose).0);
    }
}
