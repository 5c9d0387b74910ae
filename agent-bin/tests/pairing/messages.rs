//! What is said of those who are not there, or not any more, and of pairs that are not decided yet.

use super::common::{arg, loopbox, stderr, stdout};
use super::{Process, address, recording, status};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// What `loopbox fleet` says of a folder, and its exit code.
fn of(folder: &Path) -> (String, Option<i32>) {
    let output = loopbox(&["fleet", arg(folder)]);
    (format!("{}{}", stdout(&output), stderr(&output)), output.status.code())
}

#[test]
fn a_silent_peer_is_reported_and_the_hint_at_the_end_works() {
    let room = tempfile::tempdir().expect("a folder");
    let [station, out] = ["station", "a b"].map(|name| room.path().join(name));
    // A port that is free by then.
    let first =
        Process::start(&["station", "--quiet", "--out", arg(&station), "--listen", "tcp/127.0.0.1:0"]);
    let at = address(&station);
    first.kill();
    let recording = recording("a");
    let run = ["run", arg(&recording), "--out", arg(&out), "--fleet=a", "--connect", &at];
    let output = loopbox(&run);
    let printed = stderr(&output);
    assert!(output.status.success(), "{printed}");
    assert!(printed.contains(&format!("{at} does not answer")), "{printed}");
    let hint = printed.lines().find_map(|line| line.split_once("this tells it: ")).expect("a hint").1;
    let words = hint.strip_prefix("loopbox ").expect("a command").replace('\'', "\"");
    // The name of the folder has a space.
    let (before, after) = words.split_once('"').expect("a quoted name");
    let (folder, after) = after.split_once('"').expect("its end");
    let words = before.split_whitespace().chain([folder]).chain(after.split_whitespace());
    let words: Vec<&str> = words.collect();
    let listen = ["station", "--quiet", "--out", arg(&station), "--agents", "1", "--listen", &at];
    let killed = status(&station, |_| true)["written_ms"].clone();
    let again = Process::start(&listen);
    status(&station, |status| status["written_ms"] != killed);
    let published = loopbox(&words);
    assert!(published.status.success(), "{words:?}: {}", stderr(&published));
    assert!(again.succeeded());
    let (printed, code) = of(&station);
    assert!(printed.contains("station, ended ") && code == Some(0), "{code:?}: {printed}");
    assert!(printed.contains("map of a told by a"), "{printed}");
}

#[test]
fn a_station_that_was_killed_or_dials_nobody_is_not_well() {
    let room = tempfile::tempdir().expect("a folder");
    let station = room.path().join("station");
    let words = ["station", "--quiet", "--out", arg(&station), "--listen", "tcp/127.0.0.1:0"];
    let there = Process::start(&[&words[..], &["--connect", "tcp/127.0.0.1:9"]].concat());
    let silent = status(&station, |status| status["links"][0]["why"].is_string());
    assert_eq!(silent["links"][0]["name"], "tcp/127.0.0.1:9", "{silent:#}");
    let (printed, code) = of(&station);
    assert!(printed.contains("tcp/127.0.0.1:9: does not answer for"), "{printed}");
    assert!(printed.contains("no answer from tcp/127.0.0.1:9") && code == Some(5), "{code:?}: {printed}");
    there.kill();
    std::thread::sleep(Duration::from_secs(11));
    let (printed, code) = of(&station);
    assert!(printed.contains("no heartbeat for") && code == Some(5), "{code:?}: {printed}");
    assert!(!printed.contains("listening at"), "{printed}");
}

/// Fails when something is said for good of a pair of which one map is not whole, or its run goes on, until the station ends.
pub fn assert_no_message_is_too_early(station: &Path) {
    loop {
        let seen = status(station, |status| status["agents"].is_array());
        let is_over = |agent: &Value| {
            let mut lines = seen["agents"].as_array().into_iter().flatten();
            lines.any(|line| line["agent"] == *agent && line["missing"] == 0 && line["finished"] == true)
        };
        for pair in seen["found"]["meetings"].as_array().into_iter().flatten() {
            let is_final = pair["verdict"] == "refused" || pair["verdict"] == "undecided";
            let both = pair["agents"].as_array().expect("two agents");
            assert!(!is_final || both.iter().all(is_over), "{seen:#}");
        }
        if seen["ended"] == true {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}
