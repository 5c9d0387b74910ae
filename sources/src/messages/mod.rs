//! Messages of recordings that hold images or calibrations.

mod cdr;
mod foxglove;
mod json;
mod ros1;
mod ros2;

use super::time;
use crate::pictures::Picture;
use anyhow::{Context, Result, bail, ensure};
use calib::CameraInfo;
use geometry::limits::MAX_BYTES;
use std::borrow::Cow;
use std::io::Read;

/// An image message, the picture not yet decoded.
#[derive(Debug)]
pub struct ImageMessage {
    /// When the image was taken, seconds; `None` when the message does not say.
    pub stamp: Option<f64>,
    /// The picture.
    pub picture: Picture,
}

/// A message of a video: what decodes to one image, once those before it are decoded.
#[derive(Debug)]
pub struct VideoMessage {
    /// When the image was taken, seconds; `None` when the message does not say.
    pub stamp: Option<f64>,
    /// The name of the codec, as the message gives it.
    pub codec: String,
    /// The codec's bytes.
    pub data: Vec<u8>,
}

/// The content of a channel's messages, and their encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Images.
    Image(Form),
    /// A video, image by image.
    Video(Form),
    /// Calibrations.
    Calibration(Form),
}

/// The schema and encoding of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// `foxglove.CompressedImage`, protobuf.
    FoxgloveCompressed,
    /// `foxglove.RawImage`, protobuf.
    FoxgloveRaw,
    /// `foxglove.CameraCalibration`, protobuf.
    FoxgloveCalibration,
    /// `foxglove.CompressedVideo`, protobuf.
    FoxgloveVideo,
    /// The same four, JSON.
    FoxgloveJson,
    /// `sensor_msgs/msg/CompressedImage`, CDR.
    Ros2Compressed,
    /// `sensor_msgs/msg/Image`, CDR.
    Ros2Raw,
    /// `sensor_msgs/msg/CameraInfo`, CDR.
    Ros2CameraInfo,
    /// `foxglove_msgs/msg/CompressedVideo`, CDR.
    Ros2Video,
    /// `ffmpeg_image_transport_msgs/msg/FFMPEGPacket`, CDR.
    Ros2Packet,
    /// `sensor_msgs/CompressedImage` of ROS 1.
    Ros1Compressed,
    /// `sensor_msgs/Image` of ROS 1.
    Ros1Raw,
    /// `sensor_msgs/CameraInfo` of ROS 1.
    Ros1CameraInfo,
}

impl Content {
    /// The form of calibrations, where it is that.
    pub fn calibration(self) -> Option<Form> {
        match self {
            Self::Calibration(form) => Some(form),
            Self::Image(_) | Self::Video(_) => None,
        }
    }

    /// The content of messages of `schema` in `encoding`; `None` for anything but images and calibrations.
    pub fn of(schema: &str, encoding: &str) -> Option<Self> {
        Some(match (schema, encoding) {
            ("foxglove.CompressedImage", "protobuf") => Self::Image(Form::FoxgloveCompressed),
            ("foxglove.RawImage", "protobuf") => Self::Image(Form::FoxgloveRaw),
            ("foxglove.CameraCalibration", "protobuf") => Self::Calibration(Form::FoxgloveCalibration),
            ("foxglove.CompressedVideo", "protobuf") => Self::Video(Form::FoxgloveVideo),
            ("foxglove.CompressedVideo", "json") => Self::Video(Form::FoxgloveJson),
            ("foxglove_msgs/msg/CompressedVideo", "cdr") => Self::Video(Form::Ros2Video),
            ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "cdr") => Self::Video(Form::Ros2Packet),
            ("foxglove.CompressedImage" | "foxglove.RawImage", "json") => Self::Image(Form::FoxgloveJson),
            ("foxglove.CameraCalibration", "json") => Self::Calibration(Form::FoxgloveJson),
            ("sensor_msgs/msg/CompressedImage", "cdr") => Self::Image(Form::Ros2Compressed),
            ("sensor_msgs/msg/Image", "cdr") => Self::Image(Form::Ros2Raw),
            ("sensor_msgs/msg/CameraInfo", "cdr") => Self::Calibration(Form::Ros2CameraInfo),
            ("sensor_msgs/CompressedImage", "ros1") => Self::Image(Form::Ros1Compressed),
            ("sensor_msgs/Image", "ros1") => Self::Image(Form::Ros1Raw),
            ("sensor_msgs/CameraInfo", "ros1") => Self::Calibration(Form::Ros1CameraInfo),
            _ => return None,
        })
    }
}

/// What starts every frame of zstd (RFC 8878, §3.1.1); CDR starts with a zero, and messages of Foxglove with other fields.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// The bytes of a message, which may have been compressed by itself, as `ros2 bag record --compression-mode message` does.
///
/// # Errors
/// When it does not unpack, or is larger than messages are.
pub fn unpacked(data: &[u8]) -> Result<Cow<'_, [u8]>> {
    if !data.starts_with(&ZSTD_MAGIC) {
        return Ok(Cow::Borrowed(data));
    }
    let (mut plain, most) = (Vec::new(), MAX_BYTES as u64);
    let read = zstd::Decoder::new(data)?.take(most + 1).read_to_end(&mut plain);
    read.context("the message does not unpack")?;
    ensure!(plain.len() as u64 <= most, "it has more than {MAX_BYTES} bytes, the most that is read");
    Ok(Cow::Owned(plain))
}

/// Reads an image message.
///
/// # Errors
/// When the bytes are not of that form.
pub fn read_image(form: Form, data: &[u8]) -> Result<ImageMessage> {
    match form {
        Form::FoxgloveCompressed => foxglove::compressed(data),
        Form::FoxgloveRaw => foxglove::raw(data),
        Form::FoxgloveJson => json::image(data),
        Form::Ros2Compressed => ros2::compressed(data),
        Form::Ros2Raw => ros2::raw(data),
        Form::Ros1Compressed => ros1::compressed(data),
        Form::Ros1Raw => ros1::raw(data),
        Form::FoxgloveCalibration
        | Form::FoxgloveVideo
        | Form::Ros2CameraInfo
        | Form::Ros2Video
        | Form::Ros2Packet
        | Form::Ros1CameraInfo => bail!("the message is no image by itself"),
    }
}

/// Reads a message of a video.
///
/// # Errors
/// When the bytes are not of that form.
pub fn read_video(form: Form, data: &[u8]) -> Result<VideoMessage> {
    match form {
        Form::FoxgloveVideo => foxglove::video(data),
        Form::FoxgloveJson => json::video(data),
        Form::Ros2Video => ros2::video(data),
        Form::Ros2Packet => ros2::packet(data),
        _ => bail!("the message is of no video"),
    }
}

/// Reads a calibration message.
///
/// # Errors
/// When the bytes are not of that form.
pub fn read_calibration(form: Form, data: &[u8]) -> Result<CameraInfo> {
    match form {
        Form::FoxgloveCalibration => foxglove::calibration(data),
        Form::FoxgloveJson => json::calibration(data),
        Form::Ros2CameraInfo => ros2::camera_info(data),
        Form::Ros1CameraInfo => ros1::camera_info(data),
        _ => bail!("the message is no calibration"),
    }
}

/// Seconds of a stamp; zero means that nobody set it.
fn stamp(seconds: i64, nanoseconds: u32) -> Option<f64> {
    if seconds == 0 && nanoseconds == 0 {
        return None;
    }
    let total = u64::try_from(seconds)
        .ok()
        .and_then(|s| s.checked_mul(1_000_000_000)?.checked_add(nanoseconds.into()));
    Some(total.map_or(seconds as f64 + nanoseconds as f64 * 1e-9, time::seconds))
}
