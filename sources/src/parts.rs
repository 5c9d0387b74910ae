//! Recordings that were split: several files, one after the other.

use crate::forward::{StampVerdict, check_stamps};
use crate::pictures::StatedFocal;
use crate::{FrameSource, SourceFrame, SourceInfo, SourceOptions};
use anyhow::Result;
use geometry::Camera;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// Opens one file of a recording.
type Open = fn(&Path, &SourceOptions) -> Result<Box<dyn FrameSource>>;

/// The files of a recording in the order of their times.
pub struct Parts {
    info: SourceInfo,
    options: SourceOptions,
    open: Open,
    current: Box<dyn FrameSource>,
    rest: VecDeque<PathBuf>,
    /// Frames of the parts before.
    before: u64,
    /// Frames of this part.
    taken: u64,
    warnings: Vec<String>,
    facts: Vec<(&'static str, String)>,
    /// The camera that the images of all parts are expected to be of.
    expected_camera: Option<Camera>,
}

/// A part that was looked at.
struct Part {
    file: PathBuf,
    first: f64,
    frames: u64,
}

/// Opens a recording in several files at `path`, each as `open` does. Those without images are left out.
///
/// # Errors
/// When none of them can be opened: why the first one cannot.
pub fn open(
    path: &Path,
    files: &[PathBuf],
    options: &SourceOptions,
    open: Open,
) -> Result<Box<dyn FrameSource>> {
    if let [file] = files {
        return open(file, options);
    }
    let (mut parts, mut warnings, mut reason) = (Vec::new(), Vec::new(), None);
    for file in files {
        match open(file, options) {
            Ok(mut source) => {
                let stamps: Vec<f64> =
                    std::iter::from_fn(|| source.next_frame()).take(4).map(|f| f.timestamp).collect();
                let is_time =
                    |one: StampVerdict| if let StampVerdict::At(time) = one { Some(time) } else { None };
                let Some(first) = check_stamps(&stamps).0.into_iter().find_map(is_time) else { continue };
                parts.push(Part {
                    file: file.clone(),
                    first,
                    frames: source.info().frame_count.unwrap_or(0),
                });
            }
            Err(error) => {
                warnings.push(format!("{error:#}").lines().next().unwrap_or_default().to_owned());
                reason.get_or_insert(error);
            }
        }
    }
    parts.sort_by(|a, b| a.first.total_cmp(&b.first));
    let mut rest: VecDeque<PathBuf> = parts.iter().map(|part| part.file.clone()).collect();
    let Some(first) = rest.pop_front() else {
        return Err(reason.unwrap_or_else(|| anyhow::anyhow!("{}: there are no images", path.display())));
    };
    let current = open(&first, options)?;
    let of_first = current.info().clone();
    let mut facts = current.facts();
    facts.push(("files", format!("{} in the order of their times", parts.len())));
    let durations = parts.iter().map(|part| part.first - parts[0].first);
    let info = SourceInfo {
        path: path.to_owned(),
        frame_count: Some(parts.iter().map(|part| part.frames).sum()),
        duration: of_first.duration.map(|last| durations.fold(0.0, f64::max) + last),
        ..of_first
    };
    let options = options.clone();
    Ok(Box::new(Parts {
        info,
        options,
        open,
        current,
        rest,
        before: 0,
        taken: 0,
        warnings,
        facts,
        expected_camera: None,
    }))
}

impl FrameSource for Parts {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        loop {
            if let Some(frame) = self.current.next_frame() {
                self.taken = self.taken.max(frame.index + 1);
                return Some(SourceFrame { index: self.before + frame.index, ..frame });
            }
            let file = self.rest.pop_front()?;
            self.warnings.extend(self.current.warning());
            self.before += std::mem::take(&mut self.taken);
            match (self.open)(&file, &self.options) {
                Ok(source) => {
                    self.current = source;
                    self.expected_camera.iter().for_each(|camera| self.current.expect_camera(camera));
                }
                Err(error) => self.warnings.push(format!("{error:#}")),
            }
        }
    }

    fn warning(&self) -> Option<String> {
        let all: Vec<String> = self.warnings.iter().cloned().chain(self.current.warning()).collect();
        (!all.is_empty()).then(|| all.join("\n"))
    }

    fn expect_camera(&mut self, camera: &Camera) {
        self.expected_camera = Some(*camera);
        self.current.expect_camera(camera);
    }

    fn problems(&self) -> Vec<String> {
        self.current.problems()
    }

    fn stated_focal(&self, size: (usize, usize)) -> Option<StatedFocal> {
        self.current.stated_focal(size)
    }

    fn decodes(&self) -> bool {
        self.current.decodes()
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        self.facts.clone()
    }
}
