//! EuRoC / ASL: `mav0/cam0/data.csv` (`nanoseconds,file`), `data/` and `sensor.yaml`; TUM VI, which has `dso/camchain.yaml`
//! beside `mav0` instead.

use super::image_list::{ImageList, first_existing, read_table};
use super::{FoundCalibration, time};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

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
    let frames = read_table(&table)?
        .into_iter()
        .map(|(line, fields)| match (fields[0].parse::<u64>(), fields.get(1)) {
            (Ok(ns), Some(name)) => Ok((time::seconds(ns), camera.join("data").join(name))),
            _ => bail!("{}: line {line} is not 'nanoseconds,image': {}", table.display(), fields.join(",")),
        })
        .collect::<Result<Vec<(f64, PathBuf)>>>()?;
    let calibration = first_existing(folder, &["camera.yaml"])
        .or_else(|| first_existing(&camera, &["sensor.yaml", "../../dso/camchain.yaml"]))
        .map(FoundCalibration::File);
    ImageList::new("EuRoC folder", folder, &table, frames, calibration).map(Some)
}
