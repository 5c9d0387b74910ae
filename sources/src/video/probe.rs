//! The description of a video file by `ffprobe`.

use crate::ffmpeg;
use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;
use std::path::Path;

/// The first stream of moving images in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Width and height, pixels, as the frames are shown: rotated if the file says so.
    pub size: (usize, usize),
    /// Whether the frames have no colour.
    pub grey: bool,
    /// The stream's first time stamp, in `time_base`.
    pub start: i64,
    /// Seconds of a tick, as numerator and denominator.
    pub time_base: (i64, i64),
    /// Frames per second on average, where the file says so.
    pub rate: Option<f64>,
    /// Number of frames: counted by the file, or by its duration and rate.
    pub frames: Option<u64>,
}

#[derive(Deserialize)]
struct Answer {
    #[serde(default)]
    streams: Vec<Stream>,
    #[serde(default)]
    format: Format,
}

#[derive(Deserialize, Default)]
struct Format {
    duration: Option<String>,
}

#[derive(Deserialize)]
struct Stream {
    width: Option<usize>,
    height: Option<usize>,
    pix_fmt: Option<String>,
    time_base: Option<String>,
    start_pts: Option<i64>,
    avg_frame_rate: Option<String>,
    r_frame_rate: Option<String>,
    nb_frames: Option<String>,
    duration: Option<String>,
    #[serde(default)]
    side_data_list: Vec<SideData>,
}

#[derive(Deserialize)]
struct SideData {
    rotation: Option<f64>,
}

/// Runs `ffprobe` on a file.
///
/// # Errors
/// When it is not installed, or finds no video there.
pub fn probe(path: &Path) -> Result<Probe> {
    let mut command = ffmpeg::command("ffprobe");
    // Playlists may not lead elsewhere.
    command.args(["-v", "error", "-protocol_whitelist", "file", "-select_streams", "V:0"]);
    command.args(["-show_streams", "-show_format", "-of", "json"]).arg(ffmpeg::file_name(path));
    parsed(&ffmpeg::output(&mut command)?)
}

fn parsed(answer: &[u8]) -> Result<Probe> {
    let answer: Answer = serde_json::from_slice(answer).context("what ffprobe says of it cannot be read")?;
    let Some(stream) = answer.streams.first() else { bail!("there is no video in it") };
    let (Some(width @ 1..), Some(height @ 1..)) = (stream.width, stream.height) else {
        bail!("the size of its frames is not known")
    };
    let turned = stream.side_data_list.iter().find_map(|data| data.rotation).unwrap_or(0.0);
    let upright = (turned / 90.0).round() as i64 % 2 == 0;
    let rate = [&stream.avg_frame_rate, &stream.r_frame_rate].into_iter().flatten();
    let rate =
        rate.filter_map(|rate| fraction(rate)).map(|(n, d)| n as f64 / d as f64).find(|rate| *rate > 0.0);
    let number =
        |text: &Option<String>| text.as_deref()?.parse::<f64>().ok().filter(|n| n.is_finite() && *n > 0.0);
    let counted = number(&stream.nb_frames);
    let lasting = number(&stream.duration).or_else(|| number(&answer.format.duration));
    let frames = counted.or_else(|| Some((lasting? * rate?).round()));
    Ok(Probe {
        size: if upright { (width, height) } else { (height, width) },
        grey: stream.pix_fmt.as_deref().is_some_and(|name| name.starts_with("gray")),
        start: stream.start_pts.unwrap_or(0),
        time_base: stream
            .time_base
            .as_deref()
            .and_then(fraction)
            .ok_or_else(|| anyhow!("its clock is not known"))?,
        rate,
        frames: frames.map(|count| count as u64),
    })
}

/// `30000/1001`, the denominator above zero.
pub fn fraction(text: &str) -> Option<(i64, i64)> {
    let (n, d) = text.split_once('/')?;
    let (n, d) = (n.trim().parse().ok()?, d.trim().parse().ok()?);
    (d > 0).then_some((n, d))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TELEPHONE: &str = r#"{"streams": [{"width": 1920, "height": 1080, "pix_fmt": "yuv420p10le", "time_base": "1/600",
        "start_pts": 20, "avg_frame_rate": "17980/599", "r_frame_rate": "30/1", "nb_frames": "899",
        "side_data_list": [{"side_data_type": "Display Matrix", "rotation": -90}]}], "format": {"duration": "29.9"}}"#;

    #[test]
    fn a_telephones_video_stands_upright() {
        let probe = parsed(TELEPHONE.as_bytes()).unwrap();
        assert_eq!((probe.size, probe.start, probe.time_base), ((1080, 1920), 20, (1, 600)));
        assert_eq!((probe.grey, probe.frames), (false, Some(899)));
        assert!((probe.rate.unwrap() - 30.0167).abs() < 1e-3);
        let half_rotation = TELEPHONE.replace("-90", "-180");
        assert_eq!(parsed(half_rotation.as_bytes()).unwrap().size, (1920, 1080));
    }

    #[test]
    fn frames_that_are_not_counted_follow_from_duration_and_rate() {
        let matroska = TELEPHONE.replace("\"nb_frames\": \"899\",", "").replace("17980/599", "0/0");
        let probe = parsed(matroska.as_bytes()).unwrap();
        assert_eq!((probe.frames, probe.rate), (Some(897), Some(30.0)));
    }

    #[test]
    fn what_lacks_images_is_refused() {
        let error = |text: &str| parsed(text.as_bytes()).unwrap_err().to_string();
        assert!(error(r#"{"streams": [], "format": {}}"#).contains("no video"));
        assert!(error(&TELEPHONE.replace("1080", "0")).contains("size"));
        assert!(error("not JSON").contains("cannot be read"));
    }
}
