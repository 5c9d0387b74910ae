//! loopbox's own folder: `times.txt` (`seconds image`), `images/`, `camera.yaml`; or times alone, one for each image. Others call the
//! table otherwise.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing, images_in};
use super::image_table::{images_by_times, named_images, read_table};
use anyhow::Result;
use std::path::Path;

/// What the table is called here, and elsewhere.
pub const OWN: [&str; 1] = ["times.txt"];
pub const OTHERS: [&str; 3] = ["times.csv", "timestamps.txt", "timestamps.csv"];

/// Opens the folder if it is of this kind, with a table of one of these names.
///
/// # Errors
/// When the table is there but not one of time stamps and images, or of one time for each image.
pub fn open(folder: &Path, names: &[&str]) -> Result<Option<ImageList>> {
    let Some(path) = first_existing(folder, names) else { return Ok(None) };
    let table = read_table(&path)?;
    let images = if !table.rows.is_empty() && table.rows.iter().all(|row| row.fields.len() == 1) {
        let places = ["images", "data", "."].map(|place| folder.join(place));
        let images = places.iter().find(|place| place.is_dir()).unwrap_or(&places[2]);
        images_by_times(&path, &table, images, images_in(images)?)?
    } else {
        named_images(&path, &table, folder)?
    };
    let calibration =
        first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"]).map(FoundCalibration::File);
    let list = ImageList::new("image folder with times.txt", folder, &path, images.frames, calibration)?;
    Ok(Some(list.remarked(images.remarks, images.facts)))
}
