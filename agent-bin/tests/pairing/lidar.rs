//! Agents with LiDARs at a station, beside one with a camera, and scans that are none.

use super::common::{arg, loopbox, stderr, stdout};
use super::{Process, address, bytes, collected, run, status};
use fleet::hash::ObjectHash;
use fleet::manifest::{Kind, Manifest, PageRef, page_from_bytes, page_to_bytes};
use fleet::node::{Notice, Quota};
use fleet::publishing::{Publication, Publisher};
use fleet::service::{Service, ServiceOptions};
use fleet::wire::{MapVersion, Role};
use geometry::limits::MAX_SCAN_POINTS;
use geometry::{GrayImage, Sim3};
use loopbox_tests::lidar::{HALL, walk, write_recording};
use map::parts::{depth_to_bytes, scan_to_bytes};
use map::{AgentInfo, Identity, Keyframe, KeyframeId, Map, Scan, Sensor, Uuid};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Two ways along an aisle that share their middle, the second back again.
const PATHS: [(&str, [[f64; 2]; 2]); 2] =
    [("x", [[-10.0, 4.5], [1.0, 4.5]]), ("y", [[6.0, 5.0], [-5.0, 5.5]])];

fn write_scans(room: &Path) {
    for (name, corners) in PATHS {
        let (pose, duration) = walk(&corners);
        write_recording(&room.join(name), &HALL, pose, duration).expect("there is room");
    }
}

#[test]
fn a_station_merges_lidars_as_their_files_next_to_a_camera() {
    let room = tempfile::tempdir().expect("a folder");
    let at = |name: &str| room.path().join(name);
    write_scans(room.path());
    let [station, camera, one, other] = ["station", "camera", "one", "other"].map(at);
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "3"];
    let there = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let dial = address(&station);
    let agents = [("x", &one), ("y", &other)].map(|(name, out)| {
        let recording = at(name);
        let words = ["run", arg(&recording), "--out", arg(out), "--quiet", &format!("--fleet={name}")];
        Process::start(&[&words[..], &["--connect", &dial]].concat())
    });
    let with_fleet = run("a", &camera, &["--connect", &dial]);
    assert!(agents.into_iter().chain([with_fleet]).all(Process::succeeded));
    assert!(there.succeeded());

    // A run alone has the same map: nobody waits for the network.
    let output = loopbox(&["run", arg(&at("x")), "--out", arg(&at("alone")), "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    for (name, own) in [("x", &one), ("y", &other), ("x", &at("alone")), ("a", &camera)] {
        let there = bytes(&collected(&station, name).join("map.mcap"));
        assert!(there == bytes(&own.join("map.mcap")), "{name}'s map is another one at the station");
    }

    // What came of it is what a merge of the files makes.
    let common = station.join("lidar");
    let json =
        |folder: &Path| serde_json::from_slice::<Value>(&bytes(&folder.join("merge.json"))).expect("numbers");
    let found = json(&common);
    let inputs: Vec<&str> = found["inputs"]
        .as_array()
        .expect("inputs")
        .iter()
        .filter_map(|input| input["path"].as_str())
        .collect();
    assert_eq!(inputs.len(), 2, "{found:#}");
    let again = at("again");
    let output = loopbox(&[&["merge"], &inputs[..], &["--out", arg(&again), "--quiet"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    for name in ["map.mcap", "cloud.ply", "trajectory-x.txt", "trajectory-y.txt"] {
        assert!(bytes(&again.join(name)) == bytes(&common.join(name)), "{name} is another one");
    }
    let merged = json(&again);
    for part in ["best", "decision", "reason"] {
        assert_eq!(merged["encounters"][0][part], found["encounters"][0][part]);
    }
    assert_eq!(merged["inputs"], found["inputs"]);

    // All of them are told so.
    let reported = status(&station, |_| true);
    assert_eq!(reported["trouble"], Value::Array(Vec::new()), "{reported:#}");
    assert_eq!(
        reported["found"]["meetings"].as_array().map(Vec::len),
        Some(1),
        "cameras do not meet LiDARs: {reported:#}"
    );
    let place = |agent: &Value| {
        let numbers = agent["root_from_agent"].as_array().expect("numbers").iter();
        numbers.map(|number| number.as_f64().expect("a number")).collect::<Vec<_>>()
    };
    for input in merged["inputs"].as_array().expect("inputs") {
        let agents = reported["found"]["agents"].as_array().expect("agents");
        let agent = agents.iter().find(|agent| agent["name"] == input["name"]).expect("it was found");
        let expected = input["world_from_map"].as_array().expect("numbers").iter();
        let expected = expected.map(|number| number.as_f64().expect("a number")).chain([1.0]);
        assert_eq!(place(agent), expected.collect::<Vec<_>>());
    }
    let printed = stdout(&loopbox(&["fleet", arg(&station)]));
    assert!(
        printed.contains("keyframes of a LiDAR, all here, run over") && printed.contains(": accepted"),
        "{printed}"
    );
    assert_eq!(printed.matches("of a LiDAR").count(), 2, "{printed}");

    // Without a station they find the same.
    let _listens = Process::start(&["fleet", arg(&one), "--listen", "tcp/127.0.0.1:0"]);
    let output = loopbox(&["fleet", arg(&other), "--connect", &address(&one)]);
    assert!(output.status.success(), "{}", stderr(&output));
    status(&one, |status| status["found"]["meetings"][0]["verdict"] == "accepted");
    let between = json(&one.join("common/lidar"));
    assert_eq!(between["encounters"][0]["best"], found["encounters"][0]["best"]);

    // It can be taken apart, by agents; not by the merge of two of them.
    let apart = at("apart");
    let output = loopbox(&["unmerge", arg(&common), "--out", arg(&apart)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(bytes(&apart.join("y/map.mcap")) == bytes(&other.join("map.mcap")), "y's map is as it was");
    let between = ["--between", "x", "y"];
    let output = loopbox(&[&["unmerge", arg(&common), "--out", arg(&at("no"))], &between[..]].concat());
    assert!(stderr(&output).contains("--between is for maps of cameras"), "{}", stderr(&output));
    let output = loopbox(&["unmerge", arg(&station), "--out", arg(&at("no"))]);
    assert!(
        stderr(&output).contains(&format!("that of the LiDARs is in {}", common.display())),
        "{}",
        stderr(&output)
    );
}

/// A small map of a LiDAR.
fn scans(number: u128) -> Map {
    let identity = Some(Identity { uuid: Uuid::from_u128(number), epoch: 0 });
    let mut map = Map::of(AgentInfo { identity, ..AgentInfo::new("hostile", Sensor::Lidar) });
    for id in (0..3).map(KeyframeId) {
        let image = Arc::new(GrayImage::filled(0, 0, 0));
        let points = (0..500).map(|k| [k as f32 * 0.1, id.0 as f32, 1.0]);
        let scan = Some(Arc::new(Scan::new(points)));
        let keyframe = Keyframe::of_image(id, id.0.into(), 0, Sim3::identity(), image);
        map.keyframes.insert(id, Keyframe { scan, ..keyframe });
    }
    map
}

/// A map told with `bytes` in the place of the first object of a kind.
fn published_with(map: &Map, kind: Kind, bytes: Vec<u8>) -> Publication {
    let agent = map.agents.values().next().and_then(|about| about.identity).expect("it has one");
    let mut reported = Publisher::new(agent, 1).publish(map, true).expect("a map").expect("it is new");
    let of = |hash: ObjectHash| {
        reported.objects.iter().find(|(name, _)| *name == hash).expect("it is told").1.to_vec()
    };
    let mut manifest = Manifest::from_bytes(&of(reported.version.hash)).expect("a list");
    // Keyframes come on pages of their own, after all else.
    let last = manifest.pages.last_mut().expect("it has pages");
    let mut entries = page_from_bytes(&of(last.hash)).expect("a page").to_vec();
    let entry = entries.iter_mut().find(|entry| entry.kind == kind).expect("there is one");
    (entry.hash, entry.size) = (ObjectHash::of(&bytes), bytes.len() as u32);
    let page = page_to_bytes(&entries);
    *last = PageRef { size: page.len() as u32, hash: ObjectHash::of(&page) };
    let list = manifest.to_bytes();
    *reported.pages.last_mut().expect("it has pages") = entries.into();
    reported.manifest = manifest;
    reported.version =
        MapVersion { size: list.len() as u32, hash: ObjectHash::of(&list), ..reported.version };
    for bytes in [bytes, page, list] {
        reported.objects.push((ObjectHash::of(&bytes), bytes.into()));
    }
    reported
}

/// A peer at work, that hands on what it hears of trouble.
fn peer(folder: &Path, station: &str) -> (Service, Receiver<String>) {
    let (received, troubles) = channel();
    let options = ServiceOptions {
        folder: folder.to_owned(),
        name: "peer".into(),
        role: Role::Agent,
        listen: None,
        dial: vec![station.parse().expect("an address")],
        quota: Quota::default(),
        waits: true,
        keys: None,
    };
    let service = Service::start(options, move |notice| {
        if let Notice::Trouble(text) = notice {
            let _ = received.send(text);
        }
    });
    (service.expect("it starts"), troubles)
}

#[test]
fn scans_that_are_none_are_refused_with_the_reason_and_others_are_collected() {
    let room = tempfile::tempdir().expect("a folder");
    let station = room.path().join("station");
    let listen = ["--listen", "tcp/127.0.0.1:0", "--agents", "1"];
    let there = Process::start(&[&["station", "--quiet", "--out", arg(&station)], &listen[..]].concat());
    let dial = address(&station);
    let map = scans(1);
    let keyframe = &map.keyframes[&KeyframeId(0)];
    let scan = scan_to_bytes(keyframe.id, keyframe.scan.as_ref().expect("it has one"));
    let time = depth_to_bytes(keyframe);
    // Steps of one byte each, as many and one more than there may be points.
    let count = MAX_SCAN_POINTS + 1;
    let mut many = vec![0x12];
    many.extend((0..4).map(|k| (count >> (7 * k)) as u8 & 0x7f | if k < 3 { 0x80 } else { 0 }));
    many.extend(std::iter::repeat_n(1, count));
    let nan = depth_to_bytes(&Keyframe { timestamp: f64::NAN, ..keyframe.clone() });
    let cases = [
        (Kind::Scan, scan[..scan.len() - 1].to_vec(), "a scan cannot be read"),
        (Kind::Scan, many, "more than the 2000000 that one may have"),
        (Kind::Scan, vec![0x12, 2, 5, 0], "a point lies outside of its grid"),
        (Kind::Depth, nan, "its time stamp is NaN"),
        (Kind::Depth, time[..time.len() - 1].to_vec(), "a keyframe cannot be read"),
    ];
    for (number, (kind, bytes, words)) in (1..).zip(cases) {
        let folder = room.path().join(format!("hostile-{number}"));
        let (peer, troubles) = peer(&folder, &dial);
        peer.publish(published_with(&scans(number), kind, bytes));
        let printed = troubles.recv_timeout(Duration::from_secs(60)).expect("it is refused");
        assert!(printed.contains(words), "{words}: {printed}");
        let is_reported = |text: &Value| text.as_str().is_some_and(|text| text.contains(words));
        status(&station, |status| {
            status["trouble"].as_array().is_some_and(|trouble| trouble.iter().any(is_reported))
        });
    }
    // The station goes on.
    let good = scans(99);
    let agent = good.agents.values().next().and_then(|about| about.identity).expect("it has one");
    let reported = Publisher::new(agent, 1).publish(&good, true).expect("a map").expect("it is new");
    let (peer, _troubles) = peer(&room.path().join("good"), &dial);
    peer.publish(reported);
    assert!(there.succeeded());
    let own = fs::read_dir(station.join("agents")).expect("maps were collected").flatten().count();
    assert_eq!(own, 1);
}
