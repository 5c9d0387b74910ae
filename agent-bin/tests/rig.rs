//! A camera and a LiDAR on one robot, in a hall that is rendered for the one and ray-cast for the other.

mod common;

use common::{arg, loopbox, stderr, stdout, write};
use geometry::Se3;
use loopbox_tests::lidar::{HALL, walk, write_recording};
use loopbox_tests::pages::{embedded, opened};
use loopbox_tests::{Encoding, Recording, World, world_from_hall};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Along the northern row of boxes, which the camera looks at from the robot's left side.
const PATH: [[f64; 2]; 3] = [[-11.0, 4.5], [-3.0, 4.5], [4.0, 5.5]];
/// `lidar_from_camera`: 30 cm ahead of the LiDAR, 20 cm to its left and 20 cm below.
const EXTRINSIC: [f64; 7] =
    [0.3, 0.2, -0.2, -std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2];
/// Images a second.
const RATE: f64 = 30.0;

/// Runs the program; what it said.
#[track_caller]
fn run(code: i32, args: &[&str]) -> String {
    let output = loopbox(args);
    let printed = stdout(&output) + &stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}\n{printed}");
    printed
}

/// Recordings `camera` and `lidar` of one drive, and their truth in the hall's axes.
fn record(folder: &Path) {
    let (pose, duration) = walk(&PATH);
    write_recording(&folder.join("lidar"), &HALL, &pose, duration).unwrap();
    let camera = |i: usize| pose(i as f64 / RATE) * Se3::from_tum(EXTRINSIC);
    let count = (duration * RATE) as usize;
    let path: Vec<Se3> = (0..count).map(|i| world_from_hall() * camera(i)).collect();
    let recording = Recording::render(&World::hall(3), Recording::SMALL_CAMERA, &path, RATE);
    recording.write(&folder.join("camera"), Encoding::Png).unwrap();
    let line = |i: usize| {
        let numbers = camera(i).to_tum().map(|number| format!("{number:.9}")).join(" ");
        format!("{:.6} {numbers}\n", i as f64 / RATE)
    };
    write(folder.join("camera/truth.txt"), (0..count).map(line).collect::<String>());
}

/// A number of JSON that was printed.
fn number(printed: &str, path: &str) -> f64 {
    let json: Value = serde_json::from_str(printed).unwrap_or_else(|_| panic!("{printed}"));
    json.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path} in {json:#}"))
}

#[test]
fn a_cameras_map_gets_its_scale_from_the_lidar_on_its_rig() {
    let room = tempfile::tempdir().unwrap();
    record(room.path());
    let at = |name: &str| -> PathBuf { room.path().join(name) };
    for name in ["camera", "lidar"] {
        run(0, &["run", arg(&at(name)), "--out", arg(&at(&format!("out/{name}"))), "--quiet"]);
    }
    let (camera, lidar) = (at("out/camera"), at("out/lidar"));
    let pose = EXTRINSIC.map(|number| number.to_string());
    let extrinsic = format!("--extrinsic={}", pose.join(","));
    write(at("extrinsic.txt"), pose.join(" "));

    // The unit alone is right where nothing is scaled any more.
    let track = at("metres.txt");
    let place = ["export", arg(&camera), "--lidar", arg(&lidar), "--tum", arg(&track), "--mcap"];
    run(0, &[&place[..], &[arg(&at("metres.mcap")), &extrinsic]].concat());
    let truth = at("camera/truth.txt");
    let printed = run(0, &["eval", arg(&track), "--gt", arg(&truth), "--align", "se3", "--json"]);
    println!("export: ATE {} m", number(&printed, "/ate/rmse"));
    assert!(number(&printed, "/ate/rmse") < 0.05, "{printed}");
    let file = ["--extrinsic", arg(&at("extrinsic.txt"))].map(str::to_owned);
    let again = at("again.mcap");
    run(0, &[&place[..], &[arg(&again), &file[0], &file[1]]].concat());
    assert!(fs::read(&again).unwrap() == fs::read(at("metres.mcap")).unwrap(), "a file says the same pose");

    // Both agents in one map, where they truly are to each other.
    let both = at("both");
    let merge = ["merge", arg(&camera), arg(&lidar), "--out", arg(&both), "--quiet"];
    let printed = run(0, &[&merge[..], &[&extrinsic, "--json"]].concat());
    println!("merge: {printed}");
    assert!(number(&printed, "/scale_doubt") < 0.01 && number(&printed, "/suppressed") == 0.0, "{printed}");
    let tracks = ["lidar", "camera"].map(|name| both.join(format!("trajectory-{name}.txt")));
    let truths = [at("lidar/groundtruth.txt"), truth];
    let eval = ["eval", arg(&tracks[0]), arg(&tracks[1]), "--gt", arg(&truths[0]), arg(&truths[1])];
    let printed = run(0, &[&eval[..], &["--align", "se3", "--json"]].concat());
    println!("eval: {printed}");
    assert!(number(&printed, "/agents/0/ate/rmse") < 0.03, "{printed}");
    assert!(number(&printed, "/agents/1/ate/rmse") < 0.05, "{printed}");
    let common = map::load_map(both.join("map.mcap")).unwrap().map;
    assert!(common.is_metric() && common.sensor().is_none());
    for keyframe in common.keyframes.values().filter(|keyframe| keyframe.scan.is_some()) {
        assert_eq!(keyframe.world_from_keyframe.scale, 1.0, "a LiDAR's keyframes stay in metres");
    }
    let page = fs::read_to_string(both.join("report.html")).unwrap();
    let data = embedded(&page);
    let sees = |agent: usize| data["scene"]["agents"][agent]["camera"].is_object();
    assert!(!sees(0) && sees(1), "the LiDAR comes first");
    assert_eq!(data["scene"]["keyframes"]["count"], common.keyframes.len());
    let points = |keyframe: &map::Keyframe| {
        keyframe.semi_dense.len() + keyframe.scan.as_ref().map_or(0, |scan| scan.len())
    };
    let points: usize = common.keyframes.values().map(points).sum();
    assert_eq!(data["cloud"]["total"], points, "scans and depths");
    assert!(page.contains("a unit of the camera's map"), "{page:.300}");
    if let Some(dom) = opened(&page) {
        let works = |how| dom.contains(&format!(r#"data-report="{how}""#));
        assert!(works("complete") || works("without-3d"), "the page's scripts did not run to their end");
    }
    run(0, &["unmerge", arg(&both), "--out", arg(&at("apart"))]);
    for (name, own) in [("camera", &camera), ("lidar", &lidar)] {
        let again = fs::read(at("apart").join(name).join("map.mcap")).unwrap();
        assert!(again == fs::read(own.join("map.mcap")).unwrap(), "{name} as it was");
    }

    // A LiDAR that comes the other way joins the LiDAR of the rig, whose camera comes along.
    let (pose, duration) = walk(&[[6.0, 5.5], [-1.0, 4.5], [-8.0, 5.0]]);
    write_recording(&at("other"), &HALL, &pose, duration).unwrap();
    run(0, &["run", arg(&at("other")), "--out", arg(&at("out/other")), "--quiet"]);
    let all = at("all");
    let other = at("out/other");
    let merge = ["merge", arg(&other), arg(&both), "--out", arg(&all), "--quiet"];
    let params = at("merge.toml");
    fs::write(&params, "method = \"pcr-pro\"").unwrap();
    let printed = run(1, &[&merge[..], &["--params", arg(&params)]].concat());
    assert!(printed.contains("`method = \"direct\"`") && !all.join("map.mcap").exists(), "{printed}");
    fs::write(&params, "[fusion]\nmax_cycle_error = 4.8").unwrap();
    let printed = run(0, &[&merge[..], &["--params", arg(&params)]].concat());
    let record = fs::read_to_string(all.join("merge.json")).unwrap();
    assert_eq!(number(&record, "/params/fusion/max_cycle_error"), 4.8);
    assert!(record.contains("\"joint\": false"), "nothing is optimised jointly: {record}");
    assert!(
        printed.contains("other + lidar: accepted") && printed.contains("other, lidar, camera"),
        "{printed}"
    );
    let agents = ["lidar", "camera", "other"];
    let tracks = agents.map(|name| all.join(format!("trajectory-{name}.txt")));
    let truths = [at("lidar/groundtruth.txt"), at("camera/truth.txt"), at("other/groundtruth.txt")];
    let mut eval = vec!["eval"];
    eval.extend(tracks.iter().map(|track| arg(track)));
    eval.push("--gt");
    eval.extend(truths.iter().map(|truth| arg(truth)));
    let printed = run(0, &[&eval[..], &["--align", "se3", "--json"]].concat());
    for agent in 0..agents.len() {
        assert!(number(&printed, &format!("/agents/{agent}/ate/rmse")) < 0.03, "{printed}");
    }
    let page = embedded(&fs::read_to_string(all.join("report.html")).unwrap());
    assert_eq!(page["scene"]["agents"].as_array().unwrap().len(), 3);
    run(0, &["unmerge", arg(&all), "--out", arg(&at("all-apart"))]);
    for (name, own) in [("camera", &camera), ("lidar", &lidar), ("other", &other)] {
        let again = fs::read(at("all-apart").join(name).join("map.mcap")).unwrap();
        assert!(again == fs::read(own.join("map.mcap")).unwrap(), "{name} as it was");
    }

    // A manifest makes the map of it, and grows by what is new.
    let exported = |map: &Path| {
        run(0, &["export", arg(map), "--mcap", arg(&at("exported.mcap"))]);
        fs::read(at("exported.mcap")).unwrap()
    };
    assert!(exported(&all.join("manifest.json")) == fs::read(all.join("map.mcap")).unwrap());
    let (pose, duration) = walk(&[[-7.0, 4.8], [5.0, 5.2]]);
    write_recording(&at("more"), &HALL, &pose, duration).unwrap();
    run(0, &["run", arg(&at("more")), "--out", arg(&at("out/more")), "--quiet"]);
    let (small, grown, more) = (at("small"), at("grown"), at("out/more"));
    run(0, &["merge", arg(&both), arg(&other), "--no-map", "--out", arg(&small), "--quiet"]);
    let kept = || fs::read_dir(small.join("verdicts")).unwrap().count();
    assert_eq!((small.join("map.mcap").exists(), kept()), (false, 1));
    run(0, &["merge", arg(&small), arg(&more), "--no-map", "--out", arg(&grown), "--quiet"]);
    assert_eq!(kept(), 3, "pairs with the new map are compared");
    let once = at("once");
    run(0, &["merge", arg(&both), arg(&other), arg(&more), "--out", arg(&once), "--quiet"]);
    assert!(exported(&grown) == fs::read(once.join("map.mcap")).unwrap(), "grown as at once");
    let rest = at("rest");
    run(0, &["merge", arg(&grown), "--without", "more", "--out", arg(&rest), "--quiet"]);
    assert!(fs::read(rest.join("map.mcap")).unwrap() == exported(&small), "what is left out leaves nothing");

    // What is wrong with an extrinsic is said, and nothing is written.
    let nothing = at("nothing");
    let merge = ["merge", arg(&camera), arg(&lidar), "--out", arg(&nothing), "--quiet"];
    let looks_ahead = "--extrinsic=0.3,0.2,-0.2,-0.5,0.5,-0.5,0.5";
    let printed = run(1, &[&merge[..], &[looks_ahead]].concat());
    assert!(printed.contains("hint: "), "{printed}");
    let printed = run(1, &["merge", arg(&camera), arg(&camera), "--out", arg(&nothing), &extrinsic]);
    assert!(printed.contains("taken from a LiDAR's map"), "{printed}");
    assert!(!nothing.join("map.mcap").exists());
}
