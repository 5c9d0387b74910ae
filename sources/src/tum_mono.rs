//! TUM monoVO (Engel et al. 2016): `images/` named by the numbers in `times.txt` (`number seconds [exposure]`), `camera.txt`,
//! and of the sensor `pcalib.txt` and `vignette.png`.

use super::FoundCalibration;
use super::image_list::{ImageList, images_in, is_image};
use super::image_table::read_table;
use crate::recording::{CalibrationFiles, NamedFile};
use anyhow::{Result, bail};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Opens the folder if it is of this kind.
///
/// # Errors
/// When `times.txt` is there but not a table of numbers and times, or the images are still packed.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let table = folder.join("times.txt");
    if !table.is_file() {
        return Ok(None);
    }
    let rows = read_table(&table)?.rows;
    let is_of_kind = rows.first().is_some_and(|row| {
        row.fields.len() >= 2
            && row.fields[..2].iter().all(|field| time(field).is_some())
            && !folder.join(&row.fields[1]).exists()
            && !row.fields.iter().any(|field| is_image(Path::new(field)))
    });
    if !is_of_kind {
        return Ok(None);
    }
    let images = folder.join("images");
    if !images.is_dir() && folder.join("images.zip").is_file() {
        bail!(
            "{0}: the images are still packed\nhint: unpack them: unzip {0}/images.zip -d {0}/images",
            folder.display()
        );
    }
    let files = if images.is_dir() { images_in(&images)? } else { Vec::new() };
    let by_number: HashMap<String, &PathBuf> = files
        .iter()
        .filter_map(|file| Some((file.file_stem()?.to_string_lossy().into_owned(), file)))
        .collect();
    // Where no row has the number of an image, the columns are others.
    if !files.is_empty() && !rows.iter().any(|row| by_number.contains_key(&row.fields[0])) {
        return Ok(None);
    }
    let frames = rows
        .into_iter()
        .map(|row| match row.fields.get(1).and_then(|field| time(field)) {
            Some(seconds) => {
                let missing = || images.join(format!("{}.jpg", row.fields[0]));
                Ok((seconds, by_number.get(&row.fields[0]).map_or_else(missing, PathBuf::from)))
            }
            None => {
                bail!("{}: line {} is not 'number seconds': {}", table.display(), row.line, row.text())
            }
        })
        .collect::<Result<Vec<(f64, PathBuf)>>>()?;
    ImageList::new("TUM monoVO folder", folder, &table, frames, calibration(folder)?).map(Some)
}

/// A time in seconds. Names of image files have an extension, and are none.
fn time(field: &str) -> Option<f64> {
    field.parse().ok().filter(|seconds: &f64| seconds.is_finite())
}

/// The files of the camera and its sensor.
fn calibration(folder: &Path) -> Result<Option<FoundCalibration>> {
    let own = folder.join("camera.yaml");
    if own.is_file() {
        return Ok(Some(FoundCalibration::File(own)));
    }
    let read = |name: &str| {
        let path = folder.join(name);
        path.is_file().then(|| NamedFile::read(&path)).transpose()
    };
    let files = CalibrationFiles {
        camera: read("camera.txt")?,
        response: read("pcalib.txt")?,
        vignette: read("vignette.png")?,
    };
    let origin = folder.join("camera.txt").display().to_string();
    Ok((!files.is_empty()).then(|| FoundCalibration::Recorded { origin, files: Box::new(files) }))
}
