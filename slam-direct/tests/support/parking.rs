//! Reads the rendered sequences with exact depth.

use geometry::{GrayImage, Image, Pinhole, Random, Se3};
use slam_direct::SeedPoint;
use std::path::{Path, PathBuf};

/// Errors are texts for the person who runs the measurement.
pub type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn fail<T>(text: String) -> Result<T> {
    Err(text.into())
}

/// Backbone points simulated per keyframe.
const BACKBONE: usize = 800;

/// A rendered sequence with exact poses and, for some frames, exact depth.
pub struct Sequence {
    /// Its folder.
    pub folder: PathBuf,
    /// Its camera.
    pub camera: Pinhole,
    /// The pose of each frame.
    pub world_from_camera: Vec<Se3>,
}

impl Sequence {
    /// Reads camera and poses.
    pub fn open(folder: &Path) -> Result<Self> {
        let camera_text = std::fs::read_to_string(folder.join("camera.yaml"))?;
        let value = |key: &str| -> Result<f64> {
            let line = camera_text.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(':'));
            let Some(line) = line else {
                return fail(format!("{}/camera.yaml: no {key}", folder.display()));
            };
            Ok(line.trim().parse()?)
        };
        let camera = Pinhole {
            width: value("width")? as usize,
            height: value("height")? as usize,
            fx: value("fx")?,
            fy: value("fy")?,
            cx: value("cx")?,
            cy: value("cy")?,
        };
        let mut world_from_camera = Vec::new();
        for line in std::fs::read_to_string(folder.join("groundtruth.txt"))?.lines() {
            if line.starts_with('#') {
                continue;
            }
            let numbers: std::result::Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
            let numbers = numbers?;
            let Ok(pose) = <[f64; 7]>::try_from(&numbers[1..]) else {
                return fail(format!("{}/groundtruth.txt: not 8 numbers: {line}", folder.display()));
            };
            world_from_camera.push(Se3::from_tum(pose));
        }
        Ok(Self { folder: folder.to_path_buf(), camera, world_from_camera })
    }

    /// The grey image of a frame.
    pub fn image(&self, index: usize) -> Result<GrayImage> {
        let path = self.folder.join(format!("images/{index:06}.jpg"));
        let luma = image::open(&path)?.into_luma8();
        let (width, height) = (luma.width() as usize, luma.height() as usize);
        GrayImage::from_vec(width, height, luma.into_raw()).ok_or_else(|| "odd image".into())
    }

    /// Exact inverse depth, 0 for none; `None` when there is no file.
    pub fn inverse_depth(&self, index: usize) -> Result<Option<Image<f32>>> {
        let path = self.folder.join(format!("depth/{index:06}.png"));
        if !path.exists() {
            return Ok(None);
        }
        let depth = image::open(&path)?.into_luma16();
        let (width, height) = (depth.width() as usize, depth.height() as usize);
        let inverse = |&mm: &u16| if mm == 0 { 0.0 } else { 1000.0 / mm as f32 };
        Ok(Image::from_vec(width, height, depth.iter().map(inverse).collect()))
    }
}

/// Points as a tracker would have them: 1 % noise, 2 % wrong.
pub fn backbone(truth: &Image<f32>, random: &mut Random) -> Vec<SeedPoint> {
    let mut points = Vec::new();
    while points.len() < BACKBONE {
        let x = random.unit() as f32 * (truth.width() - 1) as f32;
        let y = random.unit() as f32 * (truth.height() - 1) as f32;
        let exact = truth.get(x as usize, y as usize);
        if exact == 0.0 {
            continue;
        }
        let wrong = random.unit() < 0.02;
        let factor = if wrong { 0.5 + random.unit() as f32 } else { 1.0 + 0.01 * random.normal() as f32 };
        let variance = (0.01 * exact) * (0.01 * exact);
        points.push(SeedPoint { pixel: [x, y], inverse_depth: exact * factor, variance });
    }
    points
}
