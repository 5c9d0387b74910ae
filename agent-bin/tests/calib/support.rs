//! A chessboard drawn as a known camera sees it.

use crate::common::{arg, loopbox, stderr};
use calib::CalibrationFile;
use geometry::{Camera, Distortion, Pinhole, RadTan, Se3};
use image::{GrayImage, Luma};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use std::path::{Path, PathBuf};

pub const BOARD: &str = "chessboard:9x6:0.03";
const SQUARE: f64 = 0.03;
/// Rays per side of a pixel.
const RAYS: usize = 3;

/// The camera that sees it.
pub fn camera() -> Camera {
    let pinhole = Pinhole { width: 400, height: 300, fx: 300.0, fy: 301.0, cx: 203.0, cy: 146.0 };
    Camera::new(pinhole, Distortion::RadTan(RadTan::new(&[-0.2, 0.05, 0.001, -0.0005]).unwrap())).unwrap()
}

/// Draws boards: holds the rays of the camera.
pub struct Artist(Vec<Vector3<f64>>);

impl Artist {
    pub fn new() -> Self {
        let camera = camera();
        let Pinhole { width, height, .. } = *camera.intrinsics();
        let at = |i: usize| (i as f64 + 0.5) / RAYS as f64 - 0.5;
        let pixels =
            (0..height * RAYS).flat_map(|v| (0..width * RAYS).map(move |u| Vector2::new(at(u), at(v))));
        Self(pixels.map(|pixel| camera.unproject(&pixel).unwrap()).collect())
    }

    /// What the camera sees with the board's middle at `position`, turned by `tilt`.
    pub fn draw(&self, position: [f64; 3], tilt: [f64; 3]) -> GrayImage {
        let Pinhole { width, height, .. } = *camera().intrinsics();
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(tilt));
        let middle = Vector3::new(4.0 * SQUARE, 2.5 * SQUARE, 0.0);
        let board_from_camera = Se3::new(rotation, Vector3::from(position) - rotation * middle).inverse();
        let shade = |ray: &Vector3<f64>| {
            let direction = board_from_camera.rotation * ray;
            let hit =
                board_from_camera.translation - direction * (board_from_camera.translation.z / direction.z);
            shade(hit.x / SQUARE, hit.y / SQUARE)
        };
        GrayImage::from_fn(width as u32, height as u32, |x, y| {
            let mut sum = 0.0;
            for v in 0..RAYS {
                for u in 0..RAYS {
                    sum += shade(&self.0[(y as usize * RAYS + v) * width * RAYS + x as usize * RAYS + u]);
                }
            }
            Luma([(sum / (RAYS * RAYS) as f64) as u8])
        })
    }

    /// A folder with the usual views: each tilt, near and far, all over the image.
    pub fn folder(&self, folder: &Path) {
        for (i, (position, tilt)) in poses().into_iter().enumerate() {
            self.draw(position, tilt).save(folder.join(format!("{i:02}.png"))).unwrap();
        }
    }
}

/// Grey level of a place on the board, in squares from its first inner corner: ten by seven squares, a white margin,
/// grey around.
fn shade(x: f64, y: f64) -> f64 {
    if !(-2.0..=10.0).contains(&x) || !(-2.0..=7.0).contains(&y) {
        return 110.0;
    }
    let inside = (-1.0..9.0).contains(&x) && (-1.0..6.0).contains(&y);
    let black = (x.floor() as i64 + y.floor() as i64).rem_euclid(2) == 0;
    if inside && black { 25.0 } else { 225.0 }
}

/// The usual views: positions of the board's middle, and its tilts.
pub fn poses() -> Vec<([f64; 3], [f64; 3])> {
    let tilts = [[0.5, 0.0, 0.1], [-0.5, 0.1, 0.0], [0.1, 0.55, 0.0], [0.0, -0.55, -0.1]];
    let places = [[0.0, 0.0], [-0.07, -0.05], [0.07, -0.05], [-0.07, 0.05], [0.07, 0.05]];
    let pose = |i: usize| {
        let [x, y] = places[i % 5];
        ([x, y, 0.36 + 0.03 * (i % 4) as f64], tilts[i % 4])
    };
    (0..12).map(pose).collect()
}

/// Calibrates a folder; what was written.
pub fn calibrated(folder: &Path, board: &str, more: &[&str]) -> (CalibrationFile, serde_json::Value) {
    let out = folder.join("camera.yaml");
    let args = [&["calib", "--board", board, arg(folder), "--out", arg(&out), "--json"], more].concat();
    let output = loopbox(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    (calib::read_camera(&out).unwrap(), serde_json::from_slice(&output.stdout).unwrap())
}

/// A parameter and its uncertainty.
pub fn parameter(numbers: &serde_json::Value, name: &str) -> (f64, f64) {
    let all = numbers["parameters"].as_array().unwrap();
    let found = all.iter().find(|p| p["name"] == name).unwrap();
    (found["value"].as_f64().unwrap(), found["sigma"].as_f64().unwrap())
}

/// The images of a shared data set, or a loud word that they are not here.
pub fn shared(name: &str) -> Option<PathBuf> {
    let default_folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = std::env::var_os("LOOPBOX_DATA").map_or(default_folder, PathBuf::from).join(name);
    if !folder.is_dir() {
        println!("SKIPPED: {} is not there; LOOPBOX_DATA names the folder of {name}", folder.display());
        return None;
    }
    Some(folder)
}
