//! Video files, through the system's OpenCV.

use super::Target;
use crate::pictures::Picture;
use crate::recording::EncodedPicture;
use anyhow::{Result, anyhow, bail};
use geometry::GrayImage;
use opencv::core::{Mat, Size};
use opencv::prelude::*;
use opencv::videoio::{CAP_FFMPEG, VideoWriter};
use std::path::{Path, PathBuf};

/// A video being written; it is begun with the first frame, which tells the size.
pub struct VideoTarget {
    path: PathBuf,
    rate: f64,
    writer: Option<(VideoWriter, Size)>,
}

impl VideoTarget {
    /// A video of `rate` frames per second.
    pub fn new(path: &Path, rate: f64) -> Self {
        Self { path: path.to_owned(), rate, writer: None }
    }

    fn writer(&mut self, size: Size) -> Result<&mut VideoWriter> {
        if self.writer.is_none() {
            let name = self.path.to_str().ok_or_else(|| anyhow!("the name is not UTF-8"))?;
            let codec = if name.ends_with(".mp4") { ['m', 'p', '4', 'v'] } else { ['F', 'F', 'V', '1'] };
            let [a, b, c, d] = codec;
            let fourcc = VideoWriter::fourcc(a, b, c, d)?;
            let writer = VideoWriter::new_with_backend(name, CAP_FFMPEG, fourcc, self.rate, size, false)?;
            if !writer.is_opened()? {
                bail!("OpenCV cannot write this kind of video\nhint: end the name in .avi or .mkv");
            }
            self.writer = Some((writer, size));
        }
        match &mut self.writer {
            Some((writer, known)) if *known == size => Ok(writer),
            _ => bail!("its size is not that of the frames before, which a video needs"),
        }
    }
}

impl Target for VideoTarget {
    fn frame(&mut self, _index: u64, _timestamp: f64, picture: EncodedPicture) -> Result<()> {
        let image: GrayImage =
            Picture::Encoded(picture.bytes).into_grey().map_err(|reason| anyhow!(reason))?;
        let size = Size::new(i32::try_from(image.width())?, i32::try_from(image.height())?);
        let rows = Mat::from_slice(image.data())?;
        let grey = rows.reshape(1, size.height)?;
        Ok(self.writer(size)?.write(&grey)?)
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        if let Some((writer, _)) = &mut self.writer {
            writer.release()?;
        }
        Ok(())
    }
}
