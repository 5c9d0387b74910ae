//! Image files with time stamps: what every kind of folder comes down to.

use super::survey;
use super::{FoundCalibration, FrameSource, SourceFrame, SourceInfo};
use crate::pictures::Picture;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// A list of image files in the order of the recording.
pub struct ImageList {
    info: SourceInfo,
    frames: Vec<(f64, PathBuf)>,
    next: usize,
}

impl ImageList {
    /// A list from `(time stamp in seconds, file)` pairs in the order of the recording.
    ///
    /// # Errors
    /// When the list is empty; `index` is the file or folder that should have named the images.
    pub fn new(
        kind: &'static str,
        folder: &Path,
        index: &Path,
        frames: Vec<(f64, PathBuf)>,
        calibration: Option<FoundCalibration>,
    ) -> Result<Self> {
        let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
            bail!("{}: it names no images", index.display());
        };
        let info = SourceInfo {
            kind,
            path: folder.to_owned(),
            frame_count: Some(frames.len() as u64),
            duration: Some(last.0 - first.0),
            calibration,
            lag: None,
        };
        Ok(Self { info, frames, next: 0 })
    }
}

impl FrameSource for ImageList {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        let (timestamp, path) = self.frames.get(self.next)?;
        let index = self.next as u64;
        self.next += 1;
        let picture = Picture::File(path.clone());
        Some(SourceFrame { index, timestamp: *timestamp, captured: None, picture })
    }

    fn problems(&self) -> Vec<String> {
        let times: Vec<f64> = self.frames.iter().map(|(t, _)| *t).collect();
        let images: Vec<&Path> = self.frames.iter().map(|(_, path)| path.as_path()).collect();
        survey::of_times(&times).into_iter().chain(survey::of_images(&images)).collect()
    }
}

/// Lines of a text table: their numbers, from 1, and their fields, of which there is at least one.
pub type Lines = Vec<(usize, Vec<String>)>;

/// The fields of each line of a text table, without comments (`#`) and empty lines, with line numbers from 1.
///
/// # Errors
/// When the file cannot be read as text.
pub fn read_table(path: &Path) -> Result<Lines> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let rows = text.lines().enumerate().filter_map(|(i, line)| {
        let line = line.split('#').next().unwrap_or_default();
        let fields: Vec<String> = line
            .split(|c: char| c == ',' || c.is_whitespace())
            .filter(|field| !field.is_empty())
            .map(str::to_owned)
            .collect();
        (!fields.is_empty()).then_some((i + 1, fields))
    });
    Ok(rows.collect())
}

/// A table of time stamps and image names: `(time stamp, folder / name)` of each row.
///
/// # Errors
/// Names the line that is not `time stamp, image`.
pub fn timed_images(table: &Path, folder: &Path) -> Result<Vec<(f64, PathBuf)>> {
    images_of_lines(table, read_table(table)?, folder)
}

/// The same of the table's lines.
///
/// # Errors
/// Those of [`timed_images`].
pub fn images_of_lines(table: &Path, lines: Lines, folder: &Path) -> Result<Vec<(f64, PathBuf)>> {
    lines
        .into_iter()
        .map(|(line, fields)| {
            let timestamp = fields[0].parse::<f64>().ok().filter(|t| t.is_finite());
            match (timestamp, fields.get(1)) {
                (Some(timestamp), Some(name)) => Ok((timestamp, folder.join(name))),
                _ => {
                    bail!("{}: line {line} is not 'time stamp, image': {}", table.display(), fields.join(" "))
                }
            }
        })
        .collect()
}

/// How many times a table holds for the images of a folder, where these do not go together.
pub fn mismatch(table: &Path, times: &Lines, images: &Path, files: &[PathBuf]) -> String {
    let (times, files) = (times.len(), files.len());
    format!("{}: {times} times for {files} images of {}", table.display(), images.display())
}

/// Images with the times that a table says one a line; of what there are more, the last are left out.
///
/// # Errors
/// Names the line that is no time.
pub fn images_by_times(table: &Path, times: Lines, files: Vec<PathBuf>) -> Result<Vec<(f64, PathBuf)>> {
    let of_line = |((line, fields), file): ((usize, Vec<String>), PathBuf)| match fields[0].parse::<f64>() {
        Ok(time) if time.is_finite() => Ok((time, file)),
        _ => bail!("{}: line {line} is not a time in seconds: {}", table.display(), fields[0]),
    };
    times.into_iter().zip(files).map(of_line).collect()
}

/// The first of `names` that exists in `folder`.
pub fn first_existing(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    names.iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// The image files of a folder, sorted so that 2 comes before 10.
///
/// # Errors
/// When the folder cannot be read.
pub fn images_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let mut images: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| is_image(path)).collect();
    images.sort_by_cached_key(|path| natural_key(&path.file_name().unwrap_or_default().to_string_lossy()));
    Ok(images)
}

/// Whether a file's name is that of an image that can be read.
pub fn is_image(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    matches!(extension.as_str(), "png" | "jpg" | "jpeg" | "pgm" | "ppm" | "tif" | "tiff" | "bmp")
}

/// A name as alternating text and numbers, so that numbers compare by value.
fn natural_key(name: &str) -> Vec<(String, u64, String)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(digits);
        let end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (number, tail) = tail.split_at(end);
        // The digits themselves break ties between 1 and 01, and stand in for numbers beyond 64 bits.
        parts.push((text.to_owned(), number.parse().unwrap_or(u64::MAX), number.to_owned()));
        rest = tail;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_sort_by_value() {
        let mut names = ["f10.png", "f2.png", "f1.png", "e3.png"];
        names.sort_by_cached_key(|name| natural_key(name));
        assert_eq!(names, ["e3.png", "f1.png", "f2.png", "f10.png"]);
    }
}
