//! What recordings give stands in `golden.csv` to the bit: who changes a result renews it (`script/golden`), and a review sees by how much.
//!
//! Those of `demo/` are whole. Of the sequences, which lie in the folder that `LOOPBOX_DATA` names, by default
//! `shared/data` beside the repository, the first hundred frames are run; without them they count as skipped.

use crate::support::{Accuracy, Case, Outcome, loopbox, sequence};
use serde_json::Value;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// How many frames of a sequence are run.
const FRAMES: usize = 100;
const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/e2e/golden.csv");
const ASKED: &str = "LOOPBOX_WRITE_GOLDEN";
const HEADER: &str = "recording,frames,keyframes,loops,ate_mm,trajectory";

/// Compares a row with the one of its name, or puts it in its place where that is asked for.
fn check(name: &str, row: &str) {
    static WRITING: Mutex<()> = Mutex::new(());
    let _writing = WRITING.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let known = fs::read_to_string(FILE).unwrap_or_default();
    let is_own = |line: &&str| line.split(',').next() == Some(name);
    if std::env::var_os(ASKED).is_none() {
        let golden = known.lines().find(is_own).unwrap_or("no such row");
        assert_eq!(
            row, golden,
            "another result than in golden.csv; if that is wanted, script/golden renews it"
        );
        return;
    }
    let others = known.lines().skip(1).filter(|line| !is_own(line));
    let mut rows: Vec<&str> = others.chain([row]).collect();
    rows.sort_unstable();
    fs::write(FILE, format!("{HEADER}\n{}\n", rows.join("\n"))).expect("golden.csv can be written");
}

/// FNV-1a of some files' bytes.
fn hash(files: &[PathBuf]) -> u64 {
    let bytes = files.iter().flat_map(|file| fs::read(file).expect("the trajectory was written"));
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

fn row(name: &str, record: &Value, trajectories: &[(PathBuf, PathBuf)], measured: &Accuracy) -> String {
    let count = |path: &str| record.pointer(path).map_or("-".to_owned(), Value::to_string);
    let files: Vec<PathBuf> = trajectories.iter().map(|(found, _)| found.clone()).collect();
    let (keyframes, loops) = (count("/map/keyframes"), count("/map/loops"));
    format!("{name},{},{keyframes},{loops},{:.3},{:016x}", measured.frames, 1e3 * measured.rmse, hash(&files))
}

/// Compares trajectories in one frame with their truths, and all with the golden row.
fn check_trajectories(name: &str, record: &Value, trajectories: &[(PathBuf, PathBuf)]) -> Accuracy {
    let measured = Accuracy::together(trajectories);
    check(name, &row(name, record, trajectories, &measured));
    measured
}

/// Runs a recording into a folder.
fn run(source: &Path, out: &Path) -> Value {
    let mut command = loopbox();
    command.arg("run").arg(source).arg("--out").arg(out);
    Outcome::of(command).assert_success();
    let record = fs::read_to_string(out.join("run.json")).expect("the run wrote its record");
    serde_json::from_str(&record).expect("it is JSON")
}

/// The first frames of a sequence give what they gave; how accurate that is, where the sequence is here.
fn check_sequence(name: &str) -> Option<Accuracy> {
    let folder = sequence(name)?;
    let case = Case::empty();
    for file in ["images", "groundtruth.txt", "camera.yaml"] {
        symlink(folder.join(file), case.source().join(file)).expect("the temporary folder takes a link");
    }
    let times = fs::read_to_string(folder.join("times.txt")).expect("a sequence has its times");
    let lines = times.lines().filter(|line| !line.starts_with('#')).take(FRAMES);
    let first: String = lines.map(|line| format!("{line}\n")).collect();
    fs::write(case.source().join("times.txt"), first).expect("the temporary folder takes a file");
    let record = run(&case.source(), &case.out());
    let truth = folder.join("groundtruth.txt");
    Some(check_trajectories(name, &record, &[(case.out().join("trajectory.txt"), truth)]))
}

#[test]
fn the_demo_gives_what_it_gave() {
    let (case, demo) = (Case::empty(), Path::new(env!("CARGO_MANIFEST_DIR")).join("../demo"));
    let agents = ["parking_a", "parking_c"];
    let truth = |agent: &str| demo.join(agent).join("groundtruth.txt");
    for agent in agents {
        let out = case.out().join(agent);
        let record = run(&demo.join(agent), &out);
        let name = format!("demo/{agent}");
        check_trajectories(&name, &record, &[(out.join("trajectory.txt"), truth(agent))]);
    }
    let merged = case.out().join("merged");
    let mut command = loopbox();
    command.arg("merge").args(agents.map(|agent| case.out().join(agent))).arg("--out").arg(&merged);
    let outcome = Outcome::of(command);
    outcome.assert_success();
    assert!(!outcome.text.contains("-0.0 %"), "{outcome}");
    let trajectories = agents.map(|agent| (merged.join(format!("trajectory-{agent}.txt")), truth(agent)));
    check_trajectories("demo merged", &Value::Null, &trajectories);
}

/// Fails when more than `may_miss` of the first frames of a sequence are not tracked or the RMSE exceeds `bound` metres, whatever
/// golden.csv says.
fn check_bounded(name: &str, may_miss: usize, bound: f64) {
    let Some(measured) = check_sequence(name) else { return };
    assert!(measured.frames + may_miss >= FRAMES, "{} of {FRAMES} frames tracked", measured.frames);
    assert!(measured.rmse <= bound, "RMSE {:.4} m, bound {bound} m", measured.rmse);
}

#[test]
fn the_start_of_parking_a() {
    check_bounded("parking_a", 2, 0.005);
}

#[test]
fn the_start_of_tum_fr1_xyz() {
    check_bounded("tum_fr1_xyz", 2, 0.022);
}

#[test]
fn the_start_of_tum_fr1_desk() {
    check_sequence("tum_fr1_desk");
}

#[test]
fn the_start_of_kitti00() {
    check_sequence("kitti00_first201");
}

#[test]
fn the_shaken_drone() {
    check_sequence("euroc_shake");
}
