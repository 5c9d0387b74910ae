//! What the tests share: recordings, a way to run `loopbox`, and measures of its results.

use eval::{AlignMode, Associated, DEFAULT_MAX_DIFF, Pose, align, associate, ate, read_trajectory};
use geometry::GrayImage;
use loopbox_tests::{Encoding, Recording, World, trajectory};
use map::Map;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, OnceLock};
use tempfile::TempDir;

/// Frames a second of every rendered recording.
pub const RATE: f64 = 30.0;

/// RMSE a trajectory may have, as a share of the true path. Undisturbed runs reach 0.0003 and less.
pub const ERROR_SHARE: f64 = 0.002;

/// The world of all recordings.
pub fn world() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| World::yard(1))
}

/// A drive of 4.5 m along a row of boxes, 90 frames.
pub fn drive() -> Recording {
    static DRIVE: OnceLock<Recording> = OnceLock::new();
    let render = || Recording::render(world(), Recording::SMALL_CAMERA, &trajectory::sideways(90, 4.5), RATE);
    DRIVE.get_or_init(render).clone()
}

/// `count` frames of a hand-held camera that comes back to its first place every 60 frames.
pub fn hand_held(count: usize) -> Recording {
    static PERIOD: OnceLock<Recording> = OnceLock::new();
    let render =
        || Recording::render(world(), Recording::SMALL_CAMERA, &trajectory::hand_held(60, 0.4), RATE);
    let period = PERIOD.get_or_init(render);
    let shots = period.shots.iter().cycle().take(count).cloned().collect();
    restamped(Recording { camera: period.camera, shots })
}

/// The recording with the time stamps of an undisturbed one.
pub fn restamped(mut recording: Recording) -> Recording {
    for (i, shot) in recording.shots.iter_mut().enumerate() {
        shot.timestamp = i as f64 / RATE;
    }
    recording
}

/// Changes the image of the frames in `range`.
pub fn repaint(
    recording: &mut Recording,
    range: std::ops::Range<usize>,
    paint: impl Fn(usize, &GrayImage) -> GrayImage,
) {
    for i in range {
        let shot = &mut recording.shots[i];
        shot.image = Arc::new(paint(i, &shot.image));
    }
}

/// A recording on disk in a folder of its own, and room for what `loopbox` makes of it. The folder goes when
/// the test ends, unless `LOOPBOX_KEEP` is set.
pub struct Case {
    folder: TempDir,
}

impl Case {
    /// Writes `recording` without loss.
    pub fn new(recording: &Recording) -> Self {
        Self::with_encoding(recording, Encoding::Png)
    }

    /// Writes `recording` with its images encoded so.
    pub fn with_encoding(recording: &Recording, encoding: Encoding) -> Self {
        let case = Self::empty();
        recording.write(&case.source(), encoding).expect("the temporary folder takes the recording");
        case
    }

    /// Room without a recording; the source folder exists and is empty.
    pub fn empty() -> Self {
        let mut folder = tempfile::tempdir().expect("a temporary folder can be made");
        if std::env::var_os("LOOPBOX_KEEP").is_some() {
            folder.disable_cleanup(true);
            let thread = std::thread::current();
            eprintln!("{}: kept in {}", thread.name().unwrap_or("a test"), folder.path().display());
        }
        let case = Self { folder };
        fs::create_dir(case.source()).expect("the temporary folder takes a folder");
        case
    }

    /// The folder of the recording.
    pub fn source(&self) -> PathBuf {
        self.folder.path().join("recording")
    }

    /// The folder of results.
    pub fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    /// `loopbox run` on the recording, ready to start.
    pub fn command(&self, arguments: &[&str]) -> Command {
        self.command_on(&self.source(), arguments)
    }

    /// `loopbox run` on another source, ready to start.
    pub fn command_on(&self, source: &Path, arguments: &[&str]) -> Command {
        let mut command = loopbox();
        command.arg("run").arg(source).arg("--out").arg(self.out()).args(arguments);
        command
    }

    /// Runs `loopbox run` on the recording to its end.
    pub fn run(&self, arguments: &[&str]) -> Outcome {
        Outcome::of(self.command(arguments))
    }

    /// Fails unless a run kept all but `may_miss` frames of the recording in one map, within [`ERROR_SHARE`] of
    /// its path.
    pub fn assert_mapped(&self, outcome: &Outcome, may_miss: usize) {
        let wanted = read_trajectory(&self.source().join("groundtruth.txt")).expect("we wrote it").len();
        let tracked = self.assert_accurate(outcome);
        assert!(tracked + may_miss >= wanted, "{tracked} of {wanted} frames tracked\n{outcome}");
    }

    /// Fails unless the run succeeded and its trajectory, aligned by a similarity, has an RMSE below
    /// [`ERROR_SHARE`] of the true path; gives the number of frames in it.
    pub fn assert_accurate(&self, outcome: &Outcome) -> usize {
        outcome.assert_success();
        let measured = Accuracy::of(&self.out(), &self.source().join("groundtruth.txt"));
        assert!(
            measured.rmse <= ERROR_SHARE * measured.path,
            "RMSE {:.4} m on a path of {:.2} m, {} frames\n{outcome}",
            measured.rmse,
            measured.path,
            measured.frames
        );
        measured.frames
    }

    /// The saved map.
    pub fn map(&self) -> Map {
        map::load_map(self.out().join("map.mcap")).expect("the saved map loads").map
    }
}

/// `loopbox`, without arguments.
pub fn loopbox() -> Command {
    Command::new(env!("CARGO_BIN_EXE_loopbox"))
}

/// The folder of a sequence with ground truth; without it the test counts as skipped.
pub fn sequence(name: &str) -> Option<PathBuf> {
    let shared = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let folder = std::env::var_os("LOOPBOX_DATA").map_or_else(shared, PathBuf::from).join(name);
    let found = std::fs::canonicalize(&folder).ok();
    if found.is_none() {
        eprintln!(
            "SKIPPED: {} is not here; set LOOPBOX_DATA to the folder of the sequences",
            folder.display()
        );
    }
    found
}

/// How well a saved trajectory fits the truth.
pub struct Accuracy {
    /// Frames in the trajectory.
    pub frames: usize,
    /// Root mean square distance of camera positions after Sim(3) alignment, metres.
    pub rmse: f64,
    /// Length of the true path, metres.
    pub path: f64,
}

impl Accuracy {
    /// Compares `trajectory.txt` in `out` with a ground truth.
    pub fn of(out: &Path, truth: &Path) -> Self {
        Self::together(&[(out.join("trajectory.txt"), truth.to_owned())])
    }

    /// Compares trajectories that are in one frame, each with its ground truth.
    pub fn together(trajectories: &[(PathBuf, PathBuf)]) -> Self {
        let mut all = Associated { timestamps: None, estimate: Vec::new(), truth: Vec::new() };
        let (mut frames, mut path) = (0, 0.0);
        for (estimate, truth) in trajectories {
            let estimate = read_trajectory(estimate).expect("the program wrote a trajectory");
            let truth = read_trajectory(truth).expect("the truth can be read");
            let step = |pair: &[Pose]| (pair[1].translation - pair[0].translation).norm();
            frames += estimate.len();
            path += truth.world_from_camera.windows(2).map(step).sum::<f64>();
            let pairs = associate(&estimate, &truth, DEFAULT_MAX_DIFF).expect("times overlap");
            assert_eq!(pairs.len(), estimate.len(), "every pose is that of a frame");
            all.estimate.extend(pairs.estimate);
            all.truth.extend(pairs.truth);
        }
        let (_, aligned) = align(&all, AlignMode::Sim3).expect("a trajectory of some extent");
        let rmse = ate(&aligned).expect("there are pairs").rmse;
        Self { frames, rmse, path }
    }
}

/// What a finished program said.
pub struct Outcome {
    /// The exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// Everything it printed, standard output first.
    pub text: String,
}

impl Outcome {
    /// Runs a command to its end.
    pub fn of(mut command: Command) -> Self {
        Self::from(command.output().expect("loopbox can be started"))
    }

    /// Fails unless it exited with 0.
    pub fn assert_success(&self) {
        assert_eq!(self.code, Some(0), "{self}");
    }

    /// Fails unless it refused: a non-zero exit code, no panic, and a message with each of `words`.
    pub fn assert_refused(&self, words: &[&str]) {
        assert!(self.code.is_some_and(|code| code != 0), "{self}");
        self.assert_says(words);
    }

    /// Fails unless its messages have each of `words`, whatever their case.
    pub fn assert_says(&self, words: &[&str]) {
        let text = self.text.to_lowercase();
        assert!(!text.contains("panicked"), "{self}");
        for word in words {
            assert!(text.contains(&word.to_lowercase()), "nothing is said of \"{word}\"\n{self}");
        }
    }
}

impl From<Output> for Outcome {
    fn from(output: Output) -> Self {
        let text = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned()).concat();
        Self { code: output.status.code(), text }
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "loopbox ended with {:?} and said:\n{}", self.code, self.text)
    }
}
