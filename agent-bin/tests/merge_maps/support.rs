//! What the tests share: the maps of three recordings, made once, and a way to run `loopbox`.

use geometry::Se3;
use loopbox_tests::{Encoding, Recording, World, trajectory};
use map::Map;
use nalgebra::Vector3;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use tempfile::TempDir;

/// Frames a second of the recordings.
const RATE: f64 = 30.0;

/// The runs on three recordings: `left` and `right` are drives past the same boxes that share their middle, not on
/// one line, and `right` drives back; `elsewhere` is in another yard.
pub struct Runs {
    folder: TempDir,
}

impl Runs {
    /// The runs, made when first asked for.
    pub fn get() -> &'static Self {
        static RUNS: OnceLock<Runs> = OnceLock::new();
        RUNS.get_or_init(Self::make)
    }

    /// The folder of a run.
    pub fn run(&self, name: &str) -> PathBuf {
        self.folder.path().join("runs").join(name)
    }

    /// The map of a run.
    pub fn map(&self, name: &str) -> Map {
        map::load_map(self.run(name).join("map.mcap")).expect("the map of the run loads").map
    }

    /// The true trajectory of a recording.
    pub fn truth(&self, name: &str) -> PathBuf {
        self.recording(name).join("groundtruth.txt")
    }

    fn recording(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn make() -> Self {
        let runs = Self { folder: tempfile::tempdir().expect("a temporary folder can be made") };
        let path = trajectory::sideways(180, 8.1);
        let aside = Vector3::new(0.0, -0.12, -0.3);
        let back: Vec<Se3> =
            path[75..].iter().rev().map(|pose| Se3::new(pose.rotation, pose.translation + aside)).collect();
        let yard = World::yard(1);
        runs.make_run("left", &yard, &path[..105]);
        runs.make_run("right", &yard, &back);
        runs.make_run("elsewhere", &World::yard(2), &path[50..110]);
        runs
    }

    fn make_run(&self, name: &str, world: &World, path: &[Se3]) {
        let recording = Recording::render(world, Recording::SMALL_CAMERA, path, RATE);
        recording.write(&self.recording(name), Encoding::Png).expect("the temporary folder takes it");
        let outcome = loopbox(&["run", arg(&self.recording(name)), "--out", arg(&self.run(name)), "--quiet"]);
        outcome.assert_success();
    }
}

/// A map file in a folder of its own, and room for results.
pub struct Case {
    folder: TempDir,
}

impl Case {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder can be made") }
    }

    /// Where a file of the case is.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The folder of results, which is not made.
    pub fn out(&self) -> PathBuf {
        self.path("out")
    }

    /// Saves a map.
    pub fn map(&self, name: &str, map: &Map) -> PathBuf {
        let path = self.path(name);
        map::save_map(&path, map).expect("the temporary folder takes a map");
        path
    }

    /// Writes a file.
    pub fn file(&self, name: &str, content: &[u8]) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, content).expect("the temporary folder takes a file");
        path
    }

    /// `loopbox merge` of maps.
    pub fn merge(&self, maps: &[&Path]) -> Outcome {
        let mut args = vec!["merge"];
        args.extend(maps.iter().map(|map| arg(map)));
        let out = self.out();
        args.extend(["--out", arg(&out)]);
        loopbox(&args)
    }

    /// The names of what is in the folder of results.
    pub fn results(&self) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(self.out())
            .map(|entries| {
                entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
            })
            .unwrap_or_default();
        names.sort();
        names
    }
}

/// A path as an argument.
pub fn arg(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// What a finished program said.
#[derive(Debug)]
pub struct Outcome {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// Runs `loopbox` to its end.
pub fn loopbox(args: &[&str]) -> Outcome {
    let output = Command::new(env!("CARGO_BIN_EXE_loopbox")).args(args).output().expect("loopbox starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Outcome { code: output.status.code(), stdout: text(&output.stdout), stderr: text(&output.stderr) }
}

impl Outcome {
    /// Fails unless it exited with 0.
    pub fn assert_success(&self) {
        assert_eq!(self.code, Some(0), "{self:#?}");
    }

    /// Fails unless it refused: a non-zero exit code, no panic, and each of `words` on standard error.
    pub fn assert_refused(&self, words: &[&str]) {
        self.assert_ended(1, words);
    }

    /// The same with another exit code.
    pub fn assert_ended(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "{self:#?}");
        assert!(self.stderr.contains("error: ") && !self.stderr.contains("panicked"), "{self:#?}");
        for word in words {
            assert!(self.stderr.contains(word), "nothing is said of \"{word}\"\n{self:#?}");
        }
    }
}
