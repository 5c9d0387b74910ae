//! KITTI odometry: `image_0/NNNNNN.png`, `times.txt` (one time a line), `calib.txt` (`P0: …`).

use super::image_list::{ImageList, first_existing, images_in, read_table};
use anyhow::{Result, bail};
use std::path::Path;

/// Opens the folder if it is of this kind.
///
/// # Errors
/// When `times.txt` and `image_0/` do not go together.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let (images, table) = (folder.join("image_0"), folder.join("times.txt"));
    if !(images.is_dir() && table.is_file()) {
        return Ok(None);
    }
    let files = images_in(&images)?;
    let times = read_table(&table)?;
    if files.len() > times.len() {
        bail!("{}: {} times for {} images of image_0/", table.display(), times.len(), files.len());
    }
    let mut frames = Vec::with_capacity(files.len());
    for ((line, fields), file) in times.into_iter().zip(files) {
        match fields[0].parse::<f64>() {
            Ok(time) if time.is_finite() => frames.push((time, file)),
            _ => bail!("{}: line {line} is not a time in seconds: {}", table.display(), fields[0]),
        }
    }
    let calibration = first_existing(folder, &["camera.yaml", "calib.txt"]);
    ImageList::new("KITTI odometry folder", folder, &images, frames, calibration).map(Some)
}
