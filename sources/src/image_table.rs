//! Tables of images with their times.

use crate::image_list::{Timed, images_in, is_image};
use crate::numbered::shows_scene;
use anyhow::{Context, Result, bail};
use scans::tables::{Numbers, Row, Stamps, Table, Times};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Images with their times, and remarks on these.
#[derive(Debug, Default)]
pub struct TimedImages {
    /// The images with seconds.
    pub frames: Vec<Timed>,
    /// Warnings about them.
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

/// The same for a table that was read already. Time and image may be in any columns.
///
/// # Errors
/// Those of [`timed_images`].
pub fn named_images(path: &Path, table: &Table, folder: &Path) -> Result<TimedImages> {
    let refuse = |row: &Row| {
        format!("{}: line {} is not 'time stamp, image': {}", path.display(), row.line, row.text())
    };
    let found = name_column(table, folder);
    let times = table.times_of(found);
    // Where nothing is called as an image is, the second column has the names, or the first if the times stand there.
    let name = found.unwrap_or(usize::from(times != Some(Times::Column(1))));
    let stamps = table.stamps_at(times.unwrap_or(Times::Column(usize::from(name == 0))));
    let stamps = stamps.map_err(|row| anyhow::anyhow!(refuse(row)))?;
    let files = table.rows.iter().map(|row| row.file(name, folder).with_context(|| refuse(row)));
    let mut files = files.collect::<Result<Vec<PathBuf>>>()?;
    let remark = if is_there(&files) { None } else { by_stems(&mut files, folder) };
    Ok(timed(stamps, files, remark.into_iter().collect()))
}

/// Of this many rows it is looked at what they name.
const LOOKED_AT: usize = 8;

/// The column with the names of images: the first one that names image files and does not name depth images or other
/// images without a scene.
pub fn name_column(table: &Table, folder: &Path) -> Option<usize> {
    let rows = || table.rows.iter().take(LOOKED_AT);
    let width = rows().map(|row| row.fields.len()).max()?;
    let names = |column: usize| {
        let is_name = |row: &Row| {
            row.fields.get(column).is_some_and(|field| is_image(Path::new(field)))
                // Words behind a time may be a name.
                || !row.is_time(column) && row.file(column, folder).is_some_and(|file| file.is_file() && is_image(&file))
        };
        rows().any(is_name)
    };
    let mut all = (0..width).filter(|column| names(*column));
    let first = all.next()?;
    let shows =
        |column: &usize| rows().all(|row| row.fields.get(*column).is_none_or(|name| shows_scene(name)));
    std::iter::once(first).chain(all).find(shows).or(Some(first))
}

/// Whether some of the first files are there.
fn is_there(files: &[PathBuf]) -> bool {
    files.iter().take(LOOKED_AT).any(|file| file.exists())
}

/// Takes the images of the same names with other endings, or that lie in a folder that the table does not name; says so.
fn by_stems(files: &mut [PathBuf], folder: &Path) -> Option<String> {
    let named = files.first()?.parent().map(Path::to_owned);
    let places = named.into_iter().chain(["images", "data", "rgb", "."].map(|place| folder.join(place)));
    let stem = |file: &Path| file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    for place in places.filter(|place| place.is_dir()) {
        let images = images_in(&place).ok()?;
        let by_stem: HashMap<String, &PathBuf> =
            images.iter().filter_map(|file| Some((stem(file)?, file))).collect();
        let found = |file: &PathBuf| by_stem.get(&stem(file)?).copied();
        let is_of_place = files.iter().take(LOOKED_AT).filter_map(found).any(|file| file.is_file());
        if is_of_place {
            for file in files.iter_mut() {
                if let Some(found) = stem(file).and_then(|stem| by_stem.get(&stem)) {
                    file.clone_from(found);
                }
            }
            return Some(format!(
                "the table names images that are not there: those of the same names in {} are taken",
                place.display()
            ));
        }
    }
    None
}

/// The images of a folder with the times of a table, one per line. Where images are missing, their numbers decide
/// which times are theirs.
///
/// # Errors
/// Names the line that is no time, and a table that does not fit the images.
pub fn images_by_times(
    path: &Path,
    table: &Table,
    images: &Path,
    files: Vec<PathBuf>,
) -> Result<TimedImages> {
    let times = table.times_of(None).unwrap_or(Times::Column(0));
    let stamps = table.stamps_at(times).map_err(|row| {
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
