//! loopbox's own folder: `times.txt` (`seconds image`), `images/`, `camera.yaml`; or times alone, one for each image. Others call the
//! table otherwise.

use super::FoundCalibration;
use super::image_list::{ImageList, first_existing, images_in, is_image};
use super::image_table::{TimedImages, images_by_times, name_column, named_images, read_table};
use super::numbered::shows_scene;
use super::presets;
use super::rosbag2::files_with;
use anyhow::Result;
use scans::tables::{Table, Times, decoded};
use std::fs::File;
use std::io::Read;
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
    let images = if has_times_alone(&table, folder) {
        let places = ["images", "data", "."].map(|place| folder.join(place));
        let images = places.iter().find(|place| place.is_dir()).unwrap_or(&places[2]);
        images_by_times(&path, &table, images, images_in(images)?)?
    } else {
        named_images(&path, &table, folder)?
    };
    Ok(Some(list(folder, &path, images)?))
}

/// Opens the folder by a table of any name whose rows name existing images in the order of their times.
/// `associate.py` of the TUM RGB-D benchmark writes such a table, ORB-SLAM reads it, and other programs have their
/// own.
///
/// # Errors
/// When such a table is there but has rows of another kind.
pub fn open_any(folder: &Path) -> Result<Option<ImageList>> {
    for path in files_with(folder, "txt")?.into_iter().chain(files_with(folder, "csv")?) {
        if !read_head(&path).is_some_and(|head| is_of_images(&head, folder)) {
            continue;
        }
        let mut images = named_images(&path, &read_table(&path)?, folder)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        images.facts.push(("table", name));
        return Ok(Some(list(folder, &path, images)?));
    }
    Ok(None)
}

/// The first lines of a table.
fn read_head(path: &Path) -> Option<Table> {
    /// So many bytes have some tens of lines.
    const HEAD: u64 = 1 << 14;
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(HEAD).read_to_end(&mut bytes).ok()?;
    if bytes.len() as u64 == HEAD {
        let end = bytes.iter().rposition(|byte| [b'\n', b'\r'].contains(byte))?;
        bytes.truncate(end);
    }
    Some(Table::parse(&decoded(&bytes)))
}

/// Whether rows name images of the scene that are there, and times that go forward.
fn is_of_images(table: &Table, folder: &Path) -> bool {
    let Some(name) = name_column(table, folder) else { return false };
    let named = table.rows.iter().take(4).filter_map(|row| row.file(name, folder));
    let shows = table.rows[0].fields.get(name).is_some_and(|name| shows_scene(name));
    let is_there = || named.into_iter().any(|file| file.is_file() && is_image(&file));
    shows && table.times_of(Some(name)).is_some_and(|times| table.is_increasing(times)) && is_there()
}

/// Whether a table names no images: of each row one time, or whole seconds and what of a second is to be added.
fn has_times_alone(table: &Table, folder: &Path) -> bool {
    let most = table.rows.iter().map(|row| row.fields.len()).max().unwrap_or(0);
    let is_pair = || most == 2 && matches!(table.times_of(None), Some(Times::Parts(..)));
    most == 1 || is_pair() && name_column(table, folder).is_none()
}

fn list(folder: &Path, table: &Path, images: TimedImages) -> Result<ImageList> {
    let calibration = first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"])
        .map(FoundCalibration::File)
        .or_else(|| presets::tum(folder, table, &images.frames.first()?.1));
    let list = ImageList::new("image folder with times.txt", folder, table, images.frames, calibration)?;
    Ok(list.remarked(images.remarks, images.facts))
}
