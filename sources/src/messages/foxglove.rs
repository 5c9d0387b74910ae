//! Foxglove's image and calibration messages in protobuf.

use super::{ImageMessage, VideoMessage, stamp};
use crate::pictures::{Picture, RawPicture};
use anyhow::{Result, anyhow};
use calib::CameraInfo;
use foxglove::Decode;
use foxglove::messages::{CameraCalibration, CompressedImage, CompressedVideo, RawImage, Timestamp};

fn decode<T: Decode>(data: &[u8]) -> Result<T> {
    T::decode(data).map_err(|error| anyhow!("the message is damaged: {error}"))
}

fn seconds(timestamp: Option<Timestamp>) -> Option<f64> {
    timestamp.and_then(|t| stamp(t.sec().into(), t.nsec()))
}

/// `foxglove.CompressedImage`.
pub fn compressed(data: &[u8]) -> Result<ImageMessage> {
    let message: CompressedImage = decode(data)?;
    Ok(ImageMessage { stamp: seconds(message.timestamp), picture: Picture::Encoded(message.data.to_vec()) })
}

/// `foxglove.RawImage`.
pub fn raw(data: &[u8]) -> Result<ImageMessage> {
    let message: RawImage = decode(data)?;
    let picture = Picture::Raw(RawPicture {
        width: message.width as usize,
        height: message.height as usize,
        step: message.step as usize,
        encoding: message.encoding,
        big_endian: false,
        data: message.data.to_vec(),
    });
    Ok(ImageMessage { stamp: seconds(message.timestamp), picture })
}

/// `foxglove.CompressedVideo`.
pub fn video(data: &[u8]) -> Result<VideoMessage> {
    let message: CompressedVideo = decode(data)?;
    let stamp = seconds(message.timestamp);
    Ok(VideoMessage { stamp, codec: message.format, data: message.data.to_vec() })
}

/// `foxglove.CameraCalibration`.
pub fn calibration(data: &[u8]) -> Result<CameraInfo> {
    let message: CameraCalibration = decode(data)?;
    Ok(CameraInfo {
        width: message.width,
        height: message.height,
        model: message.distortion_model,
        d: message.d,
        k: message.k,
        p: message.p,
        ..CameraInfo::default()
    })
}
