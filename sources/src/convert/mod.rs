//! Recordings turned from one form into another.

mod bag;
mod folder;
mod mcap;
mod video;

use crate::recording::{CalibrationFiles, EncodedPicture, Head};
use anyhow::{Context, Result, bail};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// A form of recording that is written.
pub trait Target {
    /// Writes a frame: its index at the source, its time in seconds, its picture.
    ///
    /// # Errors
    /// When it cannot be written, or the format cannot hold it.
    fn frame(&mut self, index: u64, timestamp: f64, picture: EncodedPicture) -> Result<()>;

    /// Ends the recording, which is whole on the disk then, though still under its temporary name.
    ///
    /// # Errors
    /// When it cannot be written.
    fn finish(self: Box<Self>) -> Result<()>;
}

/// The forms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// MCAP as `loopbox record` writes it.
    Mcap,
    /// ROS 1 bag.
    Bag,
    /// Video file.
    Video,
    /// Folder of images with `times.txt`.
    Folder,
}

impl Kind {
    /// The form by a path's extension; without one, a folder.
    ///
    /// # Errors
    /// When the extension is that of no known form.
    pub fn of(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        Ok(match extension.as_str() {
            "mcap" => Self::Mcap,
            "bag" => Self::Bag,
            "avi" | "mkv" | "mp4" => Self::Video,
            "" => Self::Folder,
            "zip" | "tar" | "gz" | "db3" | "mov" | "webm" | "yaml" | "txt" | "png" | "jpg" => bail!(
                "{}: nothing is known of writing .{extension}\nhint: end the name in .mcap, .bag, .avi or .mkv; \
                 without such an end it is a folder of images",
                path.display()
            ),
            _ => Self::Folder,
        })
    }

    /// What such a recording loses, for people.
    pub fn loses(self, calibration: &CalibrationFiles) -> Vec<String> {
        let photometric = calibration.response.is_some() || calibration.vignette.is_some();
        let mut lost = Vec::new();
        match self {
            Self::Mcap => {}
            Self::Bag if photometric => lost.push("a bag holds no response and no vignette".to_owned()),
            Self::Bag => {}
            Self::Folder if photometric => lost.push(
                "a run over the folder needs --response and --vignette, which lie in it as pcalib.txt and \
                 vignette.png"
                    .to_owned(),
            ),
            Self::Folder => {}
            Self::Video => {
                lost.push(
                    "a video has a rate for time stamps, and its codec may round grey levels".to_owned(),
                );
                if photometric {
                    lost.push("a video holds no response and no vignette".to_owned());
                }
            }
        }
        lost
    }
}

/// A recording that is being written beside its final place.
pub struct Draft {
    out: PathBuf,
    temporary: PathBuf,
    kind: Kind,
    target: Option<Box<dyn Target>>,
}

impl Draft {
    /// Begins a recording of `rate` frames per second, where that is known.
    ///
    /// # Errors
    /// When it cannot be made, or this program cannot write the form.
    pub fn begin(out: &Path, head: &Head, rate: Option<f64>) -> Result<Self> {
        let kind = Kind::of(out)?;
        let temporary = temporary(out, kind)?;
        discard(&temporary);
        let draft = Self { out: out.to_owned(), temporary, kind, target: None };
        let target = open(kind, &draft.temporary, head, rate);
        let target = Some(target.with_context(|| format!("{}: cannot be written", out.display()))?);
        // Moved by hand: `draft` removes what it began when dropped.
        let mut draft = draft;
        draft.target = target;
        Ok(draft)
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// When it cannot be written, or the format cannot hold it.
    pub fn frame(&mut self, index: u64, timestamp: f64, picture: EncodedPicture) -> Result<()> {
        let Some(target) = &mut self.target else { bail!("the recording has ended") };
        let written = target.frame(index, timestamp, picture);
        written.with_context(|| format!("{}: frame {index} cannot be written", self.out.display()))
    }

    /// Ends the recording and gives it its name.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self, calibration: &CalibrationFiles) -> Result<()> {
        let Some(target) = self.target.take() else { bail!("the recording has ended") };
        let named = || -> Result<()> {
            target.finish()?;
            std::fs::rename(&self.temporary, &self.out)?;
            if let (Kind::Video, Some(file)) = (self.kind, &calibration.camera) {
                // Where the video source looks for it.
                std::fs::write(self.out.with_extension("yaml"), &file.bytes)?;
            }
            Ok(())
        };
        named().with_context(|| format!("{}: cannot be written", self.out.display()))
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        self.target = None;
        discard(&self.temporary);
    }
}

/// `walk.tmp.avi` for `walk.avi`, since ffmpeg tells the container by the end of the name.
fn temporary(out: &Path, kind: Kind) -> Result<PathBuf> {
    let name = out.file_name().with_context(|| format!("{}: the path names no file", out.display()))?;
    let mut temporary = OsString::from(name);
    temporary.push(".tmp");
    if let (Kind::Video, Some(extension)) = (kind, out.extension()) {
        temporary.push(".");
        temporary.push(extension);
    }
    Ok(out.with_file_name(temporary))
}

/// Removes what an earlier attempt or this one left.
fn discard(temporary: &Path) {
    // Most often there is nothing; what cannot be removed shows when it is written over.
    let _ =
        if temporary.is_dir() { std::fs::remove_dir_all(temporary) } else { std::fs::remove_file(temporary) };
}

fn open(kind: Kind, path: &Path, head: &Head, rate: Option<f64>) -> Result<Box<dyn Target>> {
    Ok(match kind {
        Kind::Mcap => Box::new(mcap::McapTarget::create(path, head)?),
        Kind::Bag => Box::new(bag::BagTarget::create(path, head)?),
        Kind::Folder => Box::new(folder::FolderTarget::create(path, head)?),
        Kind::Video => return open_video(path, rate),
    })
}

fn open_video(path: &Path, rate: Option<f64>) -> Result<Box<dyn Target>> {
    let Some(rate) = rate else {
        bail!("the rate of the frames is not known, which a video needs\nhint: give it, such as --fps 30");
    };
    Ok(Box::new(video::VideoTarget::new(path, rate)))
}
