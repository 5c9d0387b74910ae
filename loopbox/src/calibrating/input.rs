//! Where the images of the board come from.

use anyhow::{Result, bail};
use geometry::GrayImage;
use sources::camera::{CameraArgs, open_camera};
use sources::notice::Listener;
use sources::pictures::Picture;
use sources::{FrameSource, SourceOptions, images_in, is_image};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What the user names.
#[derive(Clone, Debug)]
pub enum Input {
    /// Image files, a folder of them, or one recording.
    Paths(Vec<PathBuf>),
    /// A camera.
    Camera(CameraArgs),
}

/// The images, one by one.
pub enum Shots {
    /// Files: each is meant to count.
    Files(std::vec::IntoIter<PathBuf>),
    /// Frames of a recording or camera: those that show something new count.
    Frames(Box<dyn FrameSource>),
}

impl Shots {
    /// Opens what the user names.
    ///
    /// # Errors
    /// When there is nothing there, or it is neither images nor a recording.
    pub fn open(input: &Input, options: &SourceOptions) -> Result<Self> {
        let paths = match input {
            Input::Camera(camera) => return Ok(Self::Frames(open_camera(camera)?)),
            Input::Paths(paths) => paths,
        };
        if let [path] = &paths[..]
            && (path.is_dir() || !is_image(path))
        {
            return Self::of_one(path, options);
        }
        if let Some(path) = paths.iter().find(|path| !path.is_file()) {
            bail!(
                "{}: there is no such file\nhint: give image files, one folder or one recording",
                path.display()
            );
        }
        Ok(Self::Files(paths.clone().into_iter()))
    }

    fn of_one(path: &Path, options: &SourceOptions) -> Result<Self> {
        // A folder that says when its images were taken is a recording.
        let timed = ["times.txt", "rgb.txt", "mav0", "data.csv"].iter().any(|name| path.join(name).exists());
        if path.is_dir() && !timed {
            for folder in [path.to_owned(), path.join("images")] {
                let images = if folder.is_dir() { images_in(&folder)? } else { Vec::new() };
                if !images.is_empty() {
                    return Ok(Self::Files(images.into_iter()));
                }
            }
        }
        Ok(Self::Frames(sources::open(path, options)?))
    }

    /// Where notices of a camera go.
    pub fn listen(&mut self, listener: Listener) {
        if let Self::Frames(source) = self {
            source.listen(listener);
        }
    }

    /// What ends the wait for a camera's images.
    pub fn stopper(&self) -> Option<Arc<AtomicBool>> {
        match self {
            Self::Files(_) => None,
            Self::Frames(source) => source.stopper(),
        }
    }

    /// Whether only what shows something new counts.
    pub fn is_stream(&self) -> bool {
        matches!(self, Self::Frames(_))
    }

    /// Whether the images come when they come.
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Frames(source) if source.is_live())
    }

    /// The next image with its name, or why it cannot be read.
    pub fn next_shot(&mut self) -> Option<(String, Result<GrayImage, String>)> {
        match self {
            Self::Files(paths) => {
                let path = paths.next()?;
                let name =
                    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
                Some((name, Picture::File(path).into_grey()))
            }
            Self::Frames(source) => {
                let frame = source.next_frame()?;
                Some((format!("frame {}", frame.index), frame.picture.into_grey()))
            }
        }
    }
}
