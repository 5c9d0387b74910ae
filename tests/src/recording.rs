//! Recordings: rendered frames, and their files in loopbox's folder format.

use crate::render::render_rows;
use crate::{World, render, with_noise};
use geometry::{GrayImage, Pinhole, Se3};
use image::{ExtendedColorType, ImageEncoder, codecs::jpeg::JpegEncoder, codecs::png};
use rayon::prelude::*;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::{fs, io};

/// One frame of a recording.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Seconds.
    pub timestamp: f64,
    /// Where the camera was, metres.
    pub world_from_camera: Se3,
    /// What it saw.
    pub image: Arc<GrayImage>,
}

/// How images are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Without loss.
    Png,
    /// Quality 95.
    Jpeg,
}

impl Encoding {
    /// The file name extension.
    pub fn extension(self) -> &'static str {
        match self {
            Encoding::Png => "png",
            Encoding::Jpeg => "jpg",
        }
    }

    /// The bytes of an image file.
    pub fn encode(self, image: &GrayImage) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let (width, height) = (image.width() as u32, image.height() as u32);
        let color = ExtendedColorType::L8;
        match self {
            Encoding::Png => {
                let (compression, filter) = (png::CompressionType::Fast, png::FilterType::Sub);
                png::PngEncoder::new_with_quality(&mut bytes, compression, filter).write_image(
                    image.data(),
                    width,
                    height,
                    color,
                )
            }
            Encoding::Jpeg => {
                JpegEncoder::new_with_quality(&mut bytes, 95).write_image(image.data(), width, height, color)
            }
        }
        .map_err(io::Error::other)?;
        Ok(bytes)
    }
}

/// How a camera's rows come to their light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// From the first row to the last, seconds.
    pub readout: f64,
    /// That each row gathers light, seconds.
    pub exposure: f64,
}

/// Frames of one camera with their true poses. Tests change `shots` at will before they write them.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The camera.
    pub camera: Pinhole,
    /// The frames in order of time.
    pub shots: Vec<Shot>,
}

impl Recording {
    /// A camera of 320 × 240 pixels and 75° horizontal field of view.
    pub const SMALL_CAMERA: Pinhole =
        Pinhole { width: 320, height: 240, fx: 210.0, fy: 210.0, cx: 159.5, cy: 119.5 };

    /// Renders a frame for each pose of `path`, `rate` a second from time 0.
    pub fn render(world: &World, camera: Pinhole, path: &[Se3], rate: f64) -> Self {
        let shot = |(i, pose): (usize, &Se3)| Shot {
            timestamp: i as f64 / rate,
            world_from_camera: *pose,
            image: Arc::new(render(world, &camera, pose).0),
        };
        Self { camera, shots: path.par_iter().enumerate().map(shot).collect() }
    }

    /// The same by a rolling shutter, which takes `readout` seconds from the first row to the last; a pose of `path` is that
    /// of the middle row.
    pub fn render_rolling(world: &World, camera: Pinhole, path: &[Se3], rate: f64, readout: f64) -> Self {
        Self::render_exposed(world, camera, path, rate, Shutter { readout, exposure: 0.0 })
    }

    /// The same by a rolling shutter whose rows gather light while the camera moves; a pose of `path` is that of the middle of
    /// the middle row's exposure.
    pub fn render_exposed(world: &World, camera: Pinhole, path: &[Se3], rate: f64, shutter: Shutter) -> Self {
        // Within one of so many bands the camera stands still, and so often it is looked at while one is exposed.
        const BANDS: usize = 24;
        const MOMENTS: usize = 2;
        let moments = if shutter.exposure > 0.0 { MOMENTS } else { 1 };
        let middle = |i: usize, count: usize| (i as f64 + 0.5) / count as f64 - 0.5;
        let shot = |(i, pose): (usize, &Se3)| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(path.len() - 1));
            let seconds = (after - before) as f64 / rate;
            let motion = (path[before].inverse() * path[after]).log() / seconds.max(1e-9);
            let mut data = Vec::with_capacity(camera.width * camera.height);
            for band in 0..BANDS {
                let rows = camera.height * band / BANDS..camera.height * (band + 1) / BANDS;
                let mut light = vec![0.0; rows.len() * camera.width];
                for moment in 0..moments {
                    let time =
                        shutter.readout * middle(band, BANDS) + shutter.exposure * middle(moment, moments);
                    let seen =
                        render_rows(world, &camera, &(*pose * Se3::exp(&(motion * time))), rows.clone());
                    light.iter_mut().zip(&seen).for_each(|(sum, value)| *sum += value / moments as f32);
                }
                data.extend(light.iter().map(|value| (value + 0.5) as u8));
            }
            let image = GrayImage::from_vec(camera.width, camera.height, data).expect("one value per pixel");
            Shot { timestamp: i as f64 / rate, world_from_camera: *pose, image: Arc::new(image) }
        };
        Self { camera, shots: path.par_iter().enumerate().map(shot).collect() }
    }

    /// The same with normally distributed noise of this standard deviation, grey levels, another in each frame; another seed gives other noise.
    #[must_use]
    pub fn with_noise(mut self, deviation: f64, seed: u64) -> Self {
        self.shots.par_iter_mut().enumerate().for_each(|(i, shot)| {
            let seed = seed.wrapping_mul(0x2545_f491).wrapping_add(i as u64);
            shot.image = Arc::new(with_noise(&shot.image, deviation, seed));
        });
        self
    }

    /// Length of the camera's path, metres.
    pub fn path_length(&self) -> f64 {
        let poses: Vec<Se3> = self.shots.iter().map(|s| s.world_from_camera).collect();
        crate::trajectory::length(&poses)
    }

    /// Writes `images/NNNNNN.*`, `times.txt`, `groundtruth.txt` and `camera.yaml` into `folder`, which is made.
    pub fn write(&self, folder: &Path, encoding: Encoding) -> io::Result<()> {
        fs::create_dir_all(folder.join("images"))?;
        let name = |i: usize| format!("images/{i:06}.{}", encoding.extension());
        self.shots
            .par_iter()
            .enumerate()
            .try_for_each(|(i, shot)| fs::write(folder.join(name(i)), encoding.encode(&shot.image)?))?;
        let mut times = String::from("# timestamp[s] image\n");
        for (i, shot) in self.shots.iter().enumerate() {
            let _ = writeln!(times, "{:.6} {}", shot.timestamp, name(i));
        }
        fs::write(folder.join("times.txt"), times)?;
        fs::write(folder.join("groundtruth.txt"), self.ground_truth())?;
        fs::write(folder.join("camera.yaml"), self.camera_yaml())
    }

    /// The true poses in TUM form.
    pub fn ground_truth(&self) -> String {
        let mut text = String::from("# timestamp[s] tx ty tz qx qy qz qw : world_from_camera, metres\n");
        for shot in &self.shots {
            let [tx, ty, tz, qx, qy, qz, qw] = shot.world_from_camera.to_tum();
            let _ = writeln!(
                text,
                "{:.6} {tx:.9} {ty:.9} {tz:.9} {qx:.9} {qy:.9} {qz:.9} {qw:.9}",
                shot.timestamp
            );
        }
        text
    }

    /// The camera in the form of `camera.yaml`.
    pub fn camera_yaml(&self) -> String {
        let c = &self.camera;
        format!(
            "model: pinhole\nwidth: {}\nheight: {}\nfx: {:?}\nfy: {:?}\ncx: {:?}\ncy: {:?}\ndistortion: []\n",
            c.width, c.height, c.fx, c.fy, c.cx, c.cy
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory;

    #[test]
    fn a_camera_that_stands_still_knows_no_shutter() {
        let (world, path) = (World::yard(1), vec![trajectory::sideways(3, 1.0)[1]; 3]);
        let global = Recording::render(&world, Recording::SMALL_CAMERA, &path, 10.0);
        let shutter = Shutter { readout: 0.02, exposure: 0.01 };
        let rolling = Recording::render_exposed(&world, Recording::SMALL_CAMERA, &path, 10.0, shutter);
        let (a, b) = (global.shots[1].image.data(), rolling.shots[1].image.data());
        assert!(a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1));
    }

    #[test]
    fn what_moves_by_is_blurred() {
        let (world, path) = (World::yard(1), trajectory::sideways(40, 3.0));
        let sharp = Recording::render(&world, Recording::SMALL_CAMERA, &path[..3], 30.0);
        let shutter = Shutter { readout: 0.0, exposure: 0.03 };
        let blurred = Recording::render_exposed(&world, Recording::SMALL_CAMERA, &path[..3], 30.0, shutter);
        let slope = |shot: &Shot| {
            shot.image.data().windows(2).map(|w| f64::from(w[1].abs_diff(w[0])).powi(2)).sum::<f64>()
        };
        assert!(slope(&blurred.shots[1]) < 0.7 * slope(&sharp.shots[1]));
    }

    #[test]
    fn a_written_recording_has_all_its_files() -> io::Result<()> {
        let recording =
            Recording::render(&World::yard(1), Recording::SMALL_CAMERA, &trajectory::sideways(3, 1.0), 10.0);
        let folder = tempfile::tempdir()?;
        recording.write(folder.path(), Encoding::Png)?;
        let times = fs::read_to_string(folder.path().join("times.txt"))?;
        assert_eq!(times.lines().nth(3), Some("0.200000 images/000002.png"));
        assert_eq!(fs::read_to_string(folder.path().join("groundtruth.txt"))?.lines().count(), 4);
        let image =
            image::open(folder.path().join("images/000001.png")).map_err(io::Error::other)?.to_luma8();
        assert_eq!(image.as_raw(), recording.shots[1].image.data());
        Ok(())
    }
}
