//! LiDAR agents through the program: runs, merges and what can be done with their maps.

#[path = "../common/mod.rs"]
mod common;
mod manifest;

use common::{arg, loopbox, stderr, stdout, write};
use loopbox_tests::lidar::{HALL, SIXTEEN, Sensor, walk, write_recording, write_recording_of};
use loopbox_tests::lidar_open::{Walls, tunnel};
use loopbox_tests::lidar_paths::{Carried, Carrier};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Two ways through a hall, the second against the first and from beyond its end, as folders of scans.
struct Hall {
    folder: tempfile::TempDir,
}

const PATHS: [(&str, [[f64; 2]; 3]); 2] =
    [("a", [[-11.0, 4.5], [2.0, 4.5], [4.0, 6.5]]), ("b", [[9.0, 5.0], [2.0, 4.5], [-6.0, 5.5]])];

impl Hall {
    fn new() -> Self {
        let hall = Self { folder: tempfile::tempdir().unwrap() };
        for (name, corners) in PATHS {
            let (pose, duration) = walk(&corners);
            write_recording(&hall.at(name), &HALL, pose, duration).unwrap();
        }
        hall
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs the program with words of which those that begin with `@` are files of this folder.
    #[track_caller]
    fn run(&self, code: i32, words: &str) -> (String, String) {
        let paths: Vec<String> = words
            .split_whitespace()
            .map(|word| word.strip_prefix('@').map_or(word.to_owned(), |name| arg(&self.at(name)).to_owned()))
            .collect();
        let output = loopbox(&paths.iter().map(String::as_str).collect::<Vec<_>>());
        let printed = (stdout(&output), stderr(&output));
        assert_eq!(output.status.code(), Some(code), "{words}\n{}\n{}", printed.0, printed.1);
        printed
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&fs::read(self.at(name)).unwrap()).unwrap()
    }
}

#[test]
fn the_numbers_of_scans_are_one_json_object_on_standard_output() {
    let hall = Hall::new();
    let (printed, _) = hall.run(0, "run @a --end 2 --json --out @out");
    let printed: Value = serde_json::from_str(&printed).expect("one object");
    let mut record = hall.json("out/run.json");
    let fields = record.as_object_mut().unwrap();
    assert!(fields.remove("rows").is_some());
    fields.insert("out".into(), arg(&hall.at("out")).into());
    assert_eq!(printed, record);
}

/// The root mean square error that `eval --json` tells.
fn ate(printed: &str) -> f64 {
    serde_json::from_str::<Value>(printed).unwrap()["ate"]["rmse"].as_f64().unwrap()
}

#[test]
fn scans_become_maps_that_are_measured_viewed_exported_and_merged() {
    let hall = Hall::new();
    let (printed, _) = hall.run(0, "info @a");
    assert!(printed.contains("folder of KITTI scans") && printed.contains("rings        16"), "{printed}");
    for name in ["a", "b"] {
        let (printed, _) = hall.run(0, &format!("run @{name} --out @out/{name}"));
        assert!(printed.contains("have a pose, 0 skipped"), "{printed}");
        let (printed, _) =
            hall.run(0, &format!("eval @out/{name} --gt @{name}/groundtruth.txt --json --align se3"));
        assert!(ate(&printed) < 0.03, "{name}: {printed}");
        let (metric, _) = hall.run(0, &format!("eval @out/{name} --gt @{name}/groundtruth.txt --json"));
        assert_eq!(ate(&metric), ate(&printed), "a LiDAR's map is metric: scale is not adjusted");
        let record = hall.json(&format!("out/{name}/run.json"));
        assert_eq!((&record["sensor"], &record["params"]["method"]), (&"lidar".into(), &"planes".into()));
        assert_eq!(record["scans"]["tracked"], record["scans"]["offered"]);
        let page = fs::read_to_string(hall.at(&format!("out/{name}/report.html"))).unwrap();
        assert!(page.contains("Scan Context distances") && !page.contains("{{"), "the page is filled");
    }
    let (printed, _) = hall.run(0, "info @out/a");
    assert!(printed.contains("sensor       LiDAR") && printed.contains("scans "), "{printed}");
    let (printed, _) = hall.run(0, "export @out/a --ply @a.ply --pcd @a.pcd --tum @a.txt --mcap @a.mcap");
    assert_eq!(printed.lines().count(), 4, "{printed}");
    assert_eq!(fs::read(hall.at("a.mcap")).unwrap(), fs::read(hall.at("out/a/map.mcap")).unwrap());
    let cloud = fs::read(hall.at("a.ply")).unwrap();
    assert_eq!(cloud, fs::read(hall.at("out/a/cloud.ply")).unwrap());
    assert!(String::from_utf8_lossy(&cloud[..300]).contains("lengths in metres"));

    let (printed, _) = hall.run(0, "merge @out/a @out/b --out @out/ab");
    assert!(printed.contains("a + b: accepted") && printed.contains("pieces agree"), "{printed}");
    let record = hall.json("out/ab/merge.json");
    assert_eq!(record["encounters"][0]["decision"], "accepted");
    let (printed, _) = hall.run(
        0,
        "eval @out/ab/trajectory-a.txt @out/ab/trajectory-b.txt --gt @a/groundtruth.txt --gt @b/groundtruth.txt --json",
    );
    let found: Value = serde_json::from_str(&printed).unwrap();
    for agent in found["agents"].as_array().unwrap() {
        assert!(agent["ate"]["rmse"].as_f64().unwrap() < 0.05, "{printed}");
    }
    let (printed, _) = hall.run(0, "verdict @out/b @out/a --verdicts @verdicts");
    assert!(printed.contains("b + a: accepted"), "{printed}");
    hall.run(0, "verdict @out/a @out/b --verdicts @turned");
    let kept = |name: &str| {
        let file = fs::read_dir(hall.at(name)).unwrap().next().unwrap().unwrap().path();
        (file.file_name().unwrap().to_owned(), fs::read(file).unwrap())
    };
    assert!(kept("verdicts") == kept("turned"), "a verdict depends on the order of its maps");
    hall.run(0, "merge @out/a @out/b --out @out/kept --verdicts @verdicts");
    let map = |name: &str| fs::read(hall.at(&format!("out/{name}/map.mcap"))).unwrap();
    assert!(map("kept") == map("ab"), "a verdict that is kept makes another map");
    assert_eq!(fs::read_dir(hall.at("verdicts")).unwrap().count(), 1);
    let (printed, _) = hall.run(0, "propose @out/a @out/b");
    assert_eq!(printed.lines().count(), 1, "{printed}");
    let (printed, _) = hall.run(0, "merge @out/a @out/b --out @out/emr --method emr");
    assert!(printed.contains("a + b: accepted"), "the paper's chain finds the same: {printed}");
    let (_, reported) = hall.run(1, "merge @out/a @out/b --out @x --method loop-box");
    assert!(reported.contains("--method loop-box is for maps of cameras"), "{reported}");
    hall.run(0, "unmerge @out/ab --out @out/apart");
    for name in ["a", "b"] {
        let own = fs::read(hall.at(&format!("out/apart/{name}/map.mcap"))).unwrap();
        assert_eq!(own, fs::read(hall.at(&format!("out/{name}/map.mcap"))).unwrap(), "{name} as it was");
    }
    let (printed, _) = hall.run(0, "info @out/ab");
    assert!(printed.contains("agents       2") && printed.contains("1 merge"), "{printed}");
    // The same again gives the same bytes, on one core too.
    hall.run(0, "run @a --out @again --threads 1 --quiet");
    assert_eq!(fs::read(hall.at("again/map.mcap")).unwrap(), fs::read(hall.at("out/a/map.mcap")).unwrap());
}

/// Between two halls a tunnel, of which a sensor that reaches 20 m sees neither end for a while.
#[test]
fn a_tunnel_is_reported_as_guessed_and_strict_does_not_take_it() {
    let hall = Hall::new();
    let (boxes, corners) = tunnel(3, 60.0, Walls::Smooth, 10.0);
    let path = Carried::along(&corners, 5.0, Carrier::Wheels);
    let short = Sensor { reach: 20.0, ..SIXTEEN };
    write_recording_of(&short, &hall.at("tunnel"), &boxes, |t| path.at(t), path.duration()).unwrap();
    let (printed, warned) = hall.run(4, "run @tunnel --out @out/tunnel --strict");
    assert!(
        printed.contains("guessed   ") && warned.contains("m of the path are guessed and doubtful"),
        "{printed}{warned}"
    );
    assert!(
        warned.contains("which --strict does not take") && hall.at("out/tunnel/map.mcap").exists(),
        "{warned}"
    );
    let record = hall.json("out/tunnel/run.json");
    // Over 20 m neither end is within reach, and over some more only a few points of it.
    let metres = record["map"]["guessed_m"].as_f64().unwrap();
    assert!((20.0..34.0).contains(&metres), "{metres}");
    let stretch = &record["guessed"][0];
    assert!(stretch["from_s"].as_f64() < stretch["to_s"].as_f64(), "{stretch}");
    assert!(stretch["deviation_m"].as_f64().unwrap() > 0.5, "{stretch}");
    let page = fs::read_to_string(hall.at("out/tunnel/report.html")).unwrap();
    assert!(page.contains("guessed, doubtful"), "the page says it");
    // Where all is seen nothing is guessed.
    let (printed, warned) = hall.run(0, "run @a --out @out/a --strict");
    assert!(!printed.contains("guessed") && !warned.contains("guessed"), "{printed}{warned}");
}

#[test]
fn maps_are_built_on_given_poses_and_by_other_odometries() {
    let hall = Hall::new();
    let (printed, _) = hall.run(0, "run @a --out @out/given --poses @a/groundtruth.txt --end 3");
    assert!(printed.contains("30 of 30") || printed.contains("31 of 31"), "{printed}");
    let (printed, _) = hall.run(0, "eval @out/given --gt @a/groundtruth.txt --align none --json");
    assert!(ate(&printed) < 0.005, "{printed}");
    hall.run(0, "run @a --out @out/floam --odometry floam --quiet --end 4");
    assert_eq!(hall.json("out/floam/run.json")["params"]["method"], "floam");
    let (params, _) = hall.run(0, "params --lidar");
    write(hall.at("lidar.toml"), params.replace("distance = 1.0", "distance = 0.5"));
    hall.run(0, "run @a --out @out/dense --params @lidar.toml --quiet --end 4");
    let keyframes =
        |name: &str| hall.json(&format!("out/{name}/run.json"))["map"]["keyframes"].as_u64().unwrap();
    assert!(keyframes("dense") > keyframes("floam"), "{} {}", keyframes("dense"), keyframes("floam"));
}

#[test]
fn bad_scans_are_skipped_with_the_reason_and_what_does_not_fit_is_refused() {
    let hall = Hall::new();
    let scan = |index: u32| hall.at(&format!("a/velodyne/{index:06}.bin"));
    write(scan(3), b"");
    write(scan(5), &fs::read(scan(6)).unwrap()[..1000]);
    write(scan(8), vec![0xff; 16 * 14_400]);
    let (printed, reported) = hall.run(0, "run @a --out @out/a --end 4");
    assert!(printed.contains("3 skipped") && printed.contains("too few points"), "{printed}");
    assert!(reported.contains("000005.bin") && reported.contains("cut off"), "{reported}");
    let record = hall.json("out/a/run.json");
    // An empty scan does not have the points that the files beside it speak of.
    assert_eq!(record["scans"]["skipped"]["damaged"], 2);
    assert_eq!(record["scans"]["skipped"]["too_few_points"], 1);
    let (_, reported) = hall.run(2, "run @a --out @x --calib @nothing.yaml");
    assert!(reported.contains("--calib is for images"), "{reported}");
    for option in ["--fov 60", "--max-width 640", "--max-variance 0.1", "--features later", "--duration 5"] {
        let (_, reported) = hall.run(2, &format!("run @a --out @x {option}"));
        let name = option.split(' ').next().unwrap();
        assert!(reported.contains(&format!("{name} is for images")), "{reported}");
    }
    if cfg!(feature = "view") {
        let (_, reported) = hall.run(2, "run @a --out @x --view");
        assert!(reported.contains("--view is for images"), "{reported}");
    }
    let (_, reported) = hall.run(1, "run @a --out @x --times @none.txt");
    assert!(reported.contains("none.txt: cannot be read"), "{reported}");
    assert!(!hall.at("x").exists());
    let empty = |path: &Path| fs::create_dir_all(path).unwrap();
    empty(&hall.at("empty"));
    let (_, reported) = hall.run(1, "run @empty --out @x");
    assert!(reported.contains("no recording here"), "{reported}");
    // Functions for cameras say what they need.
    let (_, reported) = hall.run(1, "merge @out/a @out/a --out @x");
    assert!(reported.contains("the same map twice"), "{reported}");
}

/// A camera's map beside a LiDAR's: nothing is written, and it is said why.
#[test]
fn maps_of_different_sensors_are_not_merged() {
    let hall = Hall::new();
    hall.run(0, "run @a --out @out/a --quiet --end 2");
    let camera = geometry::Pinhole { width: 8, height: 6, fx: 5.0, fy: 5.0, cx: 3.5, cy: 2.5 };
    map::save_map(hall.at("camera.mcap"), &map::Map::new(camera)).unwrap();
    let (_, reported) = hall.run(1, "merge @out/a @camera.mcap --out @x");
    assert!(reported.contains("has a camera; this needs maps of agents with a LiDAR"), "{reported}");
    assert!(!hall.at("x/map.mcap").exists());
}

/// A scan of a folder as `sensor_msgs/PointCloud2`, after CDR's header or not.
fn point_cloud2(folder: &Path, index: u32, stamp: f64, cdr: bool) -> Vec<u8> {
    let read = |name: String| fs::read(folder.join(name)).unwrap();
    let points = read(format!("velodyne/{index:06}.bin"));
    let times = read(format!("times/{index:06}.f32"));
    let rings = read(format!("rings/{index:06}.u8"));
    let mut out: Vec<u8> = if cdr { vec![0, 1, 0, 0] } else { Vec::new() };
    let put = |out: &mut Vec<u8>, raw: &[u8]| {
        if cdr {
            out.resize((out.len() - 4).next_multiple_of(raw.len()) + 4, 0);
        }
        out.extend(raw);
    };
    let number = |out: &mut Vec<u8>, value: u32| put(out, &value.to_le_bytes());
    let string = |out: &mut Vec<u8>, text: &str| {
        let end: &[u8] = if cdr { &[0] } else { &[] };
        number(out, (text.len() + end.len()) as u32);
        out.extend(text.bytes().chain(end.iter().copied()));
    };
    if !cdr {
        number(&mut out, index);
    }
    number(&mut out, stamp as u32);
    number(&mut out, (stamp.fract() * 1e9).round() as u32);
    string(&mut out, "velodyne");
    number(&mut out, 1);
    number(&mut out, rings.len() as u32);
    let fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("time", 12, 7), ("ring", 16, 4)];
    number(&mut out, fields.len() as u32);
    for (name, offset, kind) in fields {
        string(&mut out, name);
        number(&mut out, offset);
        put(&mut out, &[kind]);
        number(&mut out, 1);
    }
    put(&mut out, &[0]);
    number(&mut out, 18);
    number(&mut out, 18 * rings.len() as u32);
    number(&mut out, 18 * rings.len() as u32);
    for (i, ring) in rings.iter().enumerate() {
        out.extend(&points[16 * i..16 * i + 12]);
        out.extend(&times[4 * i..4 * i + 4]);
        out.extend([*ring, 0]);
    }
    put(&mut out, &[1]);
    out
}

#[test]
fn scans_in_mcap_files_and_bags_give_the_map_of_their_folder() {
    let hall = Hall::new();
    let folder = hall.at("a");
    let stamps: Vec<f64> = (0..30).map(|index| 0.1 * f64::from(index)).collect();
    let cloud = |(index, stamp): (u32, &f64), cdr| point_cloud2(&folder, index, *stamp, cdr);
    let nanoseconds = |stamp: &f64| (stamp * 1e9).round() as u64;

    let mut mcap = mcap::Writer::new(fs::File::create(hall.at("a.mcap")).unwrap()).unwrap();
    let schema = mcap.add_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"").unwrap();
    let channel = mcap.add_channel(schema, "/points", "cdr", &Default::default()).unwrap();
    for scan in (0..).zip(&stamps) {
        let log_time = nanoseconds(scan.1);
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time,
            publish_time: log_time,
        };
        mcap.write_to_known_channel(&header, &cloud(scan, true)).unwrap();
    }
    mcap.finish().unwrap();

    let messages: Vec<_> =
        (0..).zip(&stamps).map(|scan| (0, nanoseconds(scan.1) as i64, cloud(scan, true))).collect();
    common::write_db3(&hall.at("a.db3"), &[("/points", "sensor_msgs/msg/PointCloud2")], &messages);

    let kind = sources::bag::MessageType { name: "sensor_msgs/PointCloud2", md5sum: "", definition: "" };
    let mut bag = sources::bag::BagWriter::create(fs::File::create(hall.at("a.bag")).unwrap()).unwrap();
    let connection = bag.connect("/points", kind);
    for scan in (0..).zip(&stamps) {
        bag.message(connection, nanoseconds(scan.1), &cloud(scan, false)).unwrap();
    }
    bag.finish().unwrap();

    let (printed, _) = hall.run(0, "info @a.mcap");
    assert!(
        printed.contains("MCAP recording of scans") && printed.contains("point times  known"),
        "{printed}"
    );
    let (printed, _) = hall.run(0, "info @a.bag --json");
    assert!(printed.contains("ROS 1 bag of scans"), "{printed}");
    hall.run(0, "run @a --out @out/folder --end 2.95 --quiet");
    let mut kinds = vec!["mcap", "bag"];
    if cfg!(feature = "sqlite") {
        kinds.push("db3");
        let (printed, _) = hall.run(0, "info @a.db3");
        assert!(
            printed.contains("ROS 2 bag of scans") && printed.contains("point times  known"),
            "{printed}"
        );
    }
    for kind in kinds {
        hall.run(0, &format!("run @a.{kind} --out @out/{kind} --quiet"));
        let trajectory = |name: &str| -> Vec<f64> {
            let text = fs::read_to_string(hall.at(&format!("out/{name}/trajectory.txt"))).unwrap();
            let numbers = text.lines().skip(1).flat_map(|line| line.split(' '));
            numbers.map(|number| number.parse().unwrap()).collect()
        };
        let (found, expected) = (trajectory(kind), trajectory("folder"));
        assert_eq!(found.len(), expected.len());
        // Stamps are nanoseconds there.
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{kind}");
    }
    // Cut off: what is whole is used, and it is said.
    let bytes = fs::read(hall.at("a.bag")).unwrap();
    write(hall.at("cut.bag"), &bytes[..bytes.len() * 2 / 3]);
    let (printed, reported) = hall.run(0, "run @cut.bag --out @out/cut");
    assert!(reported.contains("ends early") && printed.contains("have a pose"), "{printed}\n{reported}");
}
