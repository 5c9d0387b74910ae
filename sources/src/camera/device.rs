//! A camera that delivers frames, as the rest sees it.

use super::format::{PixelFormat, Size};
use crate::pictures::{Picture, RawPicture, whole_jpeg};
use std::io;
use std::time::{Duration, Instant};

/// A frame as the driver delivers it.
#[derive(Clone, Debug)]
pub struct Captured {
    /// The bytes, in the form of the [`View`].
    pub data: Vec<u8>,
    /// The driver's count of frames, those it could not deliver included.
    pub sequence: u32,
    /// Seconds of the system's monotonic clock: when the driver got the frame.
    pub timestamp: f64,
    /// The same moment.
    pub captured: Instant,
    /// Whether the driver says that the data is damaged.
    pub damaged: bool,
}

/// The format of a camera's frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The format.
    pub format: PixelFormat,
    /// The size.
    pub size: Size,
    /// Bytes from one row to the next; 0 where the driver does not say.
    pub step: u32,
    /// Frames per second, where the driver says.
    pub rate: Option<f64>,
}

/// A camera that streams.
pub trait Device: Send {
    /// The format of its frames.
    fn view(&self) -> View;

    /// The next frame; `None` when there is none within `wait`.
    ///
    /// # Errors
    /// When the camera is gone.
    fn next(&mut self, wait: Duration) -> io::Result<Option<Captured>>;
}

impl View {
    /// The picture in a frame.
    pub fn picture(&self, frame: Captured) -> Picture {
        if frame.damaged {
            return Picture::Broken("the driver says that the frame is damaged".into());
        }
        let encoding = match self.format {
            PixelFormat::Grey => "mono8",
            PixelFormat::Y16 => "mono16",
            PixelFormat::Yuyv => "yuv422_yuy2",
            PixelFormat::Uyvy => "yuv422",
            PixelFormat::Nv12 => "nv12",
            // Made whole here, so that a recording of it can be read by others too.
            PixelFormat::Mjpg => {
                return whole_jpeg(frame.data).map_or_else(Picture::Broken, Picture::Encoded);
            }
        };
        Picture::Raw(RawPicture {
            width: self.size.width as usize,
            height: self.size.height as usize,
            step: self.step as usize,
            encoding: encoding.to_owned(),
            big_endian: false,
            data: frame.data,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(format: PixelFormat, step: u32, data: &[u8]) -> Result<Vec<u8>, String> {
        let view = View { format, size: Size { width: 2, height: 2 }, step, rate: None };
        let frame = Captured {
            data: data.to_vec(),
            sequence: 0,
            timestamp: 0.0,
            captured: Instant::now(),
            damaged: false,
        };
        view.picture(frame).into_grey().map(|image| image.data().to_vec())
    }

    #[test]
    fn frames_become_grey() {
        let expected = Ok(vec![1, 2, 3, 4]);
        assert_eq!(grey(PixelFormat::Grey, 2, &[1, 2, 3, 4]), expected);
        assert_eq!(grey(PixelFormat::Grey, 4, &[1, 2, 0, 0, 3, 4, 0, 0]), expected, "padded rows");
        assert_eq!(grey(PixelFormat::Y16, 4, &[9, 1, 9, 2, 9, 3, 9, 4]), expected);
        assert_eq!(grey(PixelFormat::Yuyv, 4, &[1, 9, 2, 9, 3, 9, 4, 9]), expected);
        assert_eq!(grey(PixelFormat::Uyvy, 4, &[9, 1, 9, 2, 9, 3, 9, 4]), expected);
        assert_eq!(grey(PixelFormat::Nv12, 2, &[1, 2, 3, 4, 9, 9]), expected);
    }

    #[test]
    fn short_frames_are_refused() {
        assert!(grey(PixelFormat::Grey, 2, &[1, 2, 3]).is_err());
        assert!(grey(PixelFormat::Nv12, 2, &[1, 2, 3, 4]).is_err(), "its chroma is missing");
        assert!(grey(PixelFormat::Mjpg, 0, &[0xff, 0xd8]).is_err());
        assert!(grey(PixelFormat::Yuyv, 4, &[]).is_err());
    }
}
