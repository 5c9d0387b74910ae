//! Foxglove's image and calibration messages in JSON.

use super::{ImageMessage, VideoMessage, stamp};
use crate::pictures::{Picture, RawPicture};
use anyhow::{Context, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use calib::CameraInfo;
use serde::Deserialize;

const DAMAGED: &str = "the message is damaged";

#[derive(Default, Deserialize)]
#[serde(default)]
struct Stamp {
    sec: i64,
    nsec: u32,
}

/// Both kinds of image: a raw one has an encoding.
#[derive(Deserialize)]
struct Image {
    #[serde(default)]
    timestamp: Stamp,
    data: String,
    encoding: Option<String>,
    #[serde(default)]
    width: usize,
    #[serde(default)]
    height: usize,
    #[serde(default)]
    step: usize,
}

/// `foxglove.CompressedImage` or `foxglove.RawImage`.
pub fn image(data: &[u8]) -> Result<ImageMessage> {
    let Image { timestamp, data, encoding, width, height, step } =
        serde_json::from_slice(data).context(DAMAGED)?;
    let data = STANDARD.decode(data).context(DAMAGED)?;
    let picture = match encoding {
        Some(encoding) => Picture::Raw(RawPicture { width, height, step, encoding, big_endian: false, data }),
        None => Picture::Encoded(data),
    };
    Ok(ImageMessage { stamp: stamp(timestamp.sec, timestamp.nsec), picture })
}

#[derive(Deserialize)]
struct Video {
    #[serde(default)]
    timestamp: Stamp,
    data: String,
    format: String,
}

/// `foxglove.CompressedVideo`.
pub fn video(data: &[u8]) -> Result<VideoMessage> {
    let Video { timestamp, data, format } = serde_json::from_slice(data).context(DAMAGED)?;
    let data = STANDARD.decode(data).context(DAMAGED)?;
    Ok(VideoMessage { stamp: stamp(timestamp.sec, timestamp.nsec), codec: format, data })
}

/// The numbers of a calibration.
#[derive(Deserialize)]
#[serde(rename_all = "UPPERCASE")]
struct Calibration {
    #[serde(rename = "width")]
    width: u32,
    #[serde(rename = "height")]
    height: u32,
    #[serde(rename = "distortion_model", default)]
    model: String,
    #[serde(default)]
    d: Vec<f64>,
    k: Vec<f64>,
    #[serde(default)]
    p: Vec<f64>,
}

/// `foxglove.CameraCalibration`.
pub fn calibration(data: &[u8]) -> Result<CameraInfo> {
    let Calibration { width, height, model, d, k, p } = serde_json::from_slice(data).context(DAMAGED)?;
    Ok(CameraInfo { width, height, model, d, k, p, ..CameraInfo::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raw_image_is_read() {
        let text = br#"{"timestamp":{"sec":3,"nsec":250000000},"frame_id":"c","width":2,"height":1,
            "encoding":"mono8","step":2,"data":"Bwg="}"#;
        let message = image(text).unwrap();
        assert_eq!(message.stamp, Some(3.25));
        assert_eq!(message.picture.into_grey().unwrap().data(), [7, 8]);
        assert!(image(b"{}").is_err());
    }

    #[test]
    fn a_calibration_is_read() {
        let text = br#"{"width":640,"height":480,"distortion_model":"","D":[],
            "K":[500,0,320,0,510,240,0,0,1]}"#;
        let info = calibration(text).unwrap();
        let camera = info.camera(calib::Imagery::Raw, "test").unwrap().unwrap();
        assert_eq!(camera.intrinsics().fy, 510.0);
    }
}
