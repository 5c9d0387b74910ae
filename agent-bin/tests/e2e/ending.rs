//! Runs that end before their recording does.

use crate::support::{Case, Outcome, drive, hand_held, loopbox};
use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Starts a run of `count` frames and waits until its map file holds some keyframes.
fn started(case: &Case) -> Child {
    let mut child = case
        .command(&[])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("loopbox can be started");
    let map = case.out().join("map.mcap");
    let start = Instant::now();
    while fs::metadata(&map).map_or(0, |m| m.len()) < 100_000 {
        assert!(child.try_wait().expect("a child can be asked").is_none(), "ended before it wrote its map");
        assert!(start.elapsed() < Duration::from_secs(60), "no map after a minute");
        sleep(Duration::from_millis(5));
    }
    child
}

/// A recording so long that it cannot end while the test looks away.
fn long_case() -> Case {
    Case::new(&hand_held(400))
}

#[test]
fn the_map_of_a_killed_run_loads() {
    let case = long_case();
    let mut child = started(&case);
    child.kill().expect("a child can be killed");
    let outcome = Outcome::from(child.wait_with_output().expect("a child can be waited for"));
    assert_eq!(outcome.code, None, "it was killed, not finished\n{outcome}");
    assert!(!case.map().keyframes.is_empty());
    let mut info = loopbox();
    info.arg("info").arg(case.out().join("map.mcap"));
    Outcome::of(info).assert_success();
}

/// Depth and points follow a keyframe by some; the file of a killed run has them of all others.
#[test]
fn the_map_of_a_killed_run_has_depth_and_points() {
    let case = Case::new(&drive());
    let mut run = case.command(&["--log", "json"]);
    let mut child = run.stdout(Stdio::piped()).spawn().expect("loopbox can be started");
    let events = BufReader::new(child.stdout.take().expect("it is piped")).lines();
    let enough = |line: String| {
        let event: serde_json::Value = serde_json::from_str(&line).expect("the log is JSON");
        event["keyframes"].as_u64().is_some_and(|keyframes| keyframes >= 12)
    };
    assert!(events.map_while(Result::ok).any(enough), "too few keyframes");
    child.kill().expect("a child can be killed");
    child.wait().expect("a child can be waited for");

    let map = case.map();
    let pixels = |keyframe: &map::Keyframe| keyframe.image.data().len() as f64;
    let density: Vec<f64> =
        map.keyframes.values().map(|keyframe| keyframe.semi_dense.len() as f64 / pixels(keyframe)).collect();
    let settled = density.len().saturating_sub(5);
    assert!(settled >= 5, "only {} keyframes", density.len());
    assert!(density[..settled].iter().all(|&density| density >= 0.08), "{density:?}");
    assert!(map.keyframes.values().take(settled).all(|keyframe| !keyframe.points.is_empty()));
    let ply = case.out().with_file_name("killed.ply");
    let mut export = loopbox();
    export.arg("export").arg(case.out()).arg("--ply").arg(&ply);
    let outcome = Outcome::of(export);
    outcome.assert_success();
    assert!(!outcome.text.contains(": 0 points"), "{outcome}");
}

#[test]
fn ctrl_c_ends_a_run_cleanly_and_saves() {
    let case = long_case();
    let child = started(&case);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.expect("kill can be run").success());
    let outcome = Outcome::from(child.wait_with_output().expect("a child can be waited for"));
    outcome.assert_success();
    outcome.assert_says(&["interrupted"]);
    let map = case.map();
    assert!(!map.keyframes.is_empty() && map.frames.len() < 400, "{} frames", map.frames.len());
    for name in ["trajectory.txt", "cloud.ply", "report.html", "run.json"] {
        assert!(case.out().join(name).exists(), "{name} is missing\n{outcome}");
    }
}

/// Results go to a file system of 200 kB.
#[test]
fn a_full_disk_is_reported() {
    let case = Case::new(&hand_held(60));
    fs::create_dir(case.out()).expect("the temporary folder takes a folder");
    let run = case.command(&[]);
    // A mount in a name space of its own needs no rights where the system allows such name spaces.
    let script = r#"mount -t tmpfs -o size=200k tmpfs "$0" && exec "$@""#;
    let mut mounted = Command::new("unshare");
    mounted.args(["-rm", "sh", "-c", script]).arg(case.out()).arg(run.get_program()).args(run.get_args());
    let allowed = Command::new("unshare").args(["-rm", "sh", "-c", "mount -t tmpfs tmpfs /mnt"]).output();
    if allowed.is_ok_and(|output| output.status.success()) {
        Outcome::of(mounted).assert_refused(&["map.mcap", "no space left"]);
    } else {
        eprintln!("no name spaces here: the full disk is tested only as a limit on the size of files");
    }
}

/// No file may grow beyond 100 kB; the signal that comes with it is ignored, so that writing just fails.
#[test]
fn a_limit_on_file_size_is_reported() {
    let case = Case::new(&hand_held(60));
    let run = case.command(&[]);
    let mut limited = Command::new("bash");
    limited.args(["-c", r#"trap "" XFSZ; ulimit -f 100; exec "$0" "$@""#]);
    limited.arg(run.get_program()).args(run.get_args());
    Outcome::of(limited).assert_refused(&["map.mcap", "too large"]);
}
