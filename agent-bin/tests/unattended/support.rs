//! What the tests of `loopbox agent` share: its file, its process, and what its heartbeat says.

use loopbox_tests::{Encoding, Recording, World, trajectory};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longer than anything here takes, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// 15 s of a camera that comes back to its first place every two seconds, and its calibration.
fn recording() -> &'static Path {
    static ROOM: OnceLock<TempDir> = OnceLock::new();
    let room = ROOM.get_or_init(|| {
        let path = trajectory::hand_held(60, 0.4);
        let period = Recording::render(&World::yard(1), Recording::SMALL_CAMERA, &path, 30.0);
        let mut shots: Vec<_> = period.shots.iter().cycle().take(450).cloned().collect();
        shots.iter_mut().enumerate().for_each(|(i, shot)| shot.timestamp = i as f64 / 30.0);
        let room = tempfile::tempdir().expect("a folder");
        let whole = Recording { camera: period.camera, shots };
        whole.write(&room.path().join("yard"), Encoding::Png).expect("there is room");
        let few = Recording { shots: whole.shots[..90].to_vec(), ..whole };
        few.write(&room.path().join("short"), Encoding::Png).expect("there is room");
        room
    });
    room.path()
}

/// A place for an agent.
pub struct Case {
    room: TempDir,
}

impl Case {
    /// An agent of this recording, `yard` by the clock or `short` as fast as it goes, with more in its file.
    pub fn new(recorded: &str, more: &str) -> Self {
        let path = recording().join(recorded);
        let realtime = recorded == "yard";
        Self::of(&format!("[recording]\npath = {path:?}\nrealtime = {realtime}\n{more}"))
    }

    /// An agent of this source and whatever else stands in its file.
    pub fn of(source: &str) -> Self {
        let room = tempfile::tempdir().expect("a folder");
        let case = Self { room };
        case.configure(source);
        case
    }

    /// Writes the agent's file anew.
    pub fn configure(&self, source: &str) {
        let text = format!("name = \"tester\"\nout = \"kept\"\nheartbeat = \"heartbeat.json\"\n{source}");
        fs::write(self.file(), text).expect("there is room");
    }

    /// The agent's file.
    pub fn file(&self) -> PathBuf {
        self.room.path().join("agent.toml")
    }

    /// A path in the case's folder.
    pub fn at(&self, name: &str) -> PathBuf {
        self.room.path().join(name)
    }

    /// A session's folder.
    pub fn session(&self, number: u32) -> PathBuf {
        self.at("kept").join(format!("{number:06}"))
    }

    /// `loopbox agent`, ready to start.
    pub fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        let log = fs::File::options().create(true).append(true).open(self.at("log")).expect("there is room");
        command.arg("agent").arg(self.file()).stdout(Stdio::null()).stderr(log);
        command
    }

    /// Starts it.
    pub fn start(&self) -> Agent<'_> {
        self.start_as(self.command())
    }

    /// Starts it by this command.
    pub fn start_as(&self, mut command: Command) -> Agent<'_> {
        // That of an earlier start says nothing of this one.
        let _ = fs::remove_file(self.at("heartbeat.json"));
        Agent { child: command.spawn().expect("it starts"), case: self }
    }

    /// What it told people, over all starts.
    pub fn log(&self) -> String {
        fs::read_to_string(self.at("log")).unwrap_or_default()
    }

    /// The heartbeat.
    pub fn beat(&self) -> Option<Value> {
        serde_json::from_slice(&fs::read(self.at("heartbeat.json")).ok()?).ok()
    }

    /// `loopbox status` with these arguments before the agent's file: its exit code and what it printed.
    pub fn status(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        let output = command.arg("status").args(arguments).arg(self.file()).output().expect("it starts");
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    }
}

/// An agent at work; it is killed with the test.
pub struct Agent<'a> {
    child: Child,
    case: &'a Case,
}

impl Agent<'_> {
    /// Its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits until its heartbeat is as wished.
    pub fn until(&mut self, what: &str, condition: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let beat = self.case.beat();
            if let Some(beat) = beat.as_ref().filter(|beat| condition(beat)) {
                return beat.clone();
            }
            let ended = self.child.try_wait().expect("it is ours");
            let log = || self.case.log();
            assert!(ended.is_none(), "it ended ({ended:?}) before {what}: {beat:#?}\n{}", log());
            assert!(began.elapsed() < PATIENCE, "not {what}: {beat:#?}\n{}", log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until it tracks, with so many keyframes that some have their depth.
    pub fn until_tracking(&mut self) -> Value {
        self.until("tracking", |beat| {
            beat["state"] == "tracking"
                && beat["tracked"].as_u64() > Some(90)
                && beat["keyframes"].as_u64() >= Some(4)
        })
    }

    /// As `kill -9`, and a power cut.
    pub fn kill(mut self) {
        self.child.kill().expect("it is ours");
        self.child.wait().expect("it is ours");
    }

    /// Asks it to end, and waits; how it did and how long that took.
    pub fn terminate(mut self) -> (ExitStatus, Duration) {
        let began = Instant::now();
        let sent = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status();
        assert!(sent.expect("kill can be run").success());
        (self.child.wait().expect("it is ours"), began.elapsed())
    }

    /// Waits for its own end.
    pub fn wait(mut self) -> ExitStatus {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("it is ours") {
                return status;
            }
            assert!(began.elapsed() < PATIENCE, "it does not end\n{}", self.case.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Agent<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The map in a folder, with the text of its agent's identity.
pub fn map_in(folder: &Path) -> (map::Map, String) {
    let map = map::load_map(folder.join("map.mcap")).expect("it loads").map;
    let identity = map.agents[&map::AgentId(0)].identity.expect("it has one").to_string();
    (map, identity)
}

/// Whether all keyframes of one map are in another, as they were seen.
pub fn holds(later: &map::Map, earlier: &map::Map) -> bool {
    earlier.keyframes.iter().all(|(id, keyframe)| {
        later
            .keyframes
            .get(id)
            .is_some_and(|found| Arc::ptr_eq(&found.image, &keyframe.image) || found.image == keyframe.image)
    })
}
