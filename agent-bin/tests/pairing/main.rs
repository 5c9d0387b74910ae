//! Agents that pair over a network, through the binary: processes of their own on this machine.
#![cfg(feature = "fleet")]

#[cfg(feature = "object-store")]
#[path = "../common/bucket.rs"]
mod bucket;
#[path = "../common/mod.rs"]
mod common;
mod disk;
mod lidar;
mod messages;
#[cfg(feature = "view")]
mod page;
mod store;
mod trust;

use common::{arg, command, loopbox, stderr, stdout};
use loopbox_tests::proxy::{Link, Proxy};
use loopbox_tests::{Encoding, Recording, World, trajectory};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Two recordings of drives past the same boxes, `a` and `b`, that share their middle.
fn recordings() -> &'static Path {
    static ROOM: OnceLock<TempDir> = OnceLock::new();
    let room = ROOM.get_or_init(|| {
        let room = tempfile::tempdir().expect("a folder");
        let path = trajectory::sideways(180, 8.1);
        let yard = World::yard(1);
        for (name, part) in [("a", &path[..105]), ("b", &path[75..])] {
            let recording = Recording::render(&yard, Recording::SMALL_CAMERA, part, 30.0);
            recording.write(&room.path().join("r").join(name), Encoding::Png).expect("there is room");
        }
        room
    });
    room.path()
}

fn recording(name: &str) -> PathBuf {
    recordings().join("r").join(name)
}

/// A process that is ended with the test.
struct Process(Child);

impl Process {
    fn start(args: &[&str]) -> Self {
        Self::of(command().args(args))
    }

    fn of(command: &mut Command) -> Self {
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        Self(child.expect("it starts"))
    }

    /// Waits for its end; whether it succeeded.
    fn succeeded(mut self) -> bool {
        let end = Instant::now() + Duration::from_secs(300);
        while Instant::now() < end {
            if let Some(status) = self.0.try_wait().expect("it is ours") {
                return status.success();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        false
    }

    /// Sends it a signal.
    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([format!("-{name}"), self.0.id().to_string()]).status();
        assert!(sent.expect("kill can be run").success());
    }

    /// As `kill -9`.
    fn kill(mut self) {
        self.0.kill().expect("it is ours");
        self.0.wait().expect("it is ours");
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What `fleet.json` in a folder says, once it says what is asked for.
fn status(folder: &Path, wanted: impl Fn(&Value) -> bool) -> Value {
    let end = Instant::now() + Duration::from_secs(300);
    loop {
        let text = fs::read(folder.join("fleet.json")).unwrap_or_default();
        let status: Value = serde_json::from_slice(&text).unwrap_or_default();
        if wanted(&status) {
            return status;
        }
        assert!(Instant::now() < end, "{status:#}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn address(folder: &Path) -> String {
    let found = status(folder, |status| status["listening"].is_string());
    found["listening"].as_str().expect("it is a text").to_owned()
}

fn run(name: &str, out: &Path, more: &[&str]) -> Process {
    let (recording, named) = (recording(name), ["--quiet", &format!("--fleet={name}")]);
    Process::start(&[&["run", arg(&recording), "--out", arg(out)], &named[..], more].concat())
}

/// The folder of an agent's own map at a station.
fn collected(station: &Path, name: &str) -> PathBuf {
    let entries = fs::read_dir(station.join("agents")).expect("maps were collected").flatten();
    let mut found = entries.filter(|e| e.file_name().to_string_lossy().starts_with(&format!("{name}-")));
    found.next().expect("it was collected").path()
}

fn bytes(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Fails unless the station has the agents' own maps, and the common map of a merge of these files, to the last bit: without the joint
/// optimisation, which a map that goes on growing is not held up for.
fn assert_is_the_merge_of_the_files<const N: usize>(station: &Path, agents: [&Path; N], names: [&str; N]) {
    for (own, name) in agents.iter().zip(names) {
        let there = collected(station, name).join("map.mcap");
        assert!(bytes(&there) == bytes(&own.join("map.mcap")), "{name}'s map is another one at the station");
    }
    let json: Value = serde_json::from_slice(&bytes(&station.join("merge.json"))).expect("numbers");
    let inputs: Vec<&str> =
        json["inputs"].as_array().expect("inputs").iter().filter_map(|i| i["path"].as_str()).collect();
    let merged = |verdicts: &Path, out: &str| {
        let out = station.with_file_name(out);
        let more = ["--no-optimise", "--verdicts", arg(verdicts), "--out", arg(&out)];
        let output = loopbox(&[&["merge"], &inputs[..], &more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(bytes(&out.join("map.mcap")) == bytes(&station.join("map.mcap")), "the common maps differ");
        stderr(&output)
    };
    let verdicts = station.with_file_name("again-verdicts");
    merged(&verdicts, "again");
    // Its verdicts are those of the merge, which has nothing left to look at.
    let files = |folder: &Path| -> BTreeMap<_, _> {
        let entries = fs::read_dir(folder).expect("verdicts").flatten();
        entries.map(|entry| (entry.file_name(), bytes(&entry.path()))).collect()
    };
    assert!(files(&station.join("verdicts")) == files(&verdicts), "other verdicts");
    let said = merged(&station.join("verdicts"), "with-verdicts");
    assert!(said.contains("making the common map") && !said.contains("looking where"), "{said}");
}

#[test]
fn a_station_collects_and_merges_and_is_killed_meanwhile() {
    let room = tempfile::tempdir().expect("a folder");
    let [station, a, b] = ["station", "a", "b"].map(|name| room.path().join(name));
    let listen = ["station", "--quiet", "--out", arg(&station), "--listen"];
    let first = Process::start(&[&listen[..], &["tcp/127.0.0.1:0"]].concat());
    let at = address(&station);
    let one = run("a", &a, &["--connect", &at]);
    // As soon as it holds something it dies, and comes back where it was.
    status(&station, |status| status["agents"].as_array().is_some_and(|agents| !agents.is_empty()));
    first.kill();
    fs::remove_file(station.join("fleet.json")).expect("it was there");
    let again = Process::start(&[&listen[..], &[&at, "--agents", "2"]].concat());
    // A late joiner.
    let other = run("b", &b, &["--connect", &at]);
    assert!(one.succeeded() && other.succeeded());
    assert!(again.succeeded());
    let found = status(&station, |_| true);
    assert_eq!(found["found"]["meetings"][0]["verdict"], "accepted", "{found:#}");
    assert_is_the_merge_of_the_files(&station, [&a, &b], ["a", "b"]);
    // The agents were told where they are.
    let output = loopbox(&["fleet", arg(&station)]);
    let printed = stdout(&output);
    assert!(
        ["a + b: accepted", "all here", "run over"].iter().all(|words| printed.contains(words)),
        "{printed}"
    );
}

#[test]
fn the_station_off_the_result_is_as_alone_and_all_is_sent_when_it_is_back() {
    let room = tempfile::tempdir().expect("a folder");
    let [station, alone, with_fleet] = ["station", "alone", "a"].map(|name| room.path().join(name));
    let output = loopbox(&["run", arg(&recording("a")), "--out", arg(&alone), "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    // Nobody listens there.
    assert!(run("a", &with_fleet, &["--connect", "tcp/127.0.0.1:9"]).succeeded());
    for file in ["map.mcap", "trajectory.txt", "cloud.ply"] {
        assert!(bytes(&alone.join(file)) == bytes(&with_fleet.join(file)), "{file} is another one");
    }
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "1"];
    let back = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let at = address(&station);
    let published = loopbox(&["fleet", arg(&with_fleet), "--connect", &at]);
    assert!(published.status.success(), "{}", stderr(&published));
    assert!(back.succeeded());
    assert!(bytes(&collected(&station, "a").join("map.mcap")) == bytes(&alone.join("map.mcap")));
}

#[test]
fn a_link_that_loses_and_is_cut_off_carries_the_same_map() {
    let room = tempfile::tempdir().expect("a folder");
    let [station, a, b] = ["station", "a", "b"].map(|name| room.path().join(name));
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "2"];
    let there = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let link = Link { lost: 50, rate: None };
    let proxies = [1, 2].map(|seed| Proxy::start(&address(&station), link, seed).expect("a port is free"));
    let [one, other] = [("a", &a, &proxies[0]), ("b", &b, &proxies[1])]
        .map(|(name, out, proxy)| run(name, out, &["--connect", proxy.address()]));
    let objects = |folder: &Path| {
        let status = status(folder, |status| status["links"][0]["received"].is_u64());
        status["links"][0]["received"].as_u64().expect("a number")
    };
    while objects(&station) < 50_000 {
        std::thread::sleep(Duration::from_millis(20));
    }
    // For longer than it takes to notice.
    proxies.iter().for_each(|proxy| proxy.cut(true));
    std::thread::sleep(Duration::from_secs(10));
    proxies.iter().for_each(|proxy| proxy.cut(false));
    assert!(one.succeeded() && other.succeeded() && there.succeeded());
    assert_is_the_merge_of_the_files(&station, [&a, &b], ["a", "b"]);
}

/// An agent that answers no more, and holds its connection open, keeps no other one from being collected.
#[test]
fn one_that_stands_still_keeps_nobody() {
    let room = tempfile::tempdir().expect("a folder");
    let [a, b] = kept(room.path());
    let station = room.path().join("station");
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "2"];
    let there = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let slow = Link { lost: 0, rate: Some(200e3) };
    let proxy = Proxy::start(&address(&station), slow, 1).expect("a port is free");
    let still = Process::start(&["fleet", arg(&a), "--connect", proxy.address()]);
    while proxy.carried() < 50_000 {
        std::thread::sleep(Duration::from_millis(5));
    }
    still.signal("STOP");
    let other = Process::start(&["fleet", arg(&b), "--connect", &address(&station)]);
    let is_whole = |agent: &Value| agent["missing"] == 0 && agent["finished"] == true;
    let found = status(&station, |status| {
        status["agents"].as_array().is_some_and(|agents| agents.len() == 2 && agents.iter().any(is_whole))
    });
    let whole = found["agents"].as_array().expect("agents").iter().filter(|agent| is_whole(agent)).count();
    assert_eq!(whole, 1, "that of the other one is not there yet: {found:#}");
    still.signal("CONT");
    assert!(there.succeeded() && still.succeeded() && other.succeeded());
    assert_is_the_merge_of_the_files(&station, [&a, &b], ["a", "b"]);
}

/// Results of runs that reached nobody, with their maps kept to be told.
fn kept(room: &Path) -> [PathBuf; 2] {
    ["a", "b"].map(|name| {
        let out = room.join(name);
        assert!(run(name, &out, &["--connect", "tcp/127.0.0.1:9"]).succeeded());
        out
    })
}

/// At 256 kbit/s it takes a minute and more until all is there. Long before, maps in part are merged.
#[test]
fn over_a_slow_link_maps_are_merged_by_a_part_of_them_as_by_all() {
    let room = tempfile::tempdir().expect("a folder");
    let [a, b] = kept(room.path());
    let station = room.path().join("station");
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "2"];
    let there = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let slow = Link { lost: 0, rate: Some(32e3) };
    let proxies = [1, 2].map(|seed| Proxy::start(&address(&station), slow, seed).expect("a port is free"));
    let _agents = [(&a, &proxies[0]), (&b, &proxies[1])]
        .map(|(out, proxy)| Process::start(&["fleet", arg(out), "--connect", proxy.address()]));
    let decided = |status: &Value| {
        let mut meetings = status["found"]["meetings"].as_array().into_iter().flatten();
        meetings.any(|pair| pair["pending"] == false)
    };
    let found = status(&station, decided);
    let missing = |status: &Value| status["agents"][0]["missing"].as_u64().expect("a number");
    assert_eq!(found["found"]["meetings"][0]["verdict"], "accepted", "{found:#}");
    assert!(missing(&found) > 0, "{found:#}");
    let carried: u64 = proxies.iter().map(Proxy::carried).sum();
    let all: u64 = [&a, &b].iter().map(|out| out.join("map.mcap").metadata().expect("a file").len()).sum();
    assert!(carried < all / 2, "{carried} of {all} bytes");
    // The agents lie to each other as all of both maps has it.
    let whole = room.path().join("whole");
    let output = loopbox(&["merge", arg(&a), arg(&b), "--out", arg(&whole), "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let merged: Value = serde_json::from_slice(&bytes(&whole.join("merge.json"))).expect("numbers");
    let of_parts = found["found"]["agents"][1]["root_from_agent"][7].as_f64().expect("a scale");
    let of_all = merged["agents"][1]["root_from_agent"]["scale"].as_f64().expect("a scale");
    assert!((of_parts / of_all).ln().abs() < 0.02, "{of_parts} {of_all}");
    drop(there);
}

/// More than fit into one go: what pairs are looked at first makes no difference to what comes of all of them.
#[test]
fn some_that_come_at_once_are_merged_as_their_files() {
    let room = tempfile::tempdir().expect("a folder");
    let station = room.path().join("station");
    let yard = World::yard(1);
    let path = trajectory::sideways(180, 8.1);
    let names = ["one", "two", "three", "four", "five"];
    let folders = names.map(|name| room.path().join(name));
    for (number, (name, out)) in names.iter().zip(&folders).enumerate() {
        let part = &path[25 * number..25 * number + 75];
        let recording = Recording::render(&yard, Recording::SMALL_CAMERA, part, 30.0);
        let folder = room.path().join("r").join(name);
        recording.write(&folder, Encoding::Png).expect("there is room");
        let run = ["run", arg(&folder), "--out", arg(out), "--quiet", &format!("--fleet={name}")];
        let kept = Process::start(&[&run[..], &["--connect", "tcp/127.0.0.1:9"]].concat());
        assert!(kept.succeeded());
    }
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "5"];
    let there = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let at = address(&station);
    let published =
        folders.each_ref().map(|folder| Process::start(&["fleet", arg(folder), "--connect", &at]));
    messages::assert_no_message_is_too_early(&station);
    assert!(published.into_iter().all(Process::succeeded) && there.succeeded());
    let found = status(&station, |_| true);
    let agents = found["found"]["agents"].as_array().expect("agents");
    assert!(agents.len() == 5 && agents.iter().all(|agent| agent["root"] == agents[0]["root"]), "{found:#}");
    assert_eq!(found["found"]["meetings"].as_array().map(Vec::len), Some(10), "{found:#}");
    assert_is_the_merge_of_the_files(&station, folders.each_ref().map(PathBuf::as_path), names);
}

#[test]
fn two_agents_pair_without_a_station() {
    let room = tempfile::tempdir().expect("a folder");
    let [a, b] = ["a", "b"].map(|name| room.path().join(name));
    let one = run("a", &a, &["--listen", "tcp/127.0.0.1:0"]);
    let at = address(&a);
    let other = run("b", &b, &["--connect", &at]);
    assert!(one.succeeded() && other.succeeded());
    // Who ends last has both maps.
    let common = [&a, &b].map(|out| out.join("common/merge.json")).into_iter().find(|path| path.is_file());
    let numbers: Value =
        serde_json::from_slice(&bytes(&common.expect("one of them has the common map"))).unwrap();
    assert_eq!(numbers["encounters"][0]["closure"]["travel"], "same", "{numbers:#}");
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let room = tempfile::tempdir().expect("a folder");
    let out = room.path().join("out");
    let recording = recording("a");
    let station = ["station", "--out", arg(&out)];
    let run = ["run", arg(&recording), "--out", arg(&out), "--fleet"];
    let nowhere = out.join("no-keys");
    let cases: [(&[&str], &[&str], &str); 8] = [
        (&station, &[], "nobody could reach"),
        (&station, &["--listen", "tcp/0.0.0.0:0"], "not of this machine alone"),
        (&station, &["--listen", "tls/0.0.0.0:0"], "needs keys"),
        (&station, &["--listen", "tls/0.0.0.0:0", "--keys", arg(&nowhere)], "agent.crt"),
        (&run, &["--connect", "tls/station.invalid:1"], "needs keys"),
        (&["keys", "agent", "x", "--authority", arg(&out), "--out", arg(&nowhere)], &[], "no authority"),
        (&run, &[], "nobody could be reached"),
        (&["fleet", arg(&out)], &[], "fleet.json"),
    ];
    for (args, more, words) in cases {
        let output = loopbox(&[args, more].concat());
        let printed = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{printed}");
        assert!(printed.contains(words) && printed.contains("hint"), "{printed}");
        assert!(!out.join("map.mcap").exists());
    }
}
