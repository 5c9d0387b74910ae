//! The options of a live camera.

use super::format::{PixelFormat, Size};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Options of commands that can take their images from a camera.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct CameraArgs {
    /// Take images from this camera, such as /dev/video0; `loopbox cameras` lists them
    #[cfg_attr(feature = "clap", arg(long, value_name = "DEVICE"))]
    pub camera: Option<PathBuf>,
    /// Size of the camera's images; default: that of the calibration, else the one nearest to 640x480
    #[cfg_attr(feature = "clap", arg(long, value_name = "WxH", requires = "camera"))]
    pub size: Option<Size>,
    /// Frames per second: of the camera (default 30), or of images without time stamps
    #[cfg_attr(feature = "clap", arg(long, value_name = "RATE", allow_negative_numbers = true))]
    pub fps: Option<f64>,
    /// Pixel format of the camera: auto, GREY, Y16, YUYV, UYVY, NV12 or MJPG
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "FORMAT", default_value = "auto", requires = "camera")
    )]
    pub format: RequestedFormat,
    /// Keep these at their present values instead of automatic, and undo that in the end
    #[cfg_attr(
        feature = "clap",
        arg(long, value_enum, value_name = "WHAT", value_delimiter = ',', requires = "camera")
    )]
    pub lock: Vec<Lockable>,
    /// When the camera is unplugged, wait for it and go on
    #[cfg_attr(feature = "clap", arg(long, requires = "camera"))]
    pub reconnect: bool,
    /// Stop so many seconds after the first frame
    #[cfg_attr(feature = "clap", arg(long, value_name = "SECONDS", allow_negative_numbers = true))]
    pub duration: Option<f64>,
}

/// A pixel format, or the one that suits best.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RequestedFormat(pub Option<PixelFormat>);

impl FromStr for RequestedFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.eq_ignore_ascii_case("auto") {
            return Ok(Self(None));
        }
        if ["tum", "kitti"].contains(&text) {
            return Err(format!(
                "this is the camera's pixel format; the trajectory's form is --trajectory {text}"
            ));
        }
        let found = PixelFormat::ALL.into_iter().find(|format| format.name().eq_ignore_ascii_case(text));
        found
            .map(|format| Self(Some(format)))
            .ok_or_else(|| "not auto, GREY, Y16, YUYV, UYVY, NV12 or MJPG".into())
    }
}

/// An automatic control of a camera that direct tracking does not want.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Lockable {
    /// Exposure time
    Exposure,
    /// Gain of the sensor
    Gain,
    /// Colour balance, which changes grey levels too
    WhiteBalance,
    /// Focus, which changes the focal length
    Focus,
    /// All of them
    All,
}

impl Lockable {
    /// Those that can be locked one by one.
    pub const EACH: [Self; 4] = [Self::Exposure, Self::Gain, Self::WhiteBalance, Self::Focus];

    /// Its name in options and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exposure => "exposure",
            Self::Gain => "gain",
            Self::WhiteBalance => "white balance",
            Self::Focus => "focus",
            Self::All => "all",
        }
    }
}

impl FromStr for Lockable {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = [Self::All].into_iter().chain(Self::EACH);
        let found = all.into_iter().find(|each| each.name().replace(' ', "-") == text);
        found.ok_or_else(|| "not exposure, gain, white-balance, focus or all".into())
    }
}

impl CameraArgs {
    /// The camera's device node; a bare number is that of `/dev/video`.
    pub fn path(&self) -> Option<PathBuf> {
        let path = self.camera.as_ref()?;
        let number =
            path.to_str().filter(|text| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit()));
        Some(number.map_or_else(|| path.clone(), |number| PathBuf::from(format!("/dev/video{number}"))))
    }

    /// Refuses when neither a recording nor a camera is named.
    ///
    /// # Errors
    /// The error says what to name.
    pub fn needed(&self) -> Result<()> {
        if self.camera.is_none() {
            bail!(
                "no source of images\nhint: name a recording, or a camera with --camera; `loopbox cameras` lists them"
            );
        }
        Ok(())
    }

    /// Refuses what only a camera could do, where a recording is named.
    ///
    /// # Errors
    /// Names the option.
    pub fn not_needed(&self) -> Result<()> {
        let given = [
            ("--reconnect", self.reconnect),
            ("--lock", !self.lock.is_empty()),
            ("--size", self.size.is_some()),
        ];
        if let Some((option, _)) = given.into_iter().find(|(_, given)| *given) {
            bail!("{option} is for cameras\nhint: name one with --camera instead of a recording");
        }
        Ok(())
    }

    /// Refuses numbers that make no sense.
    ///
    /// # Errors
    /// Names the option.
    pub fn check(&self) -> Result<()> {
        if let Some(fps) = self.fps
            && !(0.01..=1e5).contains(&fps)
        {
            bail!("--fps {fps} is not a frame rate\nhint: give frames per second, such as --fps 30");
        }
        if let Some(duration) = self.duration
            && !(duration > 0.0 && duration <= 1e9)
        {
            bail!("--duration {duration} is not a time\nhint: give seconds, such as --duration 60");
        }
        Ok(())
    }

    /// The same options at the size of the calibration; unchanged without a calibration.
    ///
    /// # Errors
    /// When the calibration cannot be read, or another size is requested.
    pub fn for_calibration(mut self, calibration: Option<&Path>) -> Result<Self> {
        let Some(file) = calibration else { return Ok(self) };
        let pinhole = *calib::read_camera(file)?.camera.intrinsics();
        let calibrated = Size { width: pinhole.width as u32, height: pinhole.height as u32 };
        let size = *self.size.get_or_insert(calibrated);
        if size != calibrated {
            bail!(
                "--size {size} does not fit {}, which is for {calibrated}\nhint: leave --size out, or calibrate at \
                 that size",
                file.display()
            );
        }
        Ok(self)
    }

    /// The controls to lock, one by one.
    pub fn locks(&self) -> Vec<Lockable> {
        let all = self.lock.contains(&Lockable::All);
        Lockable::EACH.into_iter().filter(|each| all || self.lock.contains(each)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_understood() {
        assert_eq!("auto".parse(), Ok(RequestedFormat(None)));
        assert_eq!("yuyv".parse(), Ok(RequestedFormat(Some(PixelFormat::Yuyv))));
        assert_eq!("Y16".parse(), Ok(RequestedFormat(Some(PixelFormat::Y16))));
        assert!("H264".parse::<RequestedFormat>().is_err());
        assert_eq!("white-balance".parse(), Ok(Lockable::WhiteBalance));
        assert_eq!(("all".parse(), "iris".parse::<Lockable>().is_err()), (Ok(Lockable::All), true));
        assert!("kitti".parse::<RequestedFormat>().unwrap_err().contains("--trajectory kitti"));
        let args = |camera: &str| CameraArgs { camera: Some(camera.into()), ..CameraArgs::default() };
        assert_eq!(args("2").path().unwrap(), PathBuf::from("/dev/video2"));
        assert_eq!(args("/dev/v4l/by-id/x").path().unwrap(), PathBuf::from("/dev/v4l/by-id/x"));
        let locks = |lock: &[Lockable]| CameraArgs { lock: lock.to_vec(), ..CameraArgs::default() }.locks();
        assert_eq!(locks(&[Lockable::All]), Lockable::EACH);
        assert_eq!(locks(&[Lockable::Focus, Lockable::Gain]), [Lockable::Gain, Lockable::Focus]);
    }

    #[test]
    fn numbers_without_sense_are_refused() {
        let base = CameraArgs::default();
        assert!(base.check().is_ok());
        for (fps, duration) in
            [(Some(0.0), None), (Some(f64::NAN), None), (None, Some(-1.0)), (None, Some(f64::NAN))]
        {
            assert!(CameraArgs { fps, duration, ..base.clone() }.check().is_err(), "{fps:?} {duration:?}");
        }
    }
}
