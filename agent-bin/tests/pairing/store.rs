//! Stations with a store at rest, and workers that judge its pairs.

use crate::common::{arg, loopbox, stderr};
use crate::{Process, address, assert_is_the_merge_of_the_files, bytes, recording, run, status};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// The objects in a folder. What is on its way begins with a dot, and stays where its process is killed.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).expect("it is there").flatten();
    let objects = entries.filter(|entry| !entry.file_name().to_string_lossy().starts_with('.'));
    objects.map(|entry| (entry.file_name().to_string_lossy().into_owned(), bytes(&entry.path()))).collect()
}

#[test]
fn a_station_shares_maps_and_verdicts_with_workers_and_its_map_is_as_without() {
    let room = tempfile::tempdir().expect("a folder");
    let [station, store, a, b] = ["station", "store", "a", "b"].map(|name| room.path().join(name));
    let worker = ["worker", "--quiet", "--store", arg(&store)];
    let (killed, worker) = (Process::start(&worker), Process::start(&worker));
    let begin = |out: &Path| {
        let more = ["--listen", "tcp/127.0.0.1:0", "--agents", "2", "--store", arg(&store)];
        Process::start(&[&["station", "--quiet", "--out", arg(out)], &more[..]].concat())
    };
    let there = begin(&station);
    let at = address(&station);
    let [one, other] = [("a", &a), ("b", &b)].map(|(name, out)| run(name, out, &["--connect", &at]));
    assert!(one.succeeded());
    killed.kill();
    assert!(other.succeeded() && there.succeeded());
    drop(worker);
    assert_is_the_merge_of_the_files(&station, [&a, &b], ["a", "b"]);
    let verdicts = files(&station.join("verdicts"));
    let shared = files(&store.join("verdicts"));
    assert!(verdicts.len() == 1 && shared == verdicts, "{:?}, {:?}", verdicts.keys(), shared.keys());
    let maps: Vec<Vec<u8>> = files(&store.join("maps")).into_values().collect();
    let own = [&a, &b].map(|out| bytes(&out.join("map.mcap")));
    assert!(maps.len() == 2 && own.iter().all(|map| maps.contains(map)), "other maps");
    let output = loopbox(&["worker", "--store", arg(&store), "--once"]);
    assert!(stderr(&output).contains("0 pairs of maps judged here"), "{}", stderr(&output));

    // Another station takes the verdict as it is in the store: this one by a byte that means nothing.
    let (name, mut marked) = verdicts.into_iter().next().expect("one");
    marked.push(0);
    fs::write(store.join("verdicts").join(&name), &marked).expect("there is room");
    let next = room.path().join("next");
    let there = begin(&next);
    let at = address(&next);
    for out in [&a, &b] {
        let sent = loopbox(&["fleet", arg(out), "--connect", &at]);
        assert!(sent.status.success(), "{}", stderr(&sent));
    }
    assert!(there.succeeded());
    let found = status(&next, |_| true);
    assert_eq!(found["found"]["meetings"][0]["verdict"], "accepted", "{found:#}");
    assert!(files(&next.join("verdicts"))[&name] == marked, "the station judged the pair itself");
    // The map names the files that it was made of.
    for file in ["cloud.ply", "trajectory-a.txt", "trajectory-b.txt"] {
        assert!(bytes(&next.join(file)) == bytes(&station.join(file)), "{file} is another one");
    }
}

#[cfg(feature = "object-store")]
#[test]
fn a_station_on_a_bucket_and_four_workers_that_are_killed_make_the_same_map() {
    use crate::bucket::Server;
    use crate::common::command;
    use std::time::Duration;

    let Some(server) = Server::begin() else { return };
    let room = tempfile::tempdir().expect("a folder");
    let [station, cache, a, b] = ["station", "cache", "a", "b"].map(|name| room.path().join(name));
    let store = ["--store", "s3://bucket/fleet"];
    let worker = || {
        let mut worker = command();
        Process::of(server.serve(worker.args(["worker", "--quiet", "-j", "1"]).args(store), &cache))
    };
    let mut workers: Vec<Process> = (0..4).map(|_| worker()).collect();
    let mut of_station = command();
    of_station.args(["station", "--quiet", "--out", arg(&station), "--listen", "tcp/127.0.0.1:0"]);
    let there = Process::of(server.serve(of_station.args(["--agents", "2"]).args(store), &cache));
    let at = address(&station);
    let [one, other] = [("a", &a), ("b", &b)].map(|(name, out)| run(name, out, &["--connect", &at]));
    for number in 0..12 {
        std::thread::sleep(Duration::from_millis(150 + 370 * (number * 7 % 5)));
        std::mem::replace(&mut workers[number as usize % 4], worker()).kill();
    }
    assert!(one.succeeded() && other.succeeded() && there.succeeded());
    assert_is_the_merge_of_the_files(&station, [&a, &b], ["a", "b"]);
    let verdicts = files(&station.join("verdicts"));
    let of_bucket: BTreeMap<String, Vec<u8>> = server
        .names("fleet/verdicts/")
        .iter()
        .map(|name| (name.trim_start_matches("fleet/verdicts/").to_owned(), server.get(name)))
        .collect();
    assert!(verdicts.len() == 1 && of_bucket == verdicts, "{:?}", of_bucket.keys());
    let maps: Vec<Vec<u8>> = server.names("fleet/maps/").iter().map(|name| server.get(name)).collect();
    let own = [&a, &b].map(|out| bytes(&out.join("map.mcap")));
    assert!(maps.len() == 2 && own.iter().all(|map| maps.contains(map)), "other maps");
}

#[test]
fn a_store_that_cannot_be_used_is_named_before_anything_begins() {
    let room = tempfile::tempdir().expect("a folder");
    let [file, out] = ["file", "station"].map(|name| room.path().join(name));
    fs::write(&file, "in the way").expect("there is room");
    let listen = ["--listen", "tcp/127.0.0.1:0", "--store", arg(&file)];
    let output = loopbox(&[&["station", "--out", arg(&out)], &listen[..]].concat());
    let said = stderr(&output);
    assert!(output.status.code() == Some(1) && said.contains("file: the folder cannot be made"), "{said}");
}

#[test]
fn a_run_puts_its_map_into_a_store_without_any_station() {
    let room = tempfile::tempdir().expect("a folder");
    let [store, out] = ["store", "a"].map(|name| room.path().join(name));
    let recording = recording("a");
    let run = ["run", arg(&recording), "--out", arg(&out), "--quiet", "--store", arg(&store)];
    let output = loopbox(&run);
    assert!(output.status.success(), "{}", stderr(&output));
    let maps: Vec<Vec<u8>> = files(&store.join("maps")).into_values().collect();
    assert!(maps == [bytes(&out.join("map.mcap"))], "another map");
    // Before the run a store that cannot be used is named.
    let [file, nothing] = ["file", "nothing"].map(|name| room.path().join(name));
    fs::write(&file, "in the way").expect("there is room");
    let output = loopbox(&["run", arg(&recording), "--out", arg(&nothing), "--store", arg(&file)]);
    let said = stderr(&output);
    assert!(output.status.code() == Some(1) && said.contains("file: the folder cannot be made"), "{said}");
    assert!(!nothing.exists());
}
