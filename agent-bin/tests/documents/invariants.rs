//! The invariants of ARCHITECTURE.md hold in the code: which parts read no clock, open no file and no socket, and start no
//! thread.

use crate::markdown::{read, repository};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// What reads a clock or draws random numbers, opens a file, or opens a socket.
const OUTSIDE: [&str; 6] = ["Instant", "SystemTime", "getrandom", "std::fs", "File::", "std::net"];
/// What starts a thread, but those of rayon's pool for loops.
const THREADS: [&str; 2] = ["std::thread", "thread::"];
/// The methods, which are functions of values.
const METHODS: [&str; 3] = ["merge/src", "slam-direct/src", "slam-lidar/src"];

/// The lines of code in a folder that name one of `words`, without comments and tests.
fn uses(folder: &Path, words: &[&str]) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("the folder is there") {
        let path = entry.expect("it can be listed").path();
        let name = path.file_stem().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
        if name.starts_with("test") || name.ends_with("_tests") || name.ends_with("_data") {
            continue;
        }
        if path.is_dir() {
            found.extend(uses(&path, words));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.extend(uses_of_file(&path, words));
        }
    }
    found
}

/// The same of a file.
fn uses_of_file(path: &Path, words: &[&str]) -> Vec<String> {
    let text = fs::read_to_string(path).expect("it is text");
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let named = lines.filter(|line| words.iter().any(|word| line.contains(word)));
    named.map(|line| format!("{}: {}", path.display(), line.trim())).collect()
}

#[test]
fn methods_and_the_node_of_a_fleet_read_no_clock_and_open_nothing() {
    for part in METHODS.into_iter().chain(["fleet/src/node"]) {
        let found = uses(&repository().join(part), &OUTSIDE);
        assert!(
            found.is_empty(),
            "ARCHITECTURE.md says that {part} is a function of values:\n{}",
            found.join("\n")
        );
    }
}

#[test]
fn one_module_of_the_methods_starts_threads() {
    for part in METHODS {
        let mut found = uses(&repository().join(part), &THREADS);
        found.retain(|line| !line.contains("slam-direct/src/background.rs"));
        assert!(
            found.is_empty(),
            "ARCHITECTURE.md says that only `background` starts threads:\n{}",
            found.join("\n")
        );
    }
}

#[test]
fn clocks_files_sockets_and_threads_are_found() {
    let found = |part: &str, word: &str| {
        let lines = uses(&repository().join(part), &[word]);
        assert!(!lines.is_empty(), "{part} uses {word}");
    };
    found("sources/src/camera", "Instant");
    found("scans/src", "std::fs");
    found("fleet/src/transport", "std::net");
    found("slam-direct/src", "std::thread");
}

/// What each room of `loopbox` imports of the others: files and folders of its sources, without tests.
fn imports() -> BTreeMap<String, BTreeSet<String>> {
    let sources = repository().join("loopbox/src");
    let entries = fs::read_dir(&sources).expect("the library has sources").map(|e| e.expect("listed").path());
    let name = |path: &Path| path.file_stem().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
    let rooms: BTreeSet<String> = entries.map(|path| name(&path)).filter(|room| room != "lib").collect();
    let of_room = |room: &String| {
        let (file, folder) = (sources.join(format!("{room}.rs")), sources.join(room));
        let mut lines = if folder.is_dir() { uses(&folder, &["crate::"]) } else { Vec::new() };
        if file.is_file() {
            lines.extend(uses_of_file(&file, &["crate::"]));
        }
        let named = |other: &&String| {
            *other != room && lines.iter().any(|line| line.contains(&format!("crate::{other}::")))
        };
        (room.clone(), rooms.iter().filter(named).cloned().collect())
    };
    rooms.iter().map(of_room).collect()
}

#[test]
fn imports_between_rooms_of_the_library_have_no_circle() {
    let mut left = imports();
    assert!(left["run"].contains("merging") && left["merging"].contains("lidar"), "{left:?}");
    // Rooms that import none that is left can be taken away, down to the last one.
    while !left.is_empty() {
        let lowest: Vec<String> = left
            .iter()
            .filter(|(_, others)| others.iter().all(|other| !left.contains_key(other)))
            .map(|(room, _)| room.clone())
            .collect();
        assert!(!lowest.is_empty(), "ARCHITECTURE.md says that rooms import one way: {left:?}");
        left.retain(|room, _| !lowest.contains(room));
    }
}

#[test]
fn each_flow_has_an_invariant() {
    let text = read(&repository(), "ARCHITECTURE.md").text;
    for flow in ["The house", "A frame", "A merge", "A map in a fleet", "A LiDAR's map"] {
        let (_, section) = text.split_once(&format!("\n## {flow}\n")).expect(flow);
        let section = section.split("\n## ").next().unwrap_or_default();
        assert!(section.contains("\n> **Invariant:** "), "{flow}: no invariant");
        assert!(section.contains("\n```text\n"), "{flow}: no picture");
    }
}
