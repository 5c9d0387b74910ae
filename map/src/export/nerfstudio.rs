//! nerfstudio's `transforms.json`, by which radiance fields and Gaussian splats are trained
//! (<https://docs.nerf.studio/quickstart/data_conventions.html>).

use super::posed_images::{IMAGES, PIXEL_CENTRE, PosedImages};
use super::save;
use crate::{Map, MapError};
use geometry::Se3;
use serde::Serialize;
use std::io::{self, Write};
use std::path::Path;

/// The cloud that splats begin from.
const POINTS: &str = "sparse_pc.ply";

#[derive(Serialize)]
struct Transforms<'a> {
    camera_model: &'a str,
    ply_file_path: &'a str,
    frames: Vec<Frame>,
}

#[derive(Serialize)]
struct Frame {
    file_path: String,
    w: usize,
    h: usize,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    transform_matrix: [[f64; 4]; 4],
}

/// Writes the keyframes of a map as nerfstudio reads them: the undistorted images in `images/`, `transforms.json` with
/// their cameras and poses (world from camera, camera x right, y up, z backward), and the sparse points in `sparse_pc.ply`.
/// Lengths are the map's. Returns the number of images and of points.
///
/// # Errors
/// [`MapError::Sensor`] for maps of LiDARs, and when a file cannot be written.
pub fn save_nerfstudio(folder: impl AsRef<Path>, map: &Map) -> Result<(usize, usize), MapError> {
    let (folder, posed) = (folder.as_ref(), PosedImages::of(map)?);
    posed.save_images(&folder.join(IMAGES))?;
    save(&folder.join(POINTS), |out| write_points(out, &posed))?;
    let frame = |image: &super::posed_images::PosedImage| {
        let camera = map.camera(&image.keyframe);
        Frame {
            file_path: format!("{IMAGES}/{}", image.name),
            w: camera.width,
            h: camera.height,
            fl_x: camera.fx,
            fl_y: camera.fy,
            cx: camera.cx + PIXEL_CENTRE,
            cy: camera.cy + PIXEL_CENTRE,
            transform_matrix: looking_back(&image.camera_from_world.inverse()),
        }
    };
    let frames = posed.images.iter().map(frame).collect();
    let transforms = Transforms { camera_model: "PINHOLE", ply_file_path: POINTS, frames };
    save(&folder.join("transforms.json"), |out| Ok(serde_json::to_writer_pretty(out, &transforms)?))?;
    Ok((posed.images.len(), posed.points.len()))
}

/// World from camera as a matrix, the camera's y and z turned about: up and backward, as in OpenGL.
fn looking_back(world_from_camera: &Se3) -> [[f64; 4]; 4] {
    let matrix = world_from_camera.to_matrix();
    let sign = |column: usize| if column == 1 || column == 2 { -1.0 } else { 1.0 };
    [0, 1, 2, 3].map(|row| [0, 1, 2, 3].map(|column| sign(column) * matrix[(row, column)]))
}

fn write_points(out: &mut impl Write, posed: &PosedImages) -> io::Result<()> {
    write!(
        out,
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        posed.points.len()
    )?;
    for point in &posed.points {
        let (p, [red, green, blue]) = (point.position, point.color);
        writeln!(out, "{} {} {} {red} {green} {blue}", p.x as f32, p.y as f32, p.z as f32)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::united;
    use nalgebra::{Matrix4, Vector4};

    #[test]
    fn points_project_in_front_of_a_camera_that_looks_back() {
        let (folder, map) = (tempfile::tempdir().unwrap(), united());
        let (images, points) = save_nerfstudio(folder.path(), &map).unwrap();
        let text = std::fs::read_to_string(folder.path().join("transforms.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let frames = json["frames"].as_array().unwrap();
        assert_eq!(frames.len(), images);
        let cloud = std::fs::read_to_string(folder.path().join(POINTS)).unwrap();
        assert_eq!(cloud.lines().skip_while(|line| *line != "end_header").count(), points + 1);
        let posed = PosedImages::of(&map).unwrap();
        for point in &posed.points {
            let (host, pixel) = point.track[0];
            let frame = &frames[host];
            let number = |key: &str| frame[key].as_f64().unwrap();
            let matrix =
                Matrix4::from_fn(|row, column| frame["transform_matrix"][row][column].as_f64().unwrap());
            let p = point.position;
            let local = matrix.try_inverse().unwrap() * Vector4::new(p.x, p.y, p.z, 1.0);
            assert!(local.z < 0.0, "the camera looks along -z");
            let x = number("fl_x") * local.x / -local.z + number("cx");
            let y = number("fl_y") * -local.y / -local.z + number("cy");
            assert!((x - pixel.x - 0.5).abs() < 1e-6 && (y - pixel.y - 0.5).abs() < 1e-6);
        }
        assert!(
            frames.iter().all(|frame| folder.path().join(frame["file_path"].as_str().unwrap()).is_file())
        );
    }
}
