//! TUM RGB-D: `rgb.txt` (`seconds file`) names the images.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing};
use super::image_table::{named_images, read_table};
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
    let images = named_images(&table, &read_table(&table)?, folder)?;
    let calibration = first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"])
        .map(FoundCalibration::File)
        .or_else(|| presets::tum(folder, &table, &images.frames.first()?.1));
    let list = ImageList::new("TUM RGB-D folder", folder, &table, images.frames, calibration)?;
    Ok(Some(list.remarked(images.remarks, images.facts)))
}
