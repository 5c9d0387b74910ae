//! TUM RGB-D: `rgb.txt` (`seconds file`) names the images.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing, timed_images};
use super::presets;
use anyhow::Result;
use std::path::Path;

/// Opens the folder if it is of this kind.
///
/// # Errors
/// When `rgb.txt` is there but not a table of time stamps and images.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let table = folder.join("rgb.txt");
    if !table.is_file() {
        return Ok(None);
    }
    let frames = timed_images(&table, folder)?;
    let calibration = first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"])
        .map(FoundCalibration::File)
        .or_else(|| presets::tum(folder, &table, &frames.first()?.1));
    ImageList::new("TUM RGB-D folder", folder, &table, frames, calibration).map(Some)
}
