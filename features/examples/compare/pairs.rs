//! Sequences, and which of their images to match.

use eval::{Trajectory, read_trajectory};
use geometry::{Camera, Distortion, GrayImage, Image, Pinhole, RadTan, Se3};
use nalgebra::{Vector2, Vector3};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// An image with what is true of it.
pub struct View {
    pub image: GrayImage,
    pub camera: Camera,
    pub world_from_camera: Se3,
    /// Metres along the optical axis, 0 for none.
    pub depth: Option<Image<f32>>,
}

impl View {
    /// The point at a pixel, in the world.
    pub fn point(&self, pixel: [f32; 2]) -> Option<Vector3<f64>> {
        let depth = self.depth.as_ref()?;
        let (x, y) = (pixel[0].round() as usize, pixel[1].round() as usize);
        let metres = f64::from(if x < depth.width() && y < depth.height() { depth.get(x, y) } else { 0.0 });
        let ray = self.camera.unproject(&Vector2::new(f64::from(pixel[0]), f64::from(pixel[1])))?;
        (metres > 0.0).then(|| self.world_from_camera * (ray * (metres / ray.z)))
    }

    /// Where a point of the world is seen, unless something stands before it.
    pub fn pixel(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let point = self.world_from_camera.inverse() * *point;
        let pixel =
            self.camera.project(&point).filter(|pixel| point.z > 0.0 && self.camera.contains(pixel))?;
        let depth = self.depth.as_ref()?.get(pixel.x.round() as usize, pixel.y.round() as usize);
        (point.z < 1.05 * f64::from(depth)).then_some(pixel)
    }

    /// The share of this view that another sees.
    fn shared(&self, other: &Self) -> f64 {
        let grid =
            (0..24).flat_map(|y| (0..32).map(move |x| [20.0 * x as f32 + 10.0, 20.0 * y as f32 + 10.0]));
        let points: Vec<_> = grid.filter_map(|pixel| self.point(pixel)).collect();
        points.iter().filter(|p| other.pixel(p).is_some()).count() as f64 / points.len().max(1) as f64
    }
}

/// Views, and pairs of them by index.
pub struct Set {
    pub name: String,
    pub views: Vec<View>,
    pub pairs: Vec<(usize, usize)>,
}

pub fn sets(data: &Path) -> Result<Vec<Set>> {
    let mut sets = Vec::new();
    for (name, apart, step) in [
        ("tum_fr1_xyz", 20, 30),
        ("tum_fr1_desk", 15, 25),
        ("kitti00_first201", 4, 8),
        ("kitti09_first350", 4, 12),
    ] {
        let sequence = Sequence::open(data.join(name))?;
        let (mut views, mut pairs) = (Vec::new(), Vec::new());
        for first in (0..sequence.len() - apart).step_by(step) {
            if let (Some(a), Some(b)) = (sequence.view(first)?, sequence.view(first + apart)?) {
                pairs.push((views.len(), views.len() + 1));
                views.extend([a, b]);
            }
        }
        sets.push(Set { name: format!("{name}, {apart} apart"), views, pairs });
    }
    sets.push(near_poses(data, "tum_fr1_xyz", "tum_fr1_desk")?);
    sets.push(shared_views(data, "parking_a", "parking_b")?);
    sets.push(shared_views(data, "parking_a", "parking_c")?);
    sets.push(shared_views(data, "parking_b", "parking_c")?);
    Ok(sets)
}

/// For images of one sequence the nearest pose of another.
fn near_poses(data: &Path, first: &str, second: &str) -> Result<Set> {
    let (first_sequence, second_sequence) =
        (Sequence::open(data.join(first))?, Sequence::open(data.join(second))?);
    let (mut views, mut pairs) = (Vec::new(), Vec::new());
    for a in (0..first_sequence.len()).step_by(20) {
        let Some(pose) = first_sequence.pose(a) else { continue };
        let apart = |b: &usize| {
            let relative = pose.inverse() * second_sequence.pose(*b)?;
            // Half a metre counts like twenty degrees.
            Some(relative.translation.norm() / 0.5 + relative.rotation.angle().to_degrees() / 20.0)
        };
        let nearest = (0..second_sequence.len())
            .step_by(5)
            .filter_map(|b| Some((apart(&b)?, b)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((apart, b)) = nearest else { continue };
        if let (true, Some(a), Some(b)) = (apart < 1.5, first_sequence.view(a)?, second_sequence.view(b)?) {
            pairs.push((views.len(), views.len() + 1));
            views.extend([a, b]);
        }
    }
    Ok(Set { name: format!("{first} and {second}"), views, pairs })
}

/// The pairs of images with true depth that share 25 to 85 % of what they see.
fn shared_views(data: &Path, first: &str, second: &str) -> Result<Set> {
    let mut views = Vec::new();
    let mut ends = Vec::new();
    for name in [first, second] {
        let sequence = Sequence::open(data.join(name))?;
        for i in (0..sequence.len()).step_by(10) {
            views.extend(sequence.view(i)?.filter(|view| view.depth.is_some()));
        }
        ends.push(views.len());
    }
    let shared = |&(a, b): &(usize, usize)| {
        let (a, b) = (&views[a], &views[b]);
        (0.25..0.85).contains(&a.shared(b).min(b.shared(a)))
    };
    let all: Vec<_> =
        (0..ends[0]).flat_map(|a| (ends[0]..ends[1]).map(move |b| (a, b))).filter(shared).collect();
    let step = all.len().div_ceil(40).max(1);
    let pairs = all.into_iter().step_by(step).collect();
    Ok(Set { name: format!("{first} and {second}"), views, pairs })
}

/// A folder of images.
struct Sequence {
    folder: PathBuf,
    camera: Camera,
    truth: Trajectory,
    images: Vec<(f64, String)>,
}

impl Sequence {
    fn open(folder: PathBuf) -> Result<Self> {
        let about = |error: &dyn std::fmt::Display| format!("{}: {error}", folder.display());
        let times = fs::read_to_string(folder.join("times.txt")).map_err(|e| about(&e))?;
        let image = |line: &str| {
            let (time, name) = line.split_once(' ')?;
            Some((time.parse().ok()?, name.trim().to_owned()))
        };
        let images = times.lines().filter_map(image).collect();
        let truth = read_trajectory(&folder.join("groundtruth.txt"))?;
        let camera = camera(&folder.join("camera.yaml"))?;
        Ok(Self { folder, camera, truth, images })
    }

    fn len(&self) -> usize {
        self.images.len()
    }

    fn pose(&self, i: usize) -> Option<Se3> {
        Some(self.truth.pose_at(self.images[i].0, 0.02)?.rigid())
    }

    /// The view of an image; none without a true pose.
    fn view(&self, i: usize) -> Result<Option<View>> {
        let Some(world_from_camera) = self.pose(i) else { return Ok(None) };
        let image = image::open(self.folder.join(&self.images[i].1))?.into_luma8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let image = GrayImage::from_vec(width, height, image.into_raw()).ok_or("an image of another size")?;
        let depth = self.folder.join(format!("depth/{i:06}.png"));
        let depth = if depth.is_file() {
            let metres =
                image::open(depth)?.into_luma16().into_raw().iter().map(|&v| f32::from(v) * 1e-3).collect();
            Image::from_vec(width, height, metres)
        } else {
            None
        };
        Ok(Some(View { image, camera: self.camera, world_from_camera, depth }))
    }
}

/// Reads the few lines of a camera file.
fn camera(file: &Path) -> Result<Camera> {
    let text = fs::read_to_string(file)?;
    let value = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(&format!("{name}:")));
        line.map(|line| line.split('#').next().unwrap_or(line).trim().to_owned())
    };
    let number = |name: &str| -> Result<f64> { Ok(value(name).ok_or("a value is missing")?.parse()?) };
    let intrinsics = Pinhole {
        width: number("width")? as usize,
        height: number("height")? as usize,
        fx: number("fx")?,
        fy: number("fy")?,
        cx: number("cx")?,
        cy: number("cy")?,
    };
    let terms = value("distortion").unwrap_or_default();
    let terms: Vec<f64> =
        terms.trim_matches(['[', ']']).split(',').filter_map(|t| t.trim().parse().ok()).collect();
    let distortion =
        if terms.is_empty() { Distortion::None } else { Distortion::RadTan(RadTan::new(&terms)?) };
    Ok(Camera::new(intrinsics, distortion)?)
}
