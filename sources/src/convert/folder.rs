//! A folder of images with `times.txt` and `camera.yaml`.

use super::Target;
use crate::recording::{EncodedPicture, Head};
use anyhow::Result;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// A folder being filled.
pub struct FolderTarget {
    images: PathBuf,
    times: BufWriter<File>,
    count: u64,
}

impl FolderTarget {
    /// Begins it, with the files of the calibration.
    pub fn create(folder: &Path, head: &Head) -> Result<Self> {
        let images = folder.join("images");
        fs::create_dir_all(&images)?;
        let files = &head.calibration;
        if let Some(camera) = &files.camera {
            // The form is told by what is in it; only these two names are looked for.
            let name = if camera.name.ends_with(".txt") { "camera.txt" } else { "camera.yaml" };
            fs::write(folder.join(name), &camera.bytes)?;
        }
        for (name, file) in [("pcalib.txt", &files.response), ("vignette.png", &files.vignette)] {
            if let Some(file) = file {
                fs::write(folder.join(name), &file.bytes)?;
            }
        }
        let mut times = BufWriter::new(File::create(folder.join("times.txt"))?);
        writeln!(times, "# timestamp[s] image")?;
        Ok(Self { images, times, count: 0 })
    }
}

impl Target for FolderTarget {
    fn frame(&mut self, _index: u64, timestamp: f64, picture: EncodedPicture) -> Result<()> {
        let extension = match picture.format {
            "jpeg" => "jpg",
            "" => "bin",
            other => other,
        };
        let name = format!("{:06}.{extension}", self.count);
        fs::write(self.images.join(&name), &picture.bytes)?;
        // Written so, a number reads back to the same bits.
        writeln!(self.times, "{timestamp} images/{name}")?;
        self.count += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.times.flush()?;
        Ok(self.times.get_ref().sync_all()?)
    }
}
