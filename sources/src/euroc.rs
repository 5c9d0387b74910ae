//! EuRoC / ASL: `mav0/cam0/data.csv` (`nanoseconds,file`), `data/` and `sensor.yaml`; TUM VI, which has `dso/camchain.yaml`
//! beside `mav0` instead.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing};
use super::image_table::{named_images, read_table};
use anyhow::Result;
use std::path::Path;

/// Opens the folder if it is of this kind: the recording itself, its `mav0`, or its `cam0`.
///
/// # Errors
/// When `data.csv` is there but not a table of time stamps and images.
pub fn open(folder: &Path) -> Result<Option<ImageList>> {
    let camera_folder = ["mav0/cam0", "cam0", "."].iter().map(|name| folder.join(name));
    let Some(camera) = camera_folder.into_iter().find(|camera| camera.join("data.csv").is_file()) else {
        return Ok(None);
    };
    let table = camera.join("data.csv");
    let images = named_images(&table, &read_table(&table)?, &camera.join("data"))?;
    let calibration = first_existing(folder, &["camera.yaml"])
        .or_else(|| first_existing(&camera, &["sensor.yaml", "../../dso/camchain.yaml"]))
        .map(FoundCalibration::File);
    let list = ImageList::new("EuRoC folder", folder, &table, images.frames, calibration)?;
    Ok(Some(list.remarked(images.remarks, images.facts)))
}
