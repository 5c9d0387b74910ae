//! `loopbox eval` through the binary.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../eval/tests/golden").join(name)
}

fn eval(estimate: &str, truth: &str, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
    // What is no option is one more estimate; estimates come before `--gt`, which takes all that follows.
    let (others, options) =
        more.split_at(more.iter().position(|word| word.starts_with('-')).unwrap_or(more.len()));
    command.arg("eval").arg(golden(estimate)).args(others).arg("--gt").arg(golden(truth)).args(options);
    command.output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn json_and_table_tell_the_same() {
    let json = eval("estimate.tum", "truth.tum", &["--json", "--delta", "3"]);
    assert!(json.status.success(), "{}", stderr(&json));
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(json["align"], "sim3");
    assert_eq!(json["rpe"]["delta"]["frames"], 3);
    assert!(json.get("depth").is_none());
    let rmse = json["ate"]["rmse"].as_f64().unwrap();
    let table = eval("estimate.tum", "truth.tum", &["--delta", "3"]);
    let table = String::from_utf8(table.stdout).unwrap();
    assert!(table.contains(&format!("{rmse:.6}")), "{table}");
    assert!(table.contains("RPE over 3 frame(s)"), "{table}");
}

/// Each run is aligned by itself, and the rows of the table are those of the file.
#[test]
fn runs_are_compared_by_themselves_in_one_table() {
    let room = tempfile::tempdir().unwrap();
    let (turned, csv) = (turned(room.path(), 3.0), room.path().join("runs.csv"));
    let [turned, csv] = [&turned, &csv].map(|path| path.to_str().unwrap());
    let table = eval("estimate.tum", "truth.tum", &[turned, "--table", "--csv", csv]);
    assert!(table.status.success(), "{}", stderr(&table));
    let alone = eval("estimate.tum", "truth.tum", &["--json"]);
    let alone: serde_json::Value = serde_json::from_slice(&alone.stdout).unwrap();
    let rmse = alone["ate"]["rmse"].as_f64().unwrap();
    let text = String::from_utf8(table.stdout).unwrap();
    assert_eq!(text.matches(&format!("{rmse:.4}")).count(), 5, "two rows, a median and a range: {text}");
    let rows = std::fs::read_to_string(csv).unwrap();
    let rmse_of = |line: &str| line.split(',').nth(4).unwrap().parse::<f64>().unwrap();
    let found: Vec<f64> = rows.lines().skip(1).map(rmse_of).collect();
    assert!(found.len() == 2 && found.iter().all(|found| (found - rmse).abs() < 1e-6), "{rows}");
    let json = eval("estimate.tum", "truth.tum", &[turned, "--table", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(json["recordings"][0]["runs"], 2);
    let refused = eval("estimate.tum", "truth.tum", &["--csv", csv]);
    assert!(!refused.status.success() && stderr(&refused).contains("--table"), "{}", stderr(&refused));
}

#[test]
fn of_the_folder_of_a_merge_the_trajectories_are_named() {
    let room = tempfile::tempdir().unwrap();
    for name in ["trajectory-b.txt", "trajectory-a.txt", "map.mcap"] {
        std::fs::write(room.path().join(name), "").unwrap();
    }
    let refused = eval(room.path().to_str().unwrap(), "truth.tum", &[]);
    let printed = stderr(&refused);
    assert!(!refused.status.success() && printed.contains("several agents"), "{printed}");
    let [a, b] = ["a", "b"].map(|name| printed.find(&format!("trajectory-{name}.txt")));
    assert!(a.is_some() && a < b && !printed.contains("map.mcap"), "{printed}");
}

#[test]
fn what_cannot_be_compared_is_refused_with_a_reason() {
    let cases: [(&str, &str, &[&str], &str); 4] = [
        ("estimate.tum", "truth.kitti", &[], "--frames"),
        ("estimate.tum", "none", &[], "none: cannot be read"),
        ("estimate.tum", "truth.tum", &["--delta", "0"], "number of frames from 1"),
        ("estimate.tum", "truth.tum", &["--max-diff", "1e-9"], "--max-diff"),
    ];
    for (estimate, truth, more, reason) in cases {
        let output = eval(estimate, truth, more);
        assert!(!output.status.success(), "{truth} {more:?}");
        assert!(stderr(&output).contains(reason), "{}", stderr(&output));
    }
}

/// Writes the golden estimate again, `scale` times as large and turned by a quarter about z.
fn turned(folder: &Path, scale: f64) -> PathBuf {
    let text = std::fs::read_to_string(golden("estimate.tum")).unwrap();
    let line = |line: &str| {
        let n: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let [t, x, y, z, qx, qy, qz, qw] = n[..] else { panic!("{line}") };
        let h = 0.5f64.sqrt();
        let q = [h * (qx - qy), h * (qy + qx), h * (qz + qw), h * (qw - qz)];
        format!("{t} {} {} {} {} {} {} {}\n", -scale * y, scale * x, scale * z, q[0], q[1], q[2], q[3])
    };
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let path = folder.join("turned.tum");
    std::fs::write(&path, lines.map(line).collect::<String>()).unwrap();
    path
}

#[test]
fn several_agents_are_measured_in_the_frame_of_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let turned = turned(folder.path(), 1.02);
    let turned = turned.to_str().unwrap();
    let json = eval("estimate.tum", "truth.tum", &["--json", turned]);
    assert!(json.status.success(), "{}", stderr(&json));
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    let [first, second] = [&json["agents"][0], &json["agents"][1]];
    let alone = eval("estimate.tum", "truth.tum", &["--json"]);
    let alone: serde_json::Value = serde_json::from_slice(&alone.stdout).unwrap();
    assert_eq!(first["ate"], alone["ate"]);
    assert_eq!(json["truth_from_estimate"], alone["truth_from_estimate"]);
    assert_eq!((&first["merge"], second["estimate"].as_str()), (&serde_json::Value::Null, Some(turned)));
    let merge = |key: &str| second["merge"][key].as_f64().unwrap();
    assert!((merge("scale_percent") - 2.0).abs() < 1e-3, "{second}");
    assert!((merge("rotation_deg") - 90.0).abs() < 1e-3, "{second}");
    assert!(second["ate"]["rmse"].as_f64().unwrap() > 1.0);
    let table = eval("estimate.tum", "truth.tum", &[turned]);
    let table = String::from_utf8(table.stdout).unwrap();
    assert!(table.contains("+2.000     90.000") && table.contains(turned), "{table}");
}

#[test]
fn one_option_takes_the_truths_of_all() {
    let truth = golden("truth.tum");
    let [one, each] = [vec!["estimate.tum"], vec!["estimate.tum", "estimate.tum"]].map(|estimates| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        command.arg("eval").args(estimates.iter().map(|name| golden(name)));
        command.arg("--gt").args([&truth, &truth]).arg("--json").output().unwrap()
    });
    assert!(each.status.success(), "{}", stderr(&each));
    let found: serde_json::Value = serde_json::from_slice(&each.stdout).unwrap();
    assert_eq!(found["agents"].as_array().unwrap().len(), 2);
    assert!(stderr(&one).contains("estimates come before --gt"), "{}", stderr(&one));
}

#[test]
fn every_agent_needs_its_own() {
    let other = golden("estimate.tum");
    let other = other.to_str().unwrap();
    let truth = golden("truth.tum");
    let truth = truth.to_str().unwrap();
    let cases: [(&[&str], &str); 4] = [
        (&[other, "--gt", truth, "--gt", truth], "2 estimates and 3 truths"),
        (&[other, "--frames", truth], "2 estimates and 1 --frames"),
        (&[other, "--max-diff", "1e-9"], "agent 1"),
        (
            &[other, "--map", "m", "--depth", "d", "--frames", truth, "--frames", truth],
            "--map is that of one",
        ),
    ];
    for (more, reason) in cases {
        let output = eval("estimate.tum", "truth.tum", more);
        assert!(!output.status.success(), "{more:?}");
        assert!(stderr(&output).contains(reason), "{}", stderr(&output));
    }
}

/// EuRoC's truth is of the body; the estimate is of the camera, which `cam0/sensor.yaml` puts 2 m ahead of it.
#[test]
fn eurocs_truth_minds_where_the_camera_is() {
    let folder = tempfile::tempdir().unwrap();
    let truth = folder.path().join("mav0/state_groundtruth_estimate0/data.csv");
    for path in [truth.parent().unwrap(), &folder.path().join("mav0/cam0")] {
        std::fs::create_dir_all(path).unwrap();
    }
    // The body turns about its upright z while it walks; the camera swings around it.
    let (mut rows, mut poses) = (String::from("#timestamp\n"), String::new());
    for i in 0..40u64 {
        let (angle, x) = (0.1 * i as f64, 0.2 * i as f64);
        let (z, w) = ((angle / 2.0).sin(), (angle / 2.0).cos());
        rows += &format!(
            "{},{x},0,0,{w},0,0,{z},0,0,0,0,0,0,0,0,0\n",
            1_400_000_000_000_000_000 + i * 100_000_000
        );
        let (cx, cy) = (x + 2.0 * angle.cos(), 2.0 * angle.sin());
        poses += &format!("{} {cx} {cy} 0 0 0 {z} {w}\n", 1.4e9 + 0.1 * i as f64);
    }
    std::fs::write(&truth, rows).unwrap();
    let estimate = folder.path().join("estimate.txt");
    std::fs::write(&estimate, poses).unwrap();
    let ate = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        command.arg("eval").arg(&estimate).arg("--gt").arg(&truth).args(["--align", "none", "--json"]);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        found["ate"]["rmse"].as_f64().unwrap()
    };
    assert!(ate() > 1.9);
    let sensor = "T_BS:\n  rows: 4\n  cols: 4\n  data: [1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n";
    std::fs::write(folder.path().join("mav0/cam0/sensor.yaml"), sensor).unwrap();
    assert!(ate() < 1e-6, "{}", ate());
}
