//! loopbox's own folder: `times.txt` (`seconds image`), `images/`, `camera.yaml`.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing, timed_images};
use anyhow::Result;
use std::path::Path;

/// Opens the folder if it is of this kind.
///
/// # Errors
/// When `times.txt` is there but not a table of time stamps and images.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let table = folder.join("times.txt");
    if !table.is_file() {
        return Ok(None);
    }
    let frames = timed_images(&table, folder)?;
    let calibration =
        first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"]).map(FoundCalibration::File);
    ImageList::new("image folder with times.txt", folder, &table, frames, calibration).map(Some)
}
