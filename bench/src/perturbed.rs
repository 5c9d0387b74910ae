//! How much a result owes to luck: every sequence run from other first frames, and with noise added to its images.

use crate::measure::{Runner, finish, make_empty, output};
use crate::name;
use crate::report::{MISSING, length, number};
use crate::side_by_side::side_by_side;
use anyhow::{Context, Result};
use geometry::Random;
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Frames between one first frame and the next: no divisor of the spacing of keyframes, and over 16 starts two to eight
/// seconds of the recordings.
const START_STEP: usize = 5;

/// Largest change of a pixel by noise, grey levels; all changes up to it are equally likely.
const NOISE: i16 = 2;

/// What is measured.
pub struct Plan<'a> {
    /// Runs the program.
    pub runner: &'a Runner,
    /// The sequences.
    pub sequences: &'a [PathBuf],
    /// From how many first frames each is run.
    pub starts: usize,
    /// With how many draws of noise each is run.
    pub seeds: usize,
}

/// The runs over one sequence with one kind of change.
pub struct Perturbed {
    /// Name of the sequence.
    pub name: String,
    /// What was changed, with the number of the change.
    pub changes: Vec<(Change, Outcome)>,
}

/// What is other than in the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The first frames are left out.
    FirstFrame(usize),
    /// Noise of this seed lies on every image.
    Noise(u64),
}

/// What came of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Frames given to the program.
    pub frames: usize,
    /// Frames with a pose in trajectory.txt.
    pub tracked: usize,
    /// Root mean square error of the positions, metres; none where nothing could be compared.
    pub ate: Option<f64>,
}

impl Outcome {
    /// Share of the frames that have a pose, 0–1.
    pub fn share(&self) -> f64 {
        self.tracked as f64 / self.frames.max(1) as f64
    }
}

/// Runs everything, as many runs side by side as there are cores.
///
/// # Errors
/// When a sequence cannot be read or the program cannot be started; a run that fails has tracked nothing.
pub fn measure(plan: &Plan) -> Result<Vec<Perturbed>> {
    let starts = (0..plan.starts).map(|i| Change::FirstFrame(i * START_STEP));
    let changes: Vec<Change> = starts.chain((0..plan.seeds).map(|i| Change::Noise(i as u64))).collect();
    let jobs: Vec<(&PathBuf, Change)> =
        plan.sequences.iter().flat_map(|s| changes.iter().map(move |c| (s, *c))).collect();
    let outcomes = side_by_side(&jobs, |(sequence, change)| {
        let outcome = measure_one(plan.runner, sequence, *change)
            .with_context(|| format!("{}: {change:?}", sequence.display()))?;
        let ate = outcome.ate.map_or(MISSING.to_owned(), length);
        eprintln!("{} {change:?}: {ate}, {} of {}", name(sequence), outcome.tracked, outcome.frames);
        Ok(outcome)
    })?;
    let mut outcomes = outcomes.into_iter();
    let of = |sequence: &PathBuf| Perturbed {
        name: name(sequence),
        changes: changes.iter().copied().zip(&mut outcomes).collect(),
    };
    Ok(plan.sequences.iter().map(of).collect())
}

/// Runs one sequence with one change.
fn measure_one(runner: &Runner, sequence: &Path, change: Change) -> Result<Outcome> {
    let label = match change {
        Change::FirstFrame(first) => format!("from-{first}"),
        Change::Noise(seed) => format!("noise-{seed}"),
    };
    let folder = runner.work.join("perturbed").join(name(sequence)).join(label);
    make_empty(&folder)?;
    let (recording, out) = (folder.join("recording"), folder.join("out"));
    let frames = write_changed(sequence, &recording, change)?;
    let mut run = Command::new(&runner.loopbox);
    run.arg("run").arg(&recording).arg("--calib").arg(sequence.join("camera.yaml"));
    let ended = output(run.arg("--out").arg(&out).args(["--quiet", "--threads", "1"]))?;
    let outcome = Outcome { frames, ..Outcome::default() };
    let outcome = match ended.status.success() && out.join("trajectory.txt").is_file() {
        true => evaluate(runner, sequence, &recording, &out, outcome)?,
        false => outcome,
    };
    // Noisy images of all runs would fill the disk.
    fs::remove_dir_all(&recording).with_context(|| format!("{}", recording.display()))?;
    Ok(outcome)
}

/// The errors of a run's trajectory.
fn evaluate(
    runner: &Runner,
    sequence: &Path,
    recording: &Path,
    out: &Path,
    outcome: Outcome,
) -> Result<Outcome> {
    let mut eval = Command::new(&runner.loopbox);
    eval.arg("eval").arg(out.join("trajectory.txt")).arg("--json");
    eval.arg("--gt").arg(runner.truth(sequence)?).arg("--frames").arg(recording.join("times.txt"));
    let found: Value = serde_json::from_slice(&finish(&mut eval)?).context("`loopbox eval --json`")?;
    let tracked = found.pointer("/coverage/covered").and_then(Value::as_u64).unwrap_or(0) as usize;
    Ok(Outcome { tracked, ate: found.pointer("/ate/rmse").and_then(Value::as_f64), ..outcome })
}

/// Writes a sequence with a change as a recording of its own; how many frames it has.
fn write_changed(sequence: &Path, to: &Path, change: Change) -> Result<usize> {
    let times = sequence.join("times.txt");
    let text = fs::read_to_string(&times).with_context(|| format!("{}", times.display()))?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with('#')).collect();
    let first = match change {
        Change::FirstFrame(first) => first.min(lines.len()),
        Change::Noise(_) => 0,
    };
    fs::create_dir_all(to).with_context(|| format!("{}", to.display()))?;
    match change {
        Change::FirstFrame(_) => {
            let (images, link) = (sequence.join("images").canonicalize()?, to.join("images"));
            std::os::unix::fs::symlink(images, &link).with_context(|| format!("{}", link.display()))?;
        }
        Change::Noise(seed) => {
            fs::create_dir_all(to.join("images"))?;
            for (i, line) in lines.iter().enumerate() {
                let image = line.split_whitespace().nth(1).context("times.txt names no image")?;
                let seed = (seed << 32) + i as u64;
                add_noise(&sequence.join(image), &to.join(image).with_extension("png"), seed)?;
            }
        }
    }
    let renamed = |line: &str| match change {
        Change::FirstFrame(_) => line.to_owned(),
        Change::Noise(_) => Path::new(line).with_extension("png").display().to_string(),
    };
    let kept: Vec<String> = lines[first..].iter().map(|line| renamed(line)).collect();
    fs::write(to.join("times.txt"), kept.join("\n") + "\n")?;
    Ok(kept.len())
}

/// Writes an image with noise on every pixel, without further loss.
fn add_noise(from: &Path, to: &Path, seed: u64) -> Result<()> {
    let mut image = image::open(from).with_context(|| format!("{}", from.display()))?.into_luma8();
    let mut random = Random::new(seed);
    for pixel in image.iter_mut() {
        let change = random.index((2 * NOISE + 1) as usize) as i16 - NOISE;
        *pixel = (i16::from(*pixel) + change).clamp(0, 255) as u8;
    }
    image.save(to).with_context(|| format!("{}", to.display()))
}

/// The table of the results page.
pub fn section(all: &[Perturbed]) -> String {
    let mut out = format!(
        "ATE after one Sim(3) alignment over the frames with a pose, and the share of the frames that have one in \
         `trajectory.txt`. First frames: 0, {START_STEP}, {} … Noise: up to {NOISE} grey levels on every pixel.\n\n\
         | sequence | change | runs | ATE, median | worst | frames tracked, median | worst | runs with ≥ 98 % |\n\
         |---|---|---|---|---|---|---|---|\n",
        2 * START_STEP
    );
    for sequence in all {
        let is_start = |change: &Change| matches!(change, Change::FirstFrame(_));
        for (label, starts) in [("first frame", true), ("noise", false)] {
            let outcomes: Vec<Outcome> =
                sequence.changes.iter().filter(|c| is_start(&c.0) == starts).map(|c| c.1).collect();
            if !outcomes.is_empty() {
                let _ = writeln!(out, "| `{}` | {label} | {} |", sequence.name, row(&outcomes));
            }
        }
    }
    out
}

fn row(outcomes: &[Outcome]) -> String {
    let ates: Vec<f64> = outcomes.iter().filter_map(|o| o.ate).collect();
    let shares: Vec<f64> = outcomes.iter().map(Outcome::share).collect();
    let worst_ate = (ates.len() == outcomes.len()).then(|| ates.iter().copied().fold(0.0, f64::max));
    let percent = |share: Option<f64>| number(share.map(|share| 100.0 * share), 1, " %");
    let whole = shares.iter().filter(|share| **share >= 0.98).count();
    [
        outcomes.len().to_string(),
        measuring::median(ates).map_or(MISSING.to_owned(), length),
        worst_ate.map_or(MISSING.to_owned(), length),
        percent(measuring::median(shares.clone())),
        percent(shares.into_iter().reduce(f64::min)),
        whole.to_string(),
    ]
    .join(" | ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequence(folder: &Path) -> PathBuf {
        let sequence = folder.join("a");
        fs::create_dir_all(sequence.join("images")).unwrap();
        for i in 0..4 {
            image::GrayImage::from_pixel(8, 6, image::Luma([if i == 0 { 255 } else { 100 }]))
                .save(sequence.join(format!("images/{i}.png")))
                .unwrap();
        }
        let times = "# time image\n0.0 images/0.png\n0.1 images/1.png\n0.2 images/2.png\n0.3 images/3.png\n";
        fs::write(sequence.join("times.txt"), times).unwrap();
        sequence
    }

    #[test]
    fn a_recording_begins_at_another_frame() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (sequence(folder.path()), folder.path().join("b"));
        assert_eq!(write_changed(&from, &to, Change::FirstFrame(3)).unwrap(), 1);
        assert_eq!(fs::read_to_string(to.join("times.txt")).unwrap(), "0.3 images/3.png\n");
        assert!(to.join("images/3.png").is_file());
    }

    #[test]
    fn noise_is_small_differs_by_seed_and_repeats() {
        let folder = tempfile::tempdir().unwrap();
        let from = sequence(folder.path());
        let pixels = |seed, to: &str, image: &str| {
            let to = folder.path().join(to);
            write_changed(&from, &to, Change::Noise(seed)).unwrap();
            image::open(to.join(image)).unwrap().into_luma8().into_raw()
        };
        let one = pixels(1, "b", "images/1.png");
        assert!(one.iter().all(|p| (98..=102).contains(p)) && one.iter().any(|p| *p != 100), "{one:?}");
        assert_eq!(one, pixels(1, "c", "images/1.png"));
        assert_ne!(one, pixels(2, "d", "images/1.png"));
        assert_ne!(one, pixels(1, "b", "images/2.png"), "every image has its own");
        assert!(pixels(1, "b", "images/0.png").iter().all(|p| *p >= 253), "white stays within its range");
    }

    #[test]
    fn the_worst_run_is_listed_and_a_failed_one_is_not_left_out() {
        let run = |tracked, ate| Outcome { frames: 100, tracked, ate };
        let start = |i, outcome| (Change::FirstFrame(i), outcome);
        let whole = vec![
            start(0, run(100, Some(0.01))),
            start(5, run(99, Some(0.03))),
            start(10, run(100, Some(0.02))),
        ];
        let text = section(&[Perturbed { name: "a".into(), changes: whole.clone() }]);
        assert!(
            text.contains("| `a` | first frame | 3 | 2.00 cm | 3.00 cm | 100.0 % | 99.0 % | 3 |"),
            "{text}"
        );
        let failed = [whole, vec![start(15, run(0, None))]].concat();
        let text = section(&[Perturbed { name: "a".into(), changes: failed }]);
        assert!(text.contains("| 4 | 2.00 cm | – | 100.0 % | 0.0 % | 3 |"), "{text}");
    }
}
