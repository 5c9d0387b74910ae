//! What the end-to-end tests share: the binary, and tiny recordings to give it.

// Each test file is a program of its own and uses its part.
#![allow(dead_code)]

use image::{GrayImage, ImageFormat, Luma};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

pub const WIDTH: u32 = 96;
pub const HEIGHT: u32 = 64;
pub const CAMERA: &str =
    "model: pinhole\nwidth: 96\nheight: 64\nfx: 80.0\nfy: 80.0\ncx: 47.5\ncy: 31.5\ndistortion: []\n";

/// The binary under test.
pub fn command() -> Command {
    Command::new(env!("CARGO_BIN_EXE_loopbox"))
}

/// Runs the binary.
pub fn loopbox(args: &[&str]) -> Output {
    command().args(args).output().expect("the binary starts")
}

/// Path as an argument.
pub fn arg(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// The recording that lies in the repository.
pub fn demo() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../demo/parking_a")
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A textured picture, another for each index.
pub fn picture(index: u32) -> GrayImage {
    GrayImage::from_fn(WIDTH, HEIGHT, |x, y| Luma([((x * 37 + y * 91 + index * 53) % 251) as u8]))
}

/// A picture as the bytes of a file.
pub fn encoded(index: u32, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Vec::new();
    picture(index).write_to(&mut Cursor::new(&mut bytes), format).expect("the picture encodes");
    bytes
}

/// Writes a file and the folders it needs.
pub fn write(path: PathBuf, content: impl AsRef<[u8]>) {
    std::fs::create_dir_all(path.parent().expect("not the root")).expect("the folder can be made");
    std::fs::write(path, content).expect("the file can be written");
}

/// `count` pictures in loopbox's own folder form, 10 a second.
pub fn timed_folder(folder: &Path, count: u32) {
    let mut times = String::from("# timestamp[s] image\n");
    for i in 0..count {
        write(folder.join(format!("images/{i:06}.png")), encoded(i, ImageFormat::Png));
        times += &format!("{:.1} images/{i:06}.png\n", i as f64 * 0.1);
    }
    write(folder.join("times.txt"), times);
    write(folder.join("camera.yaml"), CAMERA);
}

/// What `loopbox info --json` says of a recording.
pub fn info(path: &Path, more: &[&str]) -> serde_json::Value {
    let output = loopbox(&[&["info", arg(path), "--json"], more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("info prints JSON")
}

/// Runs over a recording whose pictures cannot be tracked; the numbers of the run.
///
/// Which frames were read is what is tested here, so that pictures may be tiny.
pub fn read_through(source: &Path, more: &[&str]) -> serde_json::Value {
    let out = tempfile::tempdir().expect("a folder for results");
    let output = loopbox(&[&["run", arg(source), "--out", arg(out.path()), "--quiet"], more].concat());
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("no frame could be tracked"), "{message}");
    numbers(out.path())
}

/// The `run.json` of a run.
pub fn numbers(out: &Path) -> serde_json::Value {
    let text = std::fs::read(out.join("run.json")).expect("there is a run.json");
    serde_json::from_slice(&text).expect("run.json is JSON")
}

/// The time stamps of the processed frames of a run.
pub fn processed_times(numbers: &serde_json::Value) -> Vec<f64> {
    let rows = numbers["rows"].as_array().expect("there are rows");
    rows.iter().map(|row| row["timestamp"].as_f64().expect("a time")).collect()
}

/// Asserts that the binary refuses, with status 1 and all of `words` in its message.
pub fn assert_refused(args: &[&str], words: &[&str]) {
    assert_ends(1, args, words);
}

/// Asserts that the binary calls it wrong usage, with status 2 and all of `words` in its message.
pub fn assert_misused(args: &[&str], words: &[&str]) {
    assert_ends(2, args, words);
}

fn assert_ends(status: i32, args: &[&str], words: &[&str]) {
    let output = loopbox(args);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(status), "{message}");
    for word in words {
        assert!(message.contains(word), "no '{word}' in: {message}");
    }
    assert!(!message.contains("panicked"), "{message}");
}

/// Writes a file of a ROS 2 bag in SQLite: topics as name and type, messages as topic's index, nanoseconds and CDR.
pub fn write_db3(path: &Path, topics: &[(&str, &str)], messages: &[(usize, i64, Vec<u8>)]) {
    let database = rusqlite::Connection::open(path).unwrap();
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                 serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
                 data BLOB NOT NULL);
             CREATE INDEX timestamp_idx ON messages (timestamp ASC); BEGIN;",
        )
        .unwrap();
    for (id, (name, kind)) in topics.iter().enumerate() {
        database
            .execute("INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '')", (id as i64, name, kind))
            .unwrap();
    }
    for (topic, time, data) in messages {
        let row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        database.execute(row, (*topic as i64, time, data)).unwrap();
    }
    database.execute_batch("COMMIT").unwrap();
}
