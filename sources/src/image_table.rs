//! Tables that say when images were taken.

use crate::image_list::Timed;
use anyhow::{Context, Result, bail};
use scans::tables::{Numbers, Row, Stamps, Table};
use std::path::{Path, PathBuf};

/// Images with their times, and what is to be said of these.
#[derive(Debug, Default)]
pub struct TimedImages {
    /// The images with seconds.
    pub frames: Vec<Timed>,
    /// What may be wrong with them.
    pub remarks: Vec<String>,
    /// How their times were read, as label and text.
    pub facts: Vec<(&'static str, String)>,
}

/// Reads a table.
///
/// # Errors
/// When the file cannot be read.
pub fn read_table(path: &Path) -> Result<Table> {
    Table::read(path).with_context(|| format!("{}: cannot be read", path.display()))
}

/// A table of time stamps and image names: `(time stamp, folder / name)` of each row.
///
/// # Errors
/// Names the line that is not `time stamp, image`.
pub fn timed_images(table: &Path, folder: &Path) -> Result<Vec<Timed>> {
    Ok(named_images(table, &read_table(table)?, folder)?.frames)
}

/// The same of a table that was read, with what is to be said of it. Time and image may stand in either order.
///
/// # Errors
/// Those of [`timed_images`].
pub fn named_images(path: &Path, table: &Table, folder: &Path) -> Result<TimedImages> {
    let refuse = |row: &Row| {
        format!("{}: line {} is not 'time stamp, image': {}", path.display(), row.line, row.text())
    };
    let (stamps, name) = match (table.stamps(), table.stamps_of(1)) {
        (Ok(stamps), _) => (stamps, 1),
        (Err(_), Ok(stamps)) => (stamps, 0),
        (Err(row), Err(_)) => bail!(refuse(row)),
    };
    let files = table.rows.iter().map(|row| row.file(name, folder).with_context(|| refuse(row)));
    let files = files.collect::<Result<Vec<PathBuf>>>()?;
    Ok(timed(stamps, files, Vec::new()))
}

/// The images of a folder with the times that a table says one a line. Where images are missing, their numbers tell whose the
/// times are.
///
/// # Errors
/// Names the line that is no time, and a table that does not fit the images.
pub fn images_by_times(
    path: &Path,
    table: &Table,
    images: &Path,
    files: Vec<PathBuf>,
) -> Result<TimedImages> {
    let stamps = table.stamps().map_err(|row| {
        anyhow::anyhow!("{}: line {} is not a time: {}", path.display(), row.line, row.text())
    })?;
    let times = &stamps.seconds;
    let counts = format!("{} times for {} images of {}", times.len(), files.len(), images.display());
    if times.len() == files.len() {
        return Ok(timed(stamps, files, Vec::new()));
    }
    let numbers = Numbers::of(files.iter().map(PathBuf::as_path));
    let Some(places) = numbers.and_then(|numbers| numbers.places_in(times.len())) else {
        bail!(
            "{}: {counts}\nhint: give each image its line, or name images by the numbers of their lines, from 0, where some \
             are missing; 'seconds image' a line fits in any case",
            path.display()
        );
    };
    // Of the first part of a sequence nothing is missing.
    let is_first_part = places.iter().copied().eq(0..places.len());
    let remarks =
        if is_first_part { Vec::new() } else { vec![format!("{counts}: each has that of its number")] };
    let of_files =
        Stamps { seconds: places.into_iter().map(|place| times[place]).collect(), unit: stamps.unit };
    Ok(timed(of_files, files, remarks))
}

fn timed(stamps: Stamps, files: Vec<PathBuf>, remarks: Vec<String>) -> TimedImages {
    let facts = stamps.remark().map(|remark| ("times", remark)).into_iter().collect();
    TimedImages { frames: stamps.seconds.into_iter().zip(files).collect(), remarks, facts }
}
