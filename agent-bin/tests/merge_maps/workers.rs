//! Workers on a store: maps and verdicts in one folder.

use crate::support::{Case, Runs, arg, loopbox};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A worker that is ended with the test.
struct Worker(Child);

impl Worker {
    fn start(store: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        command.args(["worker", "--store", arg(store), "--quiet"]).stdout(Stdio::null());
        Self(command.spawn().expect("loopbox starts"))
    }

    /// As `kill -9`.
    fn kill(&mut self) {
        self.0.kill().expect("it is ours");
        self.0.wait().expect("it is ours");
    }

    /// Stops it as service managers do; whether it ended well.
    fn stop(mut self) -> bool {
        let sent = Command::new("kill").arg(self.0.id().to_string()).status();
        assert!(sent.expect("kill can be run").success());
        self.0.wait().expect("it is ours").success()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // Nothing to be done where it ended by itself.
        let _ = self.0.kill().and_then(|()| self.0.wait());
    }
}

fn verdicts(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let Ok(entries) = fs::read_dir(folder) else { return BTreeMap::new() };
    let files = entries.map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some());
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    files.map(|path| (name(&path), fs::read(path).unwrap())).collect()
}

fn wait_for(count: usize, folder: &Path) {
    let begun = Instant::now();
    while verdicts(folder).len() < count {
        assert!(begun.elapsed() < Duration::from_secs(300), "{:?}", verdicts(folder).keys());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn put(runs: &Runs, store: &Path, name: &str) {
    let folder = store.join("maps").join(name);
    fs::create_dir_all(&folder).unwrap();
    fs::copy(runs.run(name).join("map.mcap"), folder.join("map.mcap")).unwrap();
}

#[test]
fn two_workers_share_a_store_one_is_killed_and_a_map_comes_later() {
    let (runs, case) = (Runs::get(), Case::new());
    let (store, kept) = (case.path("store"), case.path("store/verdicts"));
    ["left", "elsewhere"].iter().for_each(|name| put(runs, &store, name));
    let (mut killed, other) = (Worker::start(&store), Worker::start(&store));
    wait_for(1, &kept);
    put(runs, &store, "right");
    // In the middle of its pairs, or before.
    wait_for(2, &kept);
    killed.kill();
    wait_for(3, &kept);
    assert!(other.stop());

    let outcome = loopbox(&["worker", "--store", arg(&store), "--once"]);
    outcome.assert_success();
    assert!(outcome.stderr.contains("0 pairs of maps judged here"), "{outcome:#?}");
    let stored = ["left", "right", "elsewhere"].map(|name| store.join("maps").join(name));
    let stored = stored.each_ref().map(|map| arg(map));
    let merge = |verdicts: &Path, out: &str| {
        let (out, more) = (case.path(out), ["--verdicts", arg(verdicts), "--out"]);
        let outcome = loopbox(&[&["merge"][..], &stored, &more, &[arg(&out)]].concat());
        outcome.assert_success();
        (outcome.stderr, fs::read(out.join("map.mcap")).unwrap())
    };
    let alone = case.path("alone");
    let (_, map) = merge(&alone, "one");
    assert!(verdicts(&alone) == verdicts(&kept), "other verdicts");
    let (said, same) = merge(&kept, "two");
    assert!(said.contains("making the common map") && !said.contains("looking where"), "{said}");
    assert!(map == same, "another map");
}

/// A store of two maps that join and of a text that is none.
fn with_a_text(case: &Case) -> PathBuf {
    let (runs, store) = (Runs::get(), case.path("store"));
    ["left", "right"].iter().for_each(|name| put(runs, &store, name));
    fs::write(store.join("maps/text.mcap"), "no map").unwrap();
    store
}

#[test]
fn a_worker_that_is_to_end_names_what_it_left_out() {
    let case = Case::new();
    let store = with_a_text(&case);
    let outcome = loopbox(&["worker", "--store", arg(&store), "--once"]);
    outcome.assert_refused(&["not all pairs could be judged", "text.mcap"]);
    assert!(outcome.stderr.contains("left + right: accepted"), "{outcome:#?}");
    assert_eq!(verdicts(&store.join("verdicts")).len(), 1);
}

/// The level of every line of a log; fails where one has none, or no time.
fn levels(log: &str) -> Vec<&str> {
    fn level(line: &str) -> &str {
        let mut words = line.split_whitespace();
        let (time, level) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
        let form: String = time.chars().map(|c| if c.is_ascii_digit() { '0' } else { c }).collect();
        assert_eq!(form, "0000-00-00T00:00:00.000Z", "{line}");
        level
    }
    log.lines().map(level).collect()
}

#[test]
fn a_log_has_times_and_levels_and_what_is_chosen() {
    let case = Case::new();
    let store = with_a_text(&case);
    let log = |level: &str, variable: &str| {
        // Each finds the verdict itself.
        let _ = fs::remove_dir_all(store.join("verdicts"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        command.args(["worker", "--store", arg(&store), "--once"]).env("LOOPBOX_LOG", variable);
        if !level.is_empty() {
            command.args(["--log", level]);
        }
        let output = command.output().expect("loopbox starts");
        (String::from_utf8(output.stderr).expect("text"), output.status.code())
    };
    let (debug, code) = log("debug", "");
    let found = levels(&debug);
    assert!(
        code == Some(1) && ["DEBUG", "INFO", "WARN", "ERROR"].iter().all(|level| found.contains(level)),
        "{debug}"
    );
    assert!(debug.contains(" INFO  left + right: accepted"), "{debug}");
    assert!(debug.contains(" WARN  left out: "), "{debug}");
    // The flag comes before the variable.
    let (warn, _) = log("warn", "debug");
    assert!(levels(&warn).iter().all(|level| ["WARN", "ERROR"].contains(level)), "{warn}");
    let (by_variable, _) = log("", "error");
    assert_eq!(levels(&by_variable), ["ERROR"], "{by_variable}");
    // Without both as people read it.
    let (plain, _) = log("", "");
    assert!(plain.starts_with("warning: left out: ") && plain.contains("\nerror: not all pairs"), "{plain}");
    assert!(plain.contains("\nleft + right: accepted") && !plain.contains("looking where"), "{plain}");
    for (level, variable) in [("loud", ""), ("", "loud")] {
        let (refused, code) = log(level, variable);
        assert!(
            code == Some(2) && refused.contains("loud") && refused.contains("error, warn, info, debug"),
            "{refused}"
        );
    }
}
