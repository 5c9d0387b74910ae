//! KITTI odometry: `image_0/NNNNNN.png` (grey) or `image_2/` (colour), `times.txt` (one time a line), `calib.txt` (`P0: …`,
//! `P2: …`); and its raw recordings: `image_00/data/` to `image_03/data/`, each beside `timestamps.txt` (a date and time a line).

use super::FoundCalibration;
use super::image_list::{ImageList, Timed, first_existing, images_in};
use super::image_table::{images_by_times, read_table};
use super::presets;
use anyhow::Result;
use geometry::{Camera, Distortion, Pinhole};
use std::path::Path;

/// Opens the folder if it is of this kind.
///
/// # Errors
/// When `times.txt` and the folder of images do not go together.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let table = folder.join("times.txt");
    let cameras = [("image_0", "P0:"), ("image_2", "P2:")].map(|(name, row)| (folder.join(name), row));
    let Some((images, row)) = cameras.into_iter().find(|(images, _)| images.is_dir() && table.is_file())
    else {
        return open_raw(folder);
    };
    let timed = images_by_times(&table, &read_table(&table)?, &images, images_in(&images)?)?;
    let frames = timed.frames;
    let calibration = first_existing(folder, &["camera.yaml"])
        .map(FoundCalibration::File)
        .or_else(|| first_existing(folder, &["calib.txt"]).map(|path| calibration_file(&path, row, &frames)))
        .or_else(|| presets::kitti(&frames.first()?.1));
    let list = ImageList::new("KITTI odometry folder", folder, &images, frames, calibration)?;
    Ok(Some(list.remarked(timed.remarks, timed.facts)))
}

/// A raw recording, or the folder of one of its cameras.
fn open_raw(folder: &Path) -> Result<Option<ImageList>> {
    let cameras = ["image_00", "image_02", "image_01", "image_03", "."].map(|camera| folder.join(camera));
    let is_camera = |camera: &Path| camera.join("timestamps.txt").is_file() && camera.join("data").is_dir();
    let Some(camera) = cameras.into_iter().find(|camera| is_camera(camera)) else { return Ok(None) };
    let (table, images) = (camera.join("timestamps.txt"), camera.join("data"));
    let files = images_in(&images)?;
    if files.is_empty() {
        return Ok(None);
    }
    let timed = images_by_times(&table, &read_table(&table)?, &images, files)?;
    // KITTI has it in the folder of the day, above the drive.
    let names =
        ["camera.yaml", "camera.yml", "camera.txt", "calib_cam_to_cam.txt", "../calib_cam_to_cam.txt"];
    let calibration = first_existing(folder, &names).map(FoundCalibration::File);
    let list = ImageList::new("KITTI raw folder", folder, &images, timed.frames, calibration)?;
    Ok(Some(list.remarked(timed.remarks, timed.facts)))
}

/// The rectified left camera in this row of a `calib.txt`; the size, which is not in it, is the first image's.
fn calibration_file(path: &Path, row: &str, frames: &[Timed]) -> FoundCalibration {
    let origin = path.display().to_string();
    let read = || {
        let text = std::fs::read_to_string(path).map_err(|e| e.to_string())?;
        let (_, first) = frames.first().ok_or("there are no images")?;
        let (width, height) =
            image::image_dimensions(first).map_err(|e| format!("{}: {e}", first.display()))?;
        parse_projection(&text, row, width as usize, height as usize)
    };
    match read() {
        Ok(camera) => FoundCalibration::Inside { origin, camera: Box::new(camera) },
        Err(reason) => FoundCalibration::Unusable { origin, reason },
    }
}

/// `P0: fx 0 cx 0 0 fy cy 0 0 0 1 0`.
fn parse_projection(text: &str, row: &str, width: usize, height: usize) -> Result<Camera, String> {
    let numbers = text.lines().find_map(|line| line.strip_prefix(row));
    let numbers = numbers.ok_or_else(|| format!("it has no line '{row}'"))?.split_whitespace();
    let numbers = numbers.map(str::parse).collect::<Result<Vec<f64>, _>>();
    let numbers = numbers.map_err(|_| format!("{row} there is a word for a number"))?;
    let &[fx, _, cx, _, _, fy, cy, ..] = numbers.as_slice() else {
        return Err(format!("{row} there are not 12 numbers"));
    };
    let pinhole = Pinhole { width, height, fx, fy, cx, cy };
    Camera::new(pinhole, Distortion::None).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_projection_is_a_camera() {
        let text = "P0: 718.856 0 607.1928 0 0 718.9 185.2157 0 0 0 1 0\nP1: 1 0 0 0 0 1 0 0 0 0 1 0\n";
        let camera = parse_projection(text, "P0:", 1241, 376).unwrap();
        let Pinhole { fx, fy, cx, cy, .. } = *camera.intrinsics();
        assert_eq!([fx, fy, cx, cy], [718.856, 718.9, 607.1928, 185.2157]);
        assert!(parse_projection(text, "P2:", 1241, 376).is_err());
        assert!(parse_projection("P1: 1", "P0:", 1241, 376).is_err());
        assert!(parse_projection("P0: 1 2", "P0:", 1241, 376).is_err());
    }
}
