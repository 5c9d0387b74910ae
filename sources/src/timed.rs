//! loopbox's own folder: `times.txt` (`seconds image`), `images/`, `camera.yaml`; or times alone, one for each image.

use super::FoundCalibration;
use super::image_list::{
    ImageList, Lines, first_existing, images_by_times, images_in, images_of_lines, mismatch, read_table,
};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

/// Opens the folder if it is of this kind.
///
/// # Errors
/// When `times.txt` is there but not a table of time stamps and images, or of one time for each image.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let table = folder.join("times.txt");
    if !table.is_file() {
        return Ok(None);
    }
    let lines = read_table(&table)?;
    let frames = match !lines.is_empty() && lines.iter().all(|(_, fields)| fields.len() == 1) {
        true => timed_alone(&table, lines, folder)?,
        false => images_of_lines(&table, lines, folder)?,
    };
    let calibration =
        first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"]).map(FoundCalibration::File);
    ImageList::new("image folder with times.txt", folder, &table, frames, calibration).map(Some)
}

/// The images of the folder, or of its `images/`, each with its line's time.
fn timed_alone(table: &Path, times: Lines, folder: &Path) -> Result<Vec<(f64, PathBuf)>> {
    let nested = folder.join("images");
    let images = if nested.is_dir() { nested } else { folder.to_owned() };
    let files = images_in(&images)?;
    if times.len() != files.len() {
        let what = mismatch(table, &times, &images, &files);
        bail!("{what}\nhint: give each its line, 'seconds image' where some are left out");
    }
    images_by_times(table, times, files)
}
