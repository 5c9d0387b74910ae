//! Minutes at the speed of a camera: a sequence played forwards and backwards again and again.

use super::program::{Pace, Task, percentile};
use crate::measure::{Run, Runner, make_empty};
use anyhow::{Context, Result, bail};
use eval::{Trajectory, read_trajectory};
use measuring::median;
use std::fmt::Write;
use std::path::Path;

/// The sequence that is played.
pub const SEQUENCE: &str = "tum_fr1_xyz";
/// Frames a second.
pub const RATE: f64 = 30.0;
/// True poses farther apart than this say nothing of the time between, seconds.
const MAX_GAP: f64 = 0.1;

/// What came of it.
pub struct Long {
    /// The run.
    pub run: Run,
    /// Frames from one end of the sequence to the other and back.
    pub period: usize,
    /// Minute by minute.
    pub minutes: Vec<Minute>,
}

/// A minute of the run; the last one may be shorter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Minute {
    /// Frames that came.
    pub frames: u64,
    /// Of them tracked by the agent or lost: not dropped.
    pub processed: u64,
    /// Keyframes made.
    pub keyframes: u64,
    /// Median of the latency, milliseconds.
    pub median_ms: Option<f64>,
    /// 99th percentile of it.
    pub p99_ms: Option<f64>,
}

/// Plays the sequence for so many minutes.
///
/// # Errors
/// When the recording cannot be made or the run fails.
pub fn measure(runner: &Runner, sequence: &Path, minutes: f64) -> Result<Long> {
    let frames = (minutes * 60.0 * RATE).round();
    if !(2.0..1e7).contains(&frames) {
        bail!("--minutes {minutes} is not a time to run\nhint: 5 is what the documents say");
    }
    let folder = runner.work.join("long");
    let (recording, out) = (folder.join("recording"), folder.join("out"));
    let period = make_recording(sequence, frames as usize, &recording)?;
    Task::new(&recording, &out, Pace::Camera).run(runner)?;
    let evaluation = runner.evaluate_if_possible(&recording, &out);
    let run = Run::read(&out, evaluation)?;
    let minutes = by_minute(&run, frames as u64);
    Ok(Long { run, period, minutes })
}

/// Makes a folder of `count` frames that go through the sequence to and fro; returns how many frames that takes once.
fn make_recording(sequence: &Path, count: usize, folder: &Path) -> Result<usize> {
    make_empty(folder)?;
    let frames = frames_of(&sequence.join("times.txt"))?;
    let truth = read_trajectory(&sequence.join("groundtruth.txt"))?;
    let (mut times, mut poses) = (String::new(), String::new());
    for k in 0..count {
        let (stamp, name) = &frames[to_and_fro(k, frames.len())];
        let time = k as f64 / RATE;
        let _ = writeln!(times, "{time:.6} {name}");
        if let Some(pose) = true_pose(&truth, *stamp) {
            let _ = writeln!(poses, "{time:.6} {pose}");
        }
    }
    let write = |name: &str, text: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))
    };
    write("times.txt", times.as_bytes())?;
    write("groundtruth.txt", poses.as_bytes())?;
    write("camera.yaml", &crate::measure::read(&sequence.join("camera.yaml"))?)?;
    let images = sequence.join("images").canonicalize().context("the sequence has no folder images")?;
    std::os::unix::fs::symlink(images, folder.join("images")).context("the images cannot be linked to")?;
    Ok(2 * (frames.len() - 1))
}

/// The time stamps and images of a recording, two at least.
fn frames_of(table: &Path) -> Result<Vec<(f64, String)>> {
    let text =
        std::fs::read_to_string(table).with_context(|| format!("{}: cannot be read", table.display()))?;
    let rows = text.lines().filter(|line| !line.starts_with('#')).map(|line| {
        let (time, name) = line.split_once(char::is_whitespace)?;
        Some((time.parse().ok()?, name.trim().to_owned()))
    });
    let frames: Option<Vec<_>> = rows.collect();
    frames
        .filter(|frames| frames.len() > 1)
        .with_context(|| format!("{}: not times and images", table.display()))
}

/// Which of `count` frames is the `k`th when they are played forwards and backwards; neither end comes twice.
fn to_and_fro(k: usize, count: usize) -> usize {
    let period = 2 * (count - 1);
    let at = k % period;
    at.min(period - at)
}

/// The true pose at a time as a trajectory file has it, the position between its neighbours.
fn true_pose(truth: &Trajectory, time: f64) -> Option<String> {
    let times = truth.timestamps.as_ref()?;
    let after = times.partition_point(|&t| t < time);
    let before = after.checked_sub(1)?;
    let gap = times.get(after)? - times[before];
    if gap > MAX_GAP {
        return None;
    }
    let (a, b) = (truth.world_from_camera[before].rigid(), truth.world_from_camera[after].rigid());
    let part = (time - times[before]) / gap;
    let position = a.translation.lerp(&b.translation, part);
    let q = a.rotation.slerp(&b.rotation, part);
    Some(format!("{} {} {} {} {} {} {}", position.x, position.y, position.z, q.i, q.j, q.k, q.w))
}

/// What happened in each minute of a run over `frames` frames.
fn by_minute(run: &Run, frames: u64) -> Vec<Minute> {
    let a_minute = (60.0 * RATE) as u64;
    let minute_of = |row: &serde_json::Value| row["index"].as_u64().map(|index| index / a_minute);
    let minute = |m: u64| {
        let rows: Vec<_> = run.rows().iter().filter(|row| minute_of(row) == Some(m)).collect();
        let latencies: Vec<f64> = rows.iter().filter_map(|row| row["latency_ms"].as_f64()).collect();
        Minute {
            frames: a_minute.min(frames - m * a_minute),
            processed: rows.len() as u64,
            keyframes: rows.iter().filter(|row| row["keyframe"].is_u64()).count() as u64,
            median_ms: median(latencies.clone()),
            p99_ms: percentile(latencies, 99),
        }
    };
    (0..frames.div_ceil(a_minute)).map(minute).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;
    use serde_json::json;

    #[test]
    fn a_recording_is_played_to_and_fro() {
        let played: Vec<usize> = (0..9).map(|k| to_and_fro(k, 4)).collect();
        assert_eq!(played, [0, 1, 2, 3, 2, 1, 0, 1, 2]);
    }

    #[test]
    fn the_recording_has_images_times_and_truth() {
        let folder = tempfile::tempdir().unwrap();
        let (sequence, long) = (folder.path().join("sequence"), folder.path().join("long"));
        std::fs::create_dir_all(sequence.join("images")).unwrap();
        let write = |name: &str, text: &str| std::fs::write(sequence.join(name), text).unwrap();
        write("times.txt", "# t image\n10.00 images/a.png\n10.05 images/b.png\n11.0 images/c.png\n");
        write("groundtruth.txt", "9.98 0 0 0 0 0 0 1\n10.06 8 0 0 0 0 0 1\n12 9 0 0 0 0 0 1\n");
        write("camera.yaml", "model: pinhole\n");
        write("images/b.png", "picture");
        assert_eq!(make_recording(&sequence, 6, &long).unwrap(), 4);
        let read = |name: &str| std::fs::read_to_string(long.join(name)).unwrap();
        let times = read("times.txt");
        let names: Vec<&str> = times.lines().map(|line| &line[line.len() - 5..]).collect();
        assert_eq!(names, ["a.png", "b.png", "c.png", "b.png", "a.png", "b.png"]);
        assert!(times.starts_with("0.000000 images/a.png\n0.033333 images/b.png\n"), "{times}");
        assert_eq!(read("images/b.png"), "picture");
        let truth = read_trajectory(&long.join("groundtruth.txt")).unwrap();
        // Nothing is known of the third frame, which lies in a gap.
        assert_eq!(truth.len(), 5);
        assert!((truth.world_from_camera[0].translation.x - 2.0).abs() < 1e-9);
    }

    #[test]
    fn minutes_count_what_came_and_what_was_processed() {
        let folder = tempfile::tempdir().unwrap();
        let row = |index: u64, keyframe: Value, ms: f64| json!({ "index": index, "keyframe": keyframe, "latency_ms": ms });
        let rows = [row(0, json!(0), 5.0), row(1799, json!(null), 7.0), row(1800, json!(1), 9.0)];
        std::fs::write(folder.path().join("run.json"), json!({ "rows": rows }).to_string()).unwrap();
        let run = Run::read(folder.path(), Value::Null).unwrap();
        let minutes = by_minute(&run, 2000);
        let counts: Vec<_> = minutes.iter().map(|m| (m.frames, m.processed, m.keyframes)).collect();
        assert_eq!(counts, [(1800, 2, 1), (200, 1, 1)]);
        assert_eq!((minutes[0].p99_ms, minutes[1].median_ms), (Some(7.0), Some(9.0)));
    }
}
