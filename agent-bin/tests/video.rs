//! Video files as sources, through the binary.
#![cfg(feature = "opencv")]

mod common;

use common::*;
use opencv::core::{Mat, Size};
use opencv::prelude::*;
use opencv::videoio::VideoWriter;
use std::path::Path;
use tempfile::tempdir;

/// Motion JPEG in AVI, which OpenCV writes and reads without any codec of the system.
fn video(path: &Path, count: u32) {
    let fourcc = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let size = Size::new(WIDTH as i32, HEIGHT as i32);
    let mut writer = VideoWriter::new(arg(path), fourcc, 25.0, size, false).unwrap();
    assert!(writer.is_opened().unwrap());
    for i in 0..count {
        let pixels = picture(i).into_raw();
        let flat = Mat::from_slice(&pixels).unwrap();
        writer.write(&flat.reshape(1, HEIGHT as i32).unwrap()).unwrap();
    }
    writer.release().unwrap();
}

#[test]
fn a_video_is_read_by_its_own_times_or_by_a_given_rate() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("walk.avi");
    video(&path, 5);
    let out = tempdir().unwrap();
    assert_refused(&["run", arg(&path), "--out", arg(out.path())], &["no calibration"]);
    write(folder.path().join("walk.yaml"), CAMERA);
    let said = info(&path, &[]);
    assert_eq!((&said["frames"], &said["size"]), (&5.into(), &serde_json::json!([96, 64])));
    let close = |times: Vec<f64>, step: f64| {
        times.len() == 5 && times.iter().enumerate().all(|(i, t)| (t - i as f64 * step).abs() < 1e-6)
    };
    let times = processed_times(&read_through(&path, &[]));
    assert!(close(times.clone(), 0.04), "{times:?}");
    let times = processed_times(&read_through(&path, &["--fps", "10"]));
    assert!(close(times.clone(), 0.1), "{times:?}");
}

#[test]
fn what_is_no_video_is_refused() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("text.mp4");
    write(path.clone(), "no video");
    assert_refused(&["info", arg(&path)], &["this is text"]);
    write(path.clone(), [0u8, 1, 254, 255].repeat(100));
    assert_refused(&["info", arg(&path)], &["neither an MCAP file nor a video"]);
}
