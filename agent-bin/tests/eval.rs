//! `loopbox eval` through the binary.

use std::path::PathBuf;
use std::process::{Command, Output};

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../eval/tests/golden").join(name)
}

fn eval(estimate: &str, truth: &str, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
    command.arg("eval").arg(golden(estimate)).arg("--gt").arg(golden(truth)).args(more);
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
