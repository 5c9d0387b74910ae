//! Recording, replay and conversion, through the binary.

mod common;

use common::*;
use sources::pictures::Picture;
use sources::{SourceFrame, SourceOptions};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;
use tempfile::tempdir;

/// Runs the binary, which must succeed.
fn run(args: &[&str]) -> String {
    let output = loopbox(args);
    assert!(output.status.success(), "{args:?}: {}", stderr(&output));
    stdout(&output)
}

fn trajectory(out: &Path) -> String {
    std::fs::read_to_string(out.join("trajectory.txt")).expect("there is a trajectory")
}

/// Index, bits of the time stamp, and bytes of the picture.
type Recorded = (u64, u64, Vec<u8>);

/// All frames of a recording, and the source's warning.
fn frames(path: &Path, all_frames: bool) -> (Vec<Recorded>, Option<String>) {
    let options = SourceOptions { all_frames, ..SourceOptions::default() };
    let mut source = sources::open(path, &options).expect("it is a recording");
    let frames = std::iter::from_fn(|| source.next_frame()).map(|frame| {
        let SourceFrame { index, timestamp, picture, .. } = frame;
        let bytes = match picture {
            Picture::Encoded(bytes) => bytes,
            Picture::File(path) => std::fs::read(path).expect("it is there"),
            other => panic!("{other:?}"),
        };
        (index, timestamp.to_bits(), bytes)
    });
    (frames.collect(), source.warning())
}

/// The frames of a recording whose pictures only matter as grey levels.
fn grey(path: &Path) -> Vec<Vec<u8>> {
    let mut source = sources::open(path, &SourceOptions::default()).expect("it is a recording");
    std::iter::from_fn(|| source.next_frame())
        .map(|frame| frame.picture.into_grey().expect("it decodes").data().to_vec())
        .collect()
}

/// The first `count` frames of the recording in the repository.
fn part_of_demo(folder: &Path, count: usize) {
    let times = std::fs::read_to_string(demo().join("times.txt")).expect("the demo is there");
    let rows: Vec<&str> = times.lines().filter(|line| !line.starts_with('#')).take(count).collect();
    for row in &rows {
        let name = row.split_whitespace().nth(1).expect("an image");
        write(folder.join(name), std::fs::read(demo().join(name)).expect("it is there"));
    }
    write(folder.join("times.txt"), rows.join("\n"));
    write(folder.join("camera.yaml"), std::fs::read(demo().join("camera.yaml")).expect("it is there"));
}

#[test]
fn a_replay_gives_the_trajectory_of_a_run_that_dropped_frames() {
    let folder = tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    part_of_demo(&at("walk"), 60);
    let (recording, live, replay) = (at("r.mcap"), at("live"), at("replay"));
    // Fast enough that frames are dropped on any machine.
    let realtime = ["--realtime", "--speed", "4", "--start", "0.2"];
    let args = ["run", arg(&at("walk")), "--out", arg(&live), "--quiet", "--record", arg(&recording)]
        .map(str::to_owned);
    let args: Vec<&str> = args.iter().map(String::as_str).chain(realtime).collect();
    let output = loopbox(&args);
    let counts = numbers(&live)["frames"].clone();
    let (all, _) = frames(&recording, true);
    assert_eq!(all.len() as u64, counts["offered"].as_u64().unwrap(), "every captured frame is recorded");
    let (kept, warning) = frames(&recording, false);
    assert_eq!((kept.len() as u64, warning), (counts["processed"].as_u64().unwrap(), None));
    if !output.status.success() {
        // So many frames were dropped that nothing was tracked: the same must come of the replay.
        assert_refused(&["run", arg(&recording), "--out", arg(&replay)], &["no frame could be tracked"]);
        return;
    }
    assert!(counts["dropped_late"].as_u64().unwrap() > 0, "{counts}");
    assert!(run(&["info", arg(&recording)]).contains("left out of a replay"));
    run(&["run", arg(&recording), "--out", arg(&replay), "--quiet"]);
    assert_eq!(trajectory(&live), trajectory(&replay));
    assert_refused(&args, &["there is a file already", "hint"]);
}

#[cfg(unix)]
#[test]
fn a_replay_ends_where_the_run_was_stopped() {
    let folder = tempdir().unwrap();
    let (recording, live, replay) =
        (folder.path().join("r.mcap"), folder.path().join("live"), folder.path().join("replay"));
    let mut child = command()
        .args(["run", arg(&demo()), "--out", arg(&live), "--log", "json", "--record", arg(&recording)])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut events = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    assert!(events.by_ref().any(|line| line.unwrap().contains("\"state\":\"tracking\"")), "tracking begins");
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    assert!(events.last().unwrap().unwrap().contains("\"interrupted\":true"));
    assert!(child.wait().unwrap().success());
    run(&["run", arg(&recording), "--out", arg(&replay), "--quiet"]);
    assert_eq!(trajectory(&live), trajectory(&replay));
}

#[test]
fn a_recorded_folder_is_replayed_as_the_folder_itself() {
    let folder = tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    part_of_demo(&at("walk"), 30);
    let recording = at("r.mcap");
    let printed = run(&["record", arg(&at("walk")), "--out", arg(&recording)]);
    assert!(printed.contains("30 frames recorded"), "{printed}");
    assert_eq!(frames(&recording, false), frames(&at("walk"), false));
    for (source, out) in [(at("walk"), at("a")), (recording.clone(), at("b"))] {
        run(&["run", arg(&source), "--out", arg(&out), "--quiet", "--end", "1.5"]);
    }
    assert_eq!(trajectory(&at("a")), trajectory(&at("b")));
    for name in ["calibration", "size"] {
        assert!(!info(&recording, &[])[name].is_null(), "{name}");
    }
    assert_refused(&["record", arg(&at("walk")), "--out", arg(&recording)], &["already"]);
    let again = ["record", arg(&recording), "--out", arg(&recording), "--force"];
    assert_refused(&again, &["this is what is read"]);
    run(&["record", arg(&at("walk")), "--out", arg(&recording), "--force", "--duration", "0.5", "--quiet"]);
    assert_eq!(frames(&recording, false).0.len(), 8);
    assert_refused(&["record", arg(&at("walk")), "--out", "/nowhere/r.mcap"], &["/nowhere/r.mcap"]);
}

#[test]
fn start_and_end_of_a_recording_are_those_of_its_source() {
    let folder = tempdir().unwrap();
    let (walk, recording) = (folder.path().join("walk"), folder.path().join("r.mcap"));
    timed_folder(&walk, 40);
    run(&["record", arg(&walk), "--out", arg(&recording), "--quiet"]);
    for limits in [&["--start", "1"][..], &["--start", "0.95", "--end", "2.1"], &["--end", "0.5"]] {
        let (folder, replay) = (read_through(&walk, limits), read_through(&recording, limits));
        assert_eq!(processed_times(&folder), processed_times(&replay), "{limits:?}");
        assert_eq!(folder["rows"][0]["index"], replay["rows"][0]["index"], "{limits:?}");
    }
}

/// Records in real time into `path` until it is killed, `after` its file was there or, without that, once
/// there are frames in it; the frames that were on the disk before, and after.
fn killed(walk: &Path, path: &Path, out: &Path, after: Option<Duration>) -> (usize, usize) {
    let args = ["run", arg(walk), "--out", arg(out), "--quiet", "--realtime", "--record", arg(path)];
    let mut child = command().args(args).stderr(Stdio::null()).spawn().expect("the binary starts");
    let copy = path.with_extension("copy");
    let count = |path: &Path| {
        let opened = sources::open(path, &SourceOptions { all_frames: true, ..SourceOptions::default() });
        let Ok(mut source) = opened else { return 0 };
        let mut count = 0;
        while let Some(frame) = source.next_frame() {
            let Picture::Encoded(bytes) = frame.picture else { panic!("an encoded picture") };
            let original = std::fs::read(walk.join(format!("images/{count:06}.png"))).expect("it is there");
            assert_eq!((frame.index, &bytes), (count as u64, &original));
            count += 1;
        }
        count
    };
    let look = || std::fs::copy(path, &copy).map_or(0, |_| count(&copy));
    let wait_for = |there: &dyn Fn() -> bool| {
        let waited = (0..3000).find(|_| {
            std::thread::sleep(Duration::from_millis(20));
            there()
        });
        assert!(waited.is_some(), "a minute is enough");
    };
    match after {
        None => wait_for(&|| look() > 0),
        Some(after) => {
            wait_for(&|| path.exists());
            std::thread::sleep(after);
        }
    }
    let before = look();
    child.kill().expect("it can be killed");
    child.wait().expect("it ends");
    (before, count(path))
}

#[test]
fn a_killed_recording_gives_back_every_flushed_frame() {
    let folder = tempdir().unwrap();
    let walk = folder.path().join("walk");
    // Ten seconds at 100 frames a second: longer than any of them lives.
    let mut times = String::new();
    for i in 0..1000u32 {
        write(walk.join(format!("images/{i:06}.png")), encoded(i, image::ImageFormat::Png));
        times += &format!("{:.2} images/{i:06}.png\n", f64::from(i) * 0.01);
    }
    write(walk.join("times.txt"), times);
    write(walk.join("camera.yaml"), CAMERA);
    let mut random = geometry::Random::new(3);
    let mut moments = || Duration::from_millis(random.below(1200));
    let mut with_frames = 0;
    for round in 0..5 {
        let jobs: Vec<(PathBuf, PathBuf, Option<Duration>)> = (0..20)
            .map(|i| {
                let name = folder.path().join(format!("{round}-{i}"));
                (name.with_extension("mcap"), name, (i > 0).then(&mut moments))
            })
            .collect();
        std::thread::scope(|scope| {
            let walk = &walk;
            let runs: Vec<_> = jobs
                .iter()
                .map(|(path, out, after)| scope.spawn(move || killed(walk, path, out, *after)))
                .collect();
            for run in runs {
                let (before, after) = run.join().expect("what was read is right");
                assert!(after >= before, "{before} frames were on the disk, {after} are");
                with_frames += usize::from(after > 0);
            }
        });
    }
    assert!(with_frames >= 5, "those lived long enough to record");
}

#[test]
fn conversions_keep_pictures_stamps_and_calibration() {
    let folder = tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    timed_folder(&at("walk"), 12);
    write(
        at("walk/camera.yaml"),
        CAMERA.replace("pinhole", "kb4").replace("[]", "[0.1, -0.02, 0.003, 0.0000001]"),
    );
    let chain = ["walk", "a.mcap", "b.bag", "c", "d.bag", "e.mcap"];
    for pair in chain.windows(2) {
        run(&["convert", arg(&at(pair[0])), arg(&at(pair[1]))]);
        assert_eq!(frames(&at(pair[1]), false).0, frames(&at("walk"), false).0, "{pair:?}");
    }
    let camera = |path: &Path| calib::read_camera(&path.join("camera.yaml")).expect("a calibration").camera;
    run(&["convert", arg(&at("e.mcap")), arg(&at("f"))]);
    assert_eq!(camera(&at("f")), camera(&at("walk")));
    assert_eq!(info(&at("b.bag"), &[])["frames"], 12);
    assert!(!at("f.tmp").exists());
    assert_refused(&["convert", arg(&at("walk")), arg(&at("a.mcap"))], &["already", "--force"]);
    assert_refused(&["convert", arg(&at("walk")), arg(&at("walk")), "--force"], &["what is read"]);
    run(&["convert", arg(&at("a.mcap")), arg(&at("c")), "--force", "--quiet"]);
    assert_refused(&["convert", arg(&at("walk")), arg(&at("x.zip"))], &[".zip", "hint"]);
}

#[test]
fn a_video_keeps_every_frame_and_every_grey_level() {
    let folder = tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    timed_folder(&at("walk"), 12);
    for name in ["v.avi", "v.mkv"] {
        run(&["convert", arg(&at("walk")), arg(&at(name)), "--force", "--quiet"]);
        let (before, after) = (grey(&at("walk")), grey(&at(name)));
        assert_eq!(before.len(), after.len());
        let differences = before.iter().flatten().zip(after.iter().flatten()).map(|(a, b)| a.abs_diff(*b));
        assert_eq!(differences.max(), Some(0), "{name}");
        assert!(info(&at(name), &[])["calibration"].as_str().unwrap().ends_with("v.yaml"));
    }
}

#[test]
fn bags_with_several_topics_ask_for_one() {
    use sources::bag::{BagWriter, MessageType};
    let folder = tempdir().unwrap();
    let path = folder.path().join("two.bag");
    let file = std::fs::File::create(&path).unwrap();
    let mut writer = BagWriter::create(file).unwrap();
    let kind =
        MessageType { name: "sensor_msgs/Image", md5sum: "060021388200f6f0f447d0fcd9c64743", definition: "" };
    for (topic, encoding) in [("/left", "mono8"), ("/right", "32FC1")] {
        let connection = writer.connect(topic, kind);
        let mut message: Vec<u8> = [0u32, 9, 500_000_000, 0, HEIGHT, WIDTH, encoding.len() as u32]
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect();
        message.extend(encoding.as_bytes());
        message.push(0);
        message.extend(WIDTH.to_le_bytes());
        message.extend((WIDTH * HEIGHT).to_le_bytes());
        message.extend(picture(1).into_raw());
        writer.message(connection, 9_600_000_000, &message).unwrap();
    }
    writer.finish().unwrap();
    assert_refused(&["info", arg(&path)], &["several topics", "--topic", "/left", "/right"]);
    let printed = info(&path, &["--topic", "/left"]);
    assert_eq!((&printed["frames"], &printed["kind"]), (&1.into(), &"ROS 1 bag".into()));
    let camera = folder.path().join("camera.yaml");
    write(camera.clone(), CAMERA);
    let numbers = read_through(&path, &["--topic", "/left", "--calib", arg(&camera)]);
    assert_eq!(processed_times(&numbers), [9.5]);
    let numbers = read_through(&path, &["--topic", "/right", "--calib", arg(&camera)]);
    assert_eq!(numbers["frames"]["skipped"]["unreadable"], 1);
}
