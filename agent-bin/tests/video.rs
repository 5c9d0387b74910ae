//! Video files as sources, through the binary.

mod common;

use common::*;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use tempfile::tempdir;

/// A video of `count` pictures, 25 a second, written by ffmpeg with these options.
fn video(path: &Path, count: u32, options: &[&str]) {
    let size = format!("{WIDTH}x{HEIGHT}");
    let mut ffmpeg = Command::new("ffmpeg")
        .args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pixel_format", "gray", "-video_size", &size])
        .args(["-framerate", "25", "-i", "pipe:0"])
        .args(options)
        .arg(path)
        .stdin(Stdio::piped())
        .spawn()
        .expect("these tests need ffmpeg: apt install ffmpeg");
    let mut input = ffmpeg.stdin.take().expect("it was asked for");
    (0..count).for_each(|i| input.write_all(&picture(i).into_raw()).expect("ffmpeg reads"));
    drop(input);
    assert!(ffmpeg.wait().expect("it ends").success(), "{options:?}");
}

/// The frames' times with their sizes and grey levels.
fn frames(path: &Path) -> (Vec<f64>, Vec<geometry::GrayImage>, Option<String>) {
    let mut source = sources::open(path, &sources::SourceOptions::default()).expect("it is a video");
    let read =
        |frame: sources::SourceFrame| (frame.timestamp, frame.picture.into_grey().expect("it decodes"));
    let (times, images) = std::iter::from_fn(|| source.next_frame()).map(read).unzip();
    (times, images, source.warning())
}

fn assert_close(times: &[f64], expected: &[f64]) {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-9;
    assert!(times.len() == expected.len() && times.iter().zip(expected).all(near), "{times:?}\n{expected:?}");
}

#[test]
fn a_video_is_read_by_its_own_times_or_by_a_given_rate() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("walk.avi");
    video(&path, 5, &["-c:v", "mjpeg", "-pix_fmt", "yuvj420p"]);
    let out = tempdir().unwrap();
    assert_refused(&["run", arg(&path), "--out", arg(out.path())], &["no calibration"]);
    write(folder.path().join("walk.yaml"), CAMERA);
    let printed = info(&path, &[]);
    assert_eq!((&printed["frames"], &printed["size"]), (&5.into(), &serde_json::json!([96, 64])));
    let close = |times: Vec<f64>, step: f64| {
        times.len() == 5 && times.iter().enumerate().all(|(i, t)| (t - i as f64 * step).abs() < 1e-6)
    };
    let times = processed_times(&read_through(&path, &[]));
    assert!(close(times.clone(), 0.04), "{times:?}");
    let times = processed_times(&read_through(&path, &["--fps", "10"]));
    assert!(close(times.clone(), 0.1), "{times:?}");
}

#[test]
fn frames_keep_their_uneven_times_and_grey_levels() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("uneven.mkv");
    // At 0, 40, 160, 360 and 640 ms, and all of it two seconds later: the first frame is where time begins.
    video(&path, 5, &["-vf", "settb=1/1000,setpts=40*N*N+2000", "-c:v", "ffv1", "-pix_fmt", "gray"]);
    let (times, images, warning) = frames(&path);
    assert_close(&times, &[0.0, 0.04, 0.16, 0.36, 0.64]);
    for (i, image) in images.iter().enumerate() {
        assert_eq!(image.data(), picture(i as u32).into_raw(), "frame {i}");
    }
    assert_eq!(warning, None);
}

#[test]
fn ten_bits_and_colours_become_the_same_grey() {
    let folder = tempdir().unwrap();
    for format in ["yuv420p10le", "bgr0"] {
        let path = folder.path().join(format!("{format}.mkv"));
        video(&path, 3, &["-c:v", "ffv1", "-pix_fmt", format]);
        let (times, images, _) = frames(&path);
        assert_close(&times, &[0.0, 0.04, 0.08]);
        for (i, image) in images.iter().enumerate() {
            let expected = picture(i as u32).into_raw();
            let worst = image.data().iter().zip(expected).map(|(a, b)| a.abs_diff(b)).max();
            assert!(worst <= Some(2), "{format}: {worst:?}");
        }
    }
}

/// Telephones keep the sensor's rows and write into the file how it was held.
#[test]
fn a_video_in_colour_gives_the_colours_of_its_frames() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("red.mkv");
    let colors = |path: &Path| {
        let mut source = sources::open(path, &sources::SourceOptions::default()).expect("it is a video");
        let frame = source.next_frame().expect("a frame");
        let (_, color) = frame.picture.into_grey_and_color().expect("it decodes");
        color.and_then(|color| color.planes())
    };
    let red =
        ["-vf", "format=rgb24,colorchannelmixer=rr=1:gg=0.5:bb=0.5", "-c:v", "ffv1", "-pix_fmt", "bgr0"];
    video(&path, 2, &red);
    let (luma, planes) = colors(&path).expect("it is in colour");
    assert_eq!(luma, map::Luma::Rec709);
    for (i, level) in picture(0).into_raw().into_iter().enumerate() {
        let expected = luma.differences([level, level / 2, level / 2]);
        let found = [planes[0].data()[i], planes[1].data()[i]];
        assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 2), "{found:?} {expected:?}");
    }
    // A grey video that is coded as one in colour has none.
    video(&path, 2, &["-c:v", "ffv1", "-pix_fmt", "yuv420p"]);
    assert!(colors(&path).is_none());
}

#[test]
fn a_video_that_was_held_upright_stands_upright() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("held.mp4");
    video(&path, 3, &["-c:v", "mpeg4", "-q:v", "2", "-pix_fmt", "yuv420p"]);
    let (_, lying, _) = frames(&path);
    let mut bytes = std::fs::read(&path).unwrap();
    // The matrix of a track's header, ISO/IEC 14496-12 §8.3.2; a quarter turn clockwise.
    let header = bytes.windows(4).position(|word| word == b"tkhd").expect("a track") + 44;
    let quarter = [0, 0x1_0000, 0, -0x1_0000, 0, 0, (HEIGHT as i32) << 16, 0, 0x4000_0000];
    let matrix: Vec<u8> = quarter.iter().flat_map(|number: &i32| number.to_be_bytes()).collect();
    bytes[header..header + matrix.len()].copy_from_slice(&matrix);
    std::fs::write(&path, bytes).unwrap();
    let (times, upright, warning) = frames(&path);
    assert_close(&times, &[0.0, 0.04, 0.08]);
    assert_eq!(warning, None);
    assert_eq!(info(&path, &[])["size"], serde_json::json!([64, 96]));
    let (lying, upright) = (&lying[1], &upright[1]);
    assert_eq!((upright.width(), upright.height()), (64, 96));
    let turned = |x: usize, y: usize| lying.data()[(63 - x) * 96 + y];
    let at = |x: usize, y: usize| upright.data()[y * 64 + x];
    let worst = (0..64 * 96).map(|i| at(i % 64, i / 64).abs_diff(turned(i % 64, i / 64))).max();
    assert!(worst <= Some(6), "{worst:?}");
}

#[test]
fn a_video_that_was_cut_off_or_damaged_gives_what_it_has_and_says_so() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("cut.avi");
    video(&path, 20, &["-c:v", "ffv1", "-pix_fmt", "gray", "-slicecrc", "1"]);
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 64].fill(0x55);
    std::fs::write(&path, &bytes).unwrap();
    let (times, _, warning) = frames(&path);
    assert!((10..=20).contains(&times.len()), "{times:?}");
    let warning = warning.expect("it is damaged");
    assert!(warning.contains("cut.avi: ") && warning.contains("damaged"), "{warning}");
    // An MP4 file's table is at its end: without it nothing can be read.
    let path = folder.path().join("cut.mp4");
    video(&path, 20, &["-c:v", "mpeg4", "-pix_fmt", "yuv420p"]);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert_refused(&["info", arg(&path)], &["cut.mp4", "without its index (moov)"]);
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

#[test]
fn without_ffmpeg_its_name_and_what_to_install_are_reported() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("walk.avi");
    video(&path, 3, &["-c:v", "mjpeg", "-pix_fmt", "yuvj420p"]);
    let run = |args: &[&str]| {
        let output = command().args(args).env("PATH", folder.path()).output().expect("the binary starts");
        assert!(!output.status.success());
        stderr(&output)
    };
    for printed in
        [run(&["info", arg(&path)]), run(&["convert", arg(&demo()), arg(&folder.path().join("b.avi"))])]
    {
        assert!(printed.contains("is not installed") && printed.contains("apt install ffmpeg"), "{printed}");
    }
    assert!(!folder.path().join("b.avi").exists());
}
