//! Numbered image files without time stamps.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing, images_in};
use anyhow::{Result, bail};
use std::path::Path;

/// Opens the folder if it, or its `images/`, holds image files.
///
/// # Errors
/// When there are images but no frame rate to time them by.
pub fn open(folder: &Path, fps: Option<f64>) -> Result<Option<ImageList>> {
    for images in [folder.to_owned(), folder.join("images")] {
        if !images.is_dir() {
            continue;
        }
        let files = images_in(&images)?;
        if files.is_empty() {
            continue;
        }
        let Some(fps) = fps else {
            bail!(
                "{}: {} images but no time stamps\nhint: give their frame rate, such as --fps 30, or a times.txt \
                 with a line 'seconds image' for each",
                folder.display(),
                files.len()
            );
        };
        let frames = files.into_iter().enumerate().map(|(i, file)| (i as f64 / fps, file)).collect();
        let calibration =
            first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"]).map(FoundCalibration::File);
        return ImageList::new("folder of numbered images", folder, &images, frames, calibration).map(Some);
    }
    Ok(None)
}
