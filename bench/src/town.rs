//! A long drive: what frames, keyframes, memory and the end of a run cost when the map has grown.

use crate::measure::{Run, Runner, make_empty};
use anyhow::{Context, Result, bail};
use loopbox_tests::{Encoding, RING, Recording, World, trajectory};
use measuring::median;
use serde_json::Value;
use std::fmt::Write;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Metres between frames: 27 km/h.
const STEP: f64 = 0.25;
/// Frames a second.
const RATE: f64 = 30.0;
/// Frames rendered together.
const TOGETHER: usize = 256;
/// Keyframes over which costs are medians.
const SPAN: usize = 100;

/// What came of it.
pub struct Drive {
    run: Run,
    /// Frames of the recording.
    frames: usize,
    /// From the last frame to the end of the last optimisation.
    last_optimisation: Duration,
    /// From there to the end of the program.
    writing: Duration,
}

/// Drives through a rendered town for so many frames, and maps them all.
///
/// # Errors
/// When the recording cannot be made or the run fails.
pub fn measure(runner: &Runner, frames: usize) -> Result<Drive> {
    if !(600..10_000_000).contains(&frames) {
        bail!("--long {frames} is no drive\nhint: 600 frames and more make one");
    }
    let folder = runner.work.join("town");
    let (recording, out) = (folder.join("recording"), folder.join("out"));
    make_recording(frames, &recording)?;
    make_empty(&out)?;
    let mut command = Command::new(&runner.loopbox);
    command.arg("run").arg(&recording).arg("--out").arg(&out).args(["--log", "json"]);
    let mut program = command.stdout(Stdio::piped()).spawn().context("loopbox cannot be started")?;
    let mut stages: Vec<(String, Instant)> = Vec::new();
    if let Some(log) = program.stdout.take() {
        for line in BufReader::new(log).lines() {
            let event: Value = serde_json::from_str(&line?).context("the log is not JSON")?;
            if event["event"] == "stage" {
                stages.push((event["text"].as_str().unwrap_or_default().to_owned(), Instant::now()));
            }
        }
    }
    let status = program.wait()?;
    let ended = Instant::now();
    if !status.success() {
        bail!("{}: loopbox run failed: {status}", recording.display());
    }
    let evaluation = runner.evaluate_if_possible(&recording, &out);
    let at = |name: &str| stages.iter().find(|(text, _)| text == name).map_or(ended, |(_, at)| *at);
    let (optimising, writing) = (at("last optimisation"), at("writing the results"));
    Ok(Drive {
        run: Run::read(&out, evaluation)?,
        frames,
        last_optimisation: writing - optimising,
        writing: ended - writing,
    })
}

/// Renders the drive, some frames at a time, unless it is there.
fn make_recording(frames: usize, folder: &Path) -> Result<()> {
    let lines = |text: String| text.lines().filter(|line| !line.starts_with('#')).count();
    if std::fs::read_to_string(folder.join("times.txt")).is_ok_and(|text| lines(text) == frames) {
        return Ok(());
    }
    make_empty(folder)?;
    let rings = (frames as f64 * STEP / (3.0 * std::f64::consts::PI * RING)).ceil() as usize + 1;
    let (world, path) = (World::town(1, rings), trajectory::town(frames, STEP));
    let (mut times, mut truth) = (String::new(), String::new());
    let images = folder.join("images");
    std::fs::create_dir_all(&images).with_context(|| format!("{}: cannot be made", images.display()))?;
    for (part, poses) in path.chunks(TOGETHER).enumerate() {
        let rendered = Recording::render(&world, Recording::SMALL_CAMERA, poses, RATE);
        for (i, shot) in rendered.shots.iter().enumerate() {
            let index = part * TOGETHER + i;
            let (time, name) = (index as f64 / RATE, format!("images/{index:07}.jpg"));
            let write = || std::fs::write(folder.join(&name), Encoding::Jpeg.encode(&shot.image)?);
            write().with_context(|| format!("{}: cannot be written", folder.join(&name).display()))?;
            let _ = writeln!(times, "{time:.6} {name}");
            let pose = shot.world_from_camera.to_tum().map(|number| format!("{number:.9}"));
            let _ = writeln!(truth, "{time:.6} {}", pose.join(" "));
        }
    }
    let camera = Recording { camera: Recording::SMALL_CAMERA, shots: Vec::new() }.camera_yaml();
    for (name, text) in [("camera.yaml", camera), ("groundtruth.txt", truth), ("times.txt", times)] {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(())
}

/// Times around a number of keyframes, medians but for the last, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Costs {
    keyframes: usize,
    /// Of a frame that is no keyframe.
    frame: f64,
    /// Of a keyframe.
    keyframe: f64,
    /// Of the one that took longest.
    longest: f64,
}

/// The costs of the last [`SPAN`] keyframes when there are `keyframes`.
fn costs(rows: &[Value], keyframes: usize) -> Option<Costs> {
    let mut made = 0;
    let (mut frames, mut keys) = (Vec::new(), Vec::new());
    for row in rows {
        let is_keyframe = row["keyframe"].is_u64();
        made += usize::from(is_keyframe);
        if (keyframes.saturating_sub(SPAN)..keyframes).contains(&made) && row["state"] == "tracking" {
            if is_keyframe { &mut keys } else { &mut frames }.push(row["ms"].as_f64()?);
        }
    }
    (made >= keyframes).then_some(())?;
    let longest = keys.iter().copied().fold(0.0, f64::max);
    Some(Costs { keyframes, frame: median(frames)?, keyframe: median(keys)?, longest })
}

/// The section of the document.
pub fn section(drive: &Drive) -> String {
    let rows = drive.run.rows();
    let count = rows.iter().filter(|row| row["keyframe"].is_u64()).count();
    let number = |pointer: &str, digits: usize| {
        drive.run.record(pointer).map_or("unknown".into(), |value| format!("{value:.digits$}"))
    };
    let memory =
        drive.run.record("/cost/peak_memory_bytes").map_or("unknown".into(), |b| format!("{:.0}", b / 1e6));
    let error = drive.run.evaluation("/ate/rmse").map_or("unknown".into(), |rmse| format!("{rmse:.2}"));
    let mut text = format!(
        "{} frames of 320 × 240 pixels through {:.0} m of a rendered town, {count} keyframes, {} of the frames with a pose; \
         {} loops closed, {error} m root mean square from the truth.\n\n",
        drive.frames,
        drive.frames as f64 * STEP,
        number("/frames/tracked", 0),
        number("/map/loops", 0),
    );
    text += "| keyframes in the map | ms a frame, median | ms a keyframe, median | longest |\n|---|---|---|---|\n";
    let decade = |power: u32| [2, 5, 10].map(|digit| digit * 10usize.pow(power));
    let marks = (2..).flat_map(decade).take_while(|&mark| mark < count).chain([count]);
    for Costs { keyframes, frame, keyframe, longest } in marks.filter_map(|mark| costs(rows, mark)) {
        let _ = writeln!(text, "| {keyframes} | {frame:.1} | {keyframe:.1} | {longest:.0} |");
    }
    let _ = write!(
        text,
        "\nPeak memory {memory} MB. The last optimisation took {:.1} s, writing the results {:.1} s.",
        drive.last_optimisation.as_secs_f64(),
        drive.writing.as_secs_f64()
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn costs_are_those_of_the_keyframes_before() {
        let row = |i: usize| {
            let keyframe = i.is_multiple_of(2);
            json!({ "state": "tracking", "ms": if keyframe { i as f64 } else { 5.0 }, "keyframe": keyframe.then_some(i) })
        };
        let rows: Vec<Value> = (0..1000).map(row).collect();
        let Costs { frame, keyframe, longest, .. } = costs(&rows, 300).expect("there are so many");
        assert_eq!((frame, longest), (5.0, 596.0));
        assert!((400.0..600.0).contains(&keyframe), "{keyframe}");
        assert_eq!(costs(&rows, 501), None);
    }
}
