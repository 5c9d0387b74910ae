//! RGB-D folders: an image, a depth image and a pose for each keyframe.

use super::build::{self, Built, Posed};
use super::{ImportOptions, Layout};
use anyhow::{Context, Result, bail, ensure};
use calib::read_camera;
use eval::{DEFAULT_MAX_DIFF, read_trajectory};
use geometry::{Camera, Image, Se3, Undistorter};
use map::Keyframe;
use nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion};
use rayon::prelude::*;
use sources::pictures::read_depth_image;
use sources::{images_in, timed_images};
use std::path::{Path, PathBuf};

/// The end of the name of an image of 7-Scenes; its depth image and pose are called alike.
const COLOR: &str = ".color.png";

/// Standard deviation of an inverse depth that a structured-light camera measures, 1/m: 1.42 mm at 1 m, growing with the
/// square of the distance (Khoshelham & Elberink, "Accuracy and Resolution of Kinect Depth Data", Sensors 2012, §4.2).
const INVERSE_DEPTH_DEVIATION: f64 = 1.425e-3;
/// Its floor, in parts: rectification and registration to the colour image are no better.
const MIN_DEVIATION: f64 = 0.005;
/// 7-Scenes marks pixels without depth by this value.
const NO_DEPTH: u16 = u16::MAX;

/// An image with its depth image and pose.
struct Shot {
    timestamp: f64,
    image: PathBuf,
    depth: PathBuf,
    world_from_camera: Se3,
}

/// Whether there are images of 7-Scenes in a folder.
pub(super) fn has_scene_frames(folder: &Path) -> bool {
    scene_images(folder).is_ok_and(|images| !images.is_empty())
}

/// Makes the keyframes of a folder.
pub(super) fn read(folder: &Path, layout: Layout, options: &ImportOptions) -> Result<Built> {
    let camera = camera(folder, options)?;
    let (shots, warnings) = match layout {
        Layout::Tum => tum(folder)?,
        _ => seven_scenes(folder)?,
    };
    let usual = if layout == Layout::Tum { 5000.0 } else { 1000.0 };
    let per_metre = options.depth_scale.unwrap_or(usual);
    ensure!(
        per_metre.is_finite() && per_metre > 0.0,
        "a depth scale of {per_metre} cannot be: it is the value of a depth image at 1 m"
    );
    let undistorter = build::undistorter(&camera, None)?;
    let chosen: Vec<(usize, &Shot)> = shots.iter().enumerate().step_by(options.every).collect();
    let made: Vec<Keyframe> = chosen
        .par_iter()
        .enumerate()
        .map(|(index, (frame_index, shot))| {
            let posed = Posed {
                index,
                timestamp: shot.timestamp,
                frame_index: *frame_index as u64,
                image: &shot.image,
                world_from_camera: shot.world_from_camera,
            };
            keyframe(&posed, &shot.depth, &camera, &undistorter, per_metre)
        })
        .collect::<Result<_>>()?;
    let keyframes = made.into_iter().map(|keyframe| (keyframe.id, keyframe)).collect();
    let edges = build::chain(&keyframes);
    Ok(Built { camera: *undistorter.pinhole(), keyframes, edges, warnings })
}

/// The camera: from the file given, or the one in the folder.
fn camera(folder: &Path, options: &ImportOptions) -> Result<Camera> {
    let own = folder.join("camera.yaml");
    match &options.calibration {
        Some(file) => Ok(read_camera(file)?.camera),
        None if own.is_file() => Ok(read_camera(&own)?.camera),
        None => bail!(
            "{}: brings no calibration\nhint: give one by --calib, or as camera.yaml in the folder",
            folder.display()
        ),
    }
}

/// A keyframe with the depths of its depth image.
fn keyframe(
    posed: &Posed,
    depth: &Path,
    camera: &Camera,
    undistorter: &Undistorter,
    per_metre: f64,
) -> Result<Keyframe> {
    let (image, color) = build::undistorted(posed.image, undistorter)?;
    let measured = read_depth_image(depth).map_err(anyhow::Error::msg)?;
    let (size, expected) =
        ((measured.width(), measured.height()), (camera.intrinsics().width, camera.intrinsics().height));
    ensure!(
        size == expected,
        "{}: is {}×{} pixels, its image {}×{}: a depth must be for a pixel of the image",
        depth.display(),
        size.0,
        size.1,
        expected.0,
        expected.1
    );
    let distance = |x: usize, y: usize| {
        let ray = undistorter.pinhole().unproject(x as f64, y as f64);
        at(&measured, camera, &ray).map(|value| f64::from(value) / per_metre)
    };
    let deviation = |inverse_depth: f64| INVERSE_DEPTH_DEVIATION.max(MIN_DEVIATION * inverse_depth);
    let semi_dense = build::semi_dense(&image, undistorter.valid(), distance, deviation);
    Ok(Keyframe { semi_dense: semi_dense.into(), ..build::keyframe(posed, (image, color)) })
}

/// The value of a depth image in the direction of a ray: that of the nearest pixel.
fn at(depth: &Image<u16>, camera: &Camera, ray: &nalgebra::Vector3<f64>) -> Option<u16> {
    let pixel = camera.project(ray)?;
    let (x, y) = (pixel.x.round(), pixel.y.round());
    let inside = x >= 0.0 && y >= 0.0 && x < depth.width() as f64 && y < depth.height() as f64;
    let value = inside.then(|| depth.get(x as usize, y as usize))?;
    (value != 0 && value != NO_DEPTH).then_some(value)
}

/// The images of a TUM RGB-D folder that have a depth image and a pose of their time.
fn tum(folder: &Path) -> Result<(Vec<Shot>, Vec<String>)> {
    let table = |name: &str| timed_images(&folder.join(name), folder);
    let (images, depths) = (table("rgb.txt")?, table("depth.txt")?);
    let poses = folder.join("groundtruth.txt");
    let trajectory = read_trajectory(&poses)?;
    let (mut shots, mut without) = (Vec::new(), [0; 2]);
    for (timestamp, image) in &images {
        let nearest =
            depths.iter().min_by(|a, b| (a.0 - timestamp).abs().total_cmp(&(b.0 - timestamp).abs()));
        let depth = nearest.filter(|(time, _)| (time - timestamp).abs() <= DEFAULT_MAX_DIFF);
        let pose = trajectory.pose_at(*timestamp, DEFAULT_MAX_DIFF);
        match (depth, pose) {
            (None, _) => without[0] += 1,
            (_, None) => without[1] += 1,
            (Some((_, depth)), Some(pose)) => shots.push(Shot {
                timestamp: *timestamp,
                image: image.clone(),
                depth: depth.clone(),
                world_from_camera: pose.rigid(),
            }),
        }
    }
    if shots.is_empty() {
        bail!(
            "{}: none of the {} images has both a depth image and a pose within {DEFAULT_MAX_DIFF} s (without depth: {}, \
             without pose: {})\nhint: the times in rgb.txt, depth.txt and groundtruth.txt must be of one clock",
            folder.display(),
            images.len(),
            without[0],
            without[1]
        );
    }
    let missing = [(without[0], "depth image", "depth.txt"), (without[1], "pose", "groundtruth.txt")];
    let missing = missing.iter().filter(|(count, ..)| *count > 0).map(|(count, what, file)| {
        format!(
            "{}: {count} of {} images have no {what} of their time and were left out",
            folder.join(file).display(),
            images.len()
        )
    });
    Ok((shots, missing.collect()))
}

/// The colour images of 7-Scenes in a folder.
fn scene_images(folder: &Path) -> Result<Vec<PathBuf>> {
    let is_color =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(COLOR));
    Ok(images_in(folder)?.into_iter().filter(is_color).collect())
}

/// The images of a 7-Scenes folder, a second apart: their times are not told. Where tracking was lost, the pose is no
/// number, and the image is left out.
fn seven_scenes(folder: &Path) -> Result<(Vec<Shot>, Vec<String>)> {
    let images = scene_images(folder)?;
    let mut shots = Vec::new();
    for (number, image) in images.iter().enumerate() {
        let name = image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let sibling = |end: &str| folder.join(format!("{}{end}", name.trim_end_matches(COLOR)));
        let (depth, pose) = (sibling(".depth.png"), sibling(".pose.txt"));
        for (file, what) in [(&depth, "depth image"), (&pose, "pose")] {
            ensure!(
                file.is_file(),
                "{}: the {what} of {name} is missing\nhint: every image needs one of the same name; images without can be \
                 moved away",
                file.display()
            );
        }
        if let Some(world_from_camera) = matrix(&pose)? {
            shots.push(Shot { timestamp: number as f64, image: image.clone(), depth, world_from_camera });
        }
    }
    ensure!(!shots.is_empty(), "{}: holds no image with a pose", folder.display());
    let lost = images.len() - shots.len();
    let lost = (lost > 0).then(|| {
        format!(
            "{}: the poses of {lost} of {} images are no numbers: left out",
            folder.display(),
            images.len()
        )
    });
    Ok((shots, lost.into_iter().collect()))
}

/// A pose as a 4×4 matrix, world from camera; `None` where its numbers are not finite.
fn matrix(path: &Path) -> Result<Option<Se3>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap_or(f64::NAN)).collect();
    ensure!(
        numbers.len() == 16,
        "{}: has {} numbers; a pose is a matrix of 4×4, world from camera",
        path.display(),
        numbers.len()
    );
    if numbers.iter().any(|number| !number.is_finite()) {
        return Ok(None);
    }
    let matrix = Matrix4::from_row_slice(&numbers);
    let linear: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into();
    let skew = (linear * linear.transpose() - Matrix3::identity()).abs().max();
    ensure!(
        skew < 0.01 && linear.determinant() > 0.0,
        "{}: its 3×3 part is no rotation (off by {skew:.3})",
        path.display()
    );
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&linear));
    Ok(Some(Se3::new(rotation, matrix.fixed_view::<3, 1>(0, 3).into())))
}
