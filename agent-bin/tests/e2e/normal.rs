//! Undisturbed runs.

use crate::documented::assert_documented;
use crate::support::{Case, Outcome, drive, loopbox};
use serde_json::Value;
use std::fs;
use std::path::Path;

#[test]
fn a_drive_is_mapped() {
    let case = Case::new(&drive());
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 2);
    for name in ["trajectory.txt", "map.mcap", "cloud.ply", "report.html", "run.json"] {
        let size = fs::metadata(case.out().join(name)).map_or(0, |m| m.len());
        assert!(size > 0, "{name} is missing or empty\n{outcome}");
    }
    let map = case.map();
    assert!(map.keyframes.len() >= 2, "{} keyframes", map.keyframes.len());
    let density = |k: &map::Keyframe| k.semi_dense.len() as f64 / k.image.data().len() as f64;
    let densities: Vec<f64> = map.keyframes.values().map(density).collect();
    let mean = densities.iter().sum::<f64>() / densities.len() as f64;
    assert!(mean >= 0.08, "a keyframe has depth in {:.1} % of its pixels", 100.0 * mean);

    let mut info = loopbox();
    info.arg("info").arg(case.out().join("map.mcap"));
    let info = Outcome::of(info);
    info.assert_success();
    info.assert_says(&["keyframes"]);

    let printed = |arguments: &[&str], path: &Path| {
        let mut command = loopbox();
        let output = command.arg(arguments[0]).arg(path).args(&arguments[1..]).arg("--json").output();
        serde_json::from_slice::<Value>(&output.expect("it runs").stdout).expect("JSON")
    };
    let truth = case.source().join("groundtruth.txt");
    let record = fs::read(case.out().join("run.json")).expect("it was written");
    let run: Value = serde_json::from_slice(&record).expect("JSON");
    assert!(run["params"]["mapping"].is_object() && run["calibration"]["lens"]["intrinsics"]["fx"].is_f64());
    for json in [
        run,
        printed(&["info"], &case.out()),
        printed(&["info"], &case.source()),
        printed(&["eval", "--gt", truth.to_str().expect("a path")], &case.out()),
    ] {
        assert!(json["version"].is_string(), "{json}");
        assert_documented(&json);
    }
}

/// Everything that does not speak of time must be equal to the bit, on one core and on two.
#[test]
fn runs_are_bit_identical_on_any_number_of_cores() {
    let case = Case::new(&drive());
    let results = ["1", "2", "2"].map(|threads| {
        case.run(&["--threads", threads]).assert_success();
        ["trajectory.txt", "cloud.ply", "map.mcap"]
            .map(|name| (name, fs::read(case.out().join(name)).expect(name)))
    });
    for result in &results[1..] {
        for ((name, bytes), (_, first)) in result.iter().zip(&results[0]) {
            assert!(bytes == first, "{name} differs from that of the first run");
        }
    }
}

/// The truth is a track in metres: what is exported by it needs no alignment any more.
#[test]
fn a_map_is_exported_in_metres_and_for_other_tools() {
    let case = Case::new(&drive());
    case.run(&["--name", "yard"]).assert_success();
    assert_eq!(case.map().agents[&map::AgentId::default()].name, "yard");
    let file = |name: &str| case.out().join("export").join(name);
    fs::create_dir(case.out().join("export")).expect("a folder");
    let export = |arguments: &[&str]| {
        let mut command = loopbox();
        command.arg("export").arg(case.out()).args(arguments);
        let files = [
            ("--mcap", "metric.mcap"),
            ("--tum", "metric.txt"),
            ("--ply", "metric.ply"),
            ("--report", "r.html"),
        ];
        for (option, name) in files {
            command.arg(option).arg(file(name));
        }
        command.arg("--colmap").arg(file("colmap")).arg("--nerfstudio").arg(file("nerfstudio"));
        Outcome::of(command)
    };
    let truth = case.source().join("groundtruth.txt");
    let outcome = export(&["--track", truth.to_str().expect("a path"), "--voxel", "0.25"]);
    outcome.assert_success();
    let mut eval = loopbox();
    eval.arg("eval").arg(file("metric.txt")).arg("--gt").arg(&truth).args(["--align", "none", "--json"]);
    let eval: serde_json::Value =
        serde_json::from_slice(&eval.output().expect("it runs").stdout).expect("JSON");
    let ate = eval["ate"]["rmse"].as_f64().expect("a number");
    assert!(ate < 0.05, "{ate} m without alignment");

    let (map, keyframes) =
        (map::load_map(file("metric.mcap")).expect("it loads").map, case.map().keyframes.len());
    assert_eq!(map.keyframes.len(), keyframes);
    assert!(
        map.thinned_cloud(map::DEFAULT_MAX_RELATIVE_VARIANCE, 0.25).count() < map.cloud(0.01).count() / 2
    );
    let report = fs::read_to_string(file("r.html")).expect("a report");
    assert!(report.contains("<h1>yard</h1>") && report.contains("\"length of the path\""));
    for folder in ["colmap", "nerfstudio"] {
        let images = fs::read_dir(file(folder).join("images")).expect("a folder").count();
        assert_eq!(images, keyframes, "{folder}");
    }
    let tracks = fs::read_to_string(file("colmap/sparse/0/points3D.txt")).expect("points");
    assert!(tracks.lines().count() > 100, "{} points", tracks.lines().count());
    export(&["--distance", "0,9999=2"]).assert_refused(&["no keyframe 9999"]);
    export(&["--scale", "0"]).assert_refused(&["a scale of 0"]);
}
