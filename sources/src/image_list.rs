//! Image files with time stamps: what every kind of folder comes down to.

use super::survey;
use super::{FoundCalibration, FrameSource, SourceFrame, SourceInfo};
use crate::forward::{Faults, StampVerdict, check_stamps};
use crate::pictures::Picture;
use anyhow::{Context, Result, bail};
use calib::CameraHint;
use scans::tables::sort_by_name;
use std::path::{Path, PathBuf};

/// More of the steps of a list than this share back in time, and it is in no order of time.
const UNORDERED: f64 = 0.1;

/// An image file and when it was taken.
pub type Timed = (f64, PathBuf);

/// A list of image files in the order of the recording.
pub struct ImageList {
    info: SourceInfo,
    frames: Vec<(StampVerdict, Timed)>,
    faults: Faults,
    /// What is to be said of how it was read.
    remarks: Vec<String>,
    facts: Vec<(&'static str, String)>,
    next: usize,
}

impl ImageList {
    /// A list from `(time stamp in seconds, file)` pairs in the order of the recording. One in no order of time is sorted by it.
    ///
    /// # Errors
    /// When the list is empty; `index` is the file or folder that should have named the images.
    pub fn new(
        kind: &'static str,
        folder: &Path,
        index: &Path,
        mut frames: Vec<Timed>,
        calibration: Option<FoundCalibration>,
    ) -> Result<Self> {
        if frames.is_empty() {
            bail!("{}: it names no images", index.display());
        }
        let remarks = ordered(&mut frames).into_iter().collect();
        let times: Vec<f64> = frames.iter().map(|(time, _)| *time).collect();
        let (of_each, faults) = check_stamps(&times);
        let mut good = of_each
            .iter()
            .filter_map(|one| if let StampVerdict::At(time) = one { Some(*time) } else { None });
        let first = good.next();
        let duration = first.map(|first| good.next_back().unwrap_or(first) - first);
        let images = frames.first().and_then(|(_, file)| file.parent());
        // A path from inside of the folder does not name it.
        let images = images.map(|images| images.canonicalize().unwrap_or_else(|_| images.to_owned()));
        // A pipe gives what it holds once.
        let first = frames.first().map(|(_, file)| file).filter(|file| file.is_file());
        let size = first.and_then(|file| image::image_dimensions(file).ok());
        let size = size.map(|(width, height)| (width as usize, height as usize));
        let info = SourceInfo {
            kind,
            path: folder.to_owned(),
            frame_count: Some(frames.len() as u64),
            duration,
            calibration,
            camera: CameraHint { folder: images, size, ..CameraHint::default() },
            lag: None,
        };
        let frames = of_each.into_iter().zip(frames).collect();
        Ok(Self { info, frames, faults, remarks, facts: Vec::new(), next: 0 })
    }

    /// The same list; images that all have one time get `fps` frames per second.
    ///
    /// # Errors
    /// When such images have no rate.
    pub fn with_rate(self, fps: Option<f64>) -> Result<Self> {
        let one_time = match &self.frames[..] {
            [(_, (first, _)), rest @ ..] if !rest.is_empty() => {
                rest.iter().all(|(_, (time, _))| time == first).then_some(*first)
            }
            _ => None,
        };
        let Some(time) = one_time else { return Ok(self) };
        let (count, path) = (self.frames.len(), self.info.path.clone());
        let Some(fps) = fps else {
            bail!(
                "{}: all {count} images have the time {time}\nhint: give their frame rate, such as --fps 30, which takes its place",
                path.display()
            );
        };
        let frames = self.frames.into_iter().enumerate().map(|(i, (_, (_, file)))| (i as f64 / fps, file));
        let (kind, calibration) = (self.info.kind, self.info.calibration);
        let list = Self::new(kind, &path, &path, frames.collect(), calibration)?;
        let what = format!("all images have the time {time}: they are taken as {fps} a second");
        Ok(list.remarked(vec![what], self.facts))
    }

    /// The same list with remarks on possible faults, and with facts on how it was read, as label and text.
    pub fn remarked(mut self, remarks: Vec<String>, facts: Vec<(&'static str, String)>) -> Self {
        self.remarks.extend(remarks);
        self.facts.extend(facts);
        self
    }
}

/// Sorts a list by time that is in no order of it, and says so. One whose clock was set keeps its order.
fn ordered(frames: &mut [Timed]) -> Option<String> {
    let back = frames.windows(2).filter(|pair| pair[1].0 < pair[0].0).count();
    // One step back is one stamp that is wrong, or a clock that was set.
    if back < 2 || back as f64 <= UNORDERED * frames.len() as f64 {
        return None;
    }
    frames.sort_by(|a, b| a.0.total_cmp(&b.0));
    Some("the images are named in no order of time: they are taken in the order of their times".into())
}

impl FrameSource for ImageList {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        let (of_time, (stamp, path)) = self.frames.get(self.next)?;
        let index = self.next as u64;
        self.next += 1;
        let (timestamp, picture) = match of_time {
            StampVerdict::At(time) => (*time, Picture::File(path.clone())),
            StampVerdict::Repeats | StampVerdict::NoTime => (*stamp, Picture::File(path.clone())),
            StampVerdict::Off => (*stamp, Picture::mistimed(*stamp)),
        };
        Some(SourceFrame { index, timestamp, captured: None, picture })
    }

    fn problems(&self) -> Vec<String> {
        let images: Vec<&Path> = self.frames.iter().map(|(_, (_, path))| path.as_path()).collect();
        let of_images = survey::of_images(&images);
        self.remarks.iter().cloned().chain(self.faults.texts()).chain(of_images).collect()
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        self.facts.clone()
    }
}

/// The first of `names` that exists in `folder`.
pub fn first_existing(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    names.iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// The image files of a folder, sorted so that 2 comes before 10; those whose names begin with a dot are another program's.
///
/// # Errors
/// When the folder cannot be read.
pub fn images_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let is_visible =
        |path: &Path| path.file_name().is_some_and(|name| !name.to_string_lossy().starts_with('.'));
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut images: Vec<PathBuf> = paths.filter(|path| is_image(path) && is_visible(path)).collect();
    sort_by_name(&mut images);
    Ok(images)
}

/// Whether a file's name is that of a readable image. Names that begin with a dot (`._000001.png`) are by-products of
/// other systems and no frames.
pub fn is_image(path: &Path) -> bool {
    if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.')) {
        return false;
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    matches!(extension.as_str(), "png" | "jpg" | "jpeg" | "pgm" | "ppm" | "tif" | "tiff" | "bmp")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(times: &[f64]) -> Result<ImageList> {
        let frames = times.iter().enumerate().map(|(i, time)| (*time, PathBuf::from(format!("{i}.png"))));
        ImageList::new("list", Path::new("folder"), Path::new("folder/times.txt"), frames.collect(), None)
    }

    fn names(list: &mut ImageList) -> Vec<String> {
        let name = |frame: SourceFrame| match frame.picture {
            Picture::File(path) => path.display().to_string(),
            other => format!("{other:?}"),
        };
        std::iter::from_fn(|| list.next_frame()).map(name).collect()
    }

    #[test]
    fn a_list_in_no_order_of_time_is_sorted() {
        for times in [[0.5, 0.4, 0.3, 0.2, 0.1], [0.1, 0.3, 0.2, 0.5, 0.4]] {
            let mut list = list(&times).unwrap();
            assert!(list.problems()[0].contains("in the order of their times"), "{:?}", list.problems());
            let frames: Vec<SourceFrame> = std::iter::from_fn(|| list.next_frame()).collect();
            assert!(frames.iter().map(|frame| frame.timestamp).eq([0.1, 0.2, 0.3, 0.4, 0.5]));
        }
    }

    #[test]
    fn a_clock_that_was_set_keeps_the_order() {
        let times: Vec<f64> = (0..60).map(|i| if i < 30 { 50.0 } else { 0.0 } + 0.1 * f64::from(i)).collect();
        let mut list = list(&times).unwrap();
        assert!((list.info().duration.unwrap() - 5.9).abs() < 1e-6, "{:?}", list.info().duration);
        assert!(list.problems()[0].contains("set back by 50.0 s at frame 30"), "{:?}", list.problems());
        assert_eq!(names(&mut list)[30], "30.png");
    }

    #[test]
    fn one_time_for_all_is_refused_without_a_rate() {
        let rated = |times: &[f64], fps| list(times).unwrap().with_rate(fps);
        let error = rated(&[7.0; 5], None).err().unwrap().to_string();
        assert!(error.contains("all 5 images have the time 7") && error.contains("--fps"), "{error}");
        let mut at_rate = rated(&[7.0; 5], Some(20.0)).unwrap();
        assert_eq!((at_rate.info().duration, names(&mut at_rate).len()), (Some(0.2), 5));
        assert_eq!(names(&mut rated(&[7.0], None).unwrap()), ["0.png"]);
    }
}
