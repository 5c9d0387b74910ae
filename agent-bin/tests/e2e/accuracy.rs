//! Accuracy on the first hundred frames of real and rendered sequences, so that a worse tracker is noticed.
//!
//! The sequences lie in the folder that `LOOPBOX_DATA` names, by default `shared/data` beside the repository;
//! without them the tests say so and pass.

use crate::support::{Accuracy, Case};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;

/// How many frames of each sequence are run.
const FRAMES: usize = 100;

/// The folder of a sequence, if it is here.
fn sequence(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("LOOPBOX_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")),
        PathBuf::from,
    );
    let folder = data.join(name);
    if folder.is_dir() {
        return fs::canonicalize(folder).ok();
    }
    eprintln!("SKIPPED: {} is not here; set LOOPBOX_DATA to the folder of the sequences", folder.display());
    None
}

/// Runs the first frames of a sequence; fails when more than `may_miss` of them are not tracked or the RMSE
/// exceeds `bound` metres.
fn check(name: &str, may_miss: usize, bound: f64) {
    let Some(folder) = sequence(name) else { return };
    let case = Case::empty();
    for file in ["images", "groundtruth.txt", "camera.yaml"] {
        symlink(folder.join(file), case.source().join(file)).expect("the temporary folder takes a link");
    }
    let times = fs::read_to_string(folder.join("times.txt")).expect("a sequence has its times");
    let lines = times.lines().filter(|line| !line.starts_with('#')).take(FRAMES);
    let first: String = lines.map(|line| format!("{line}\n")).collect();
    fs::write(case.source().join("times.txt"), first).expect("the temporary folder takes a file");

    let outcome = case.run(&[]);
    outcome.assert_success();
    let measured = Accuracy::of(&case.out(), &folder.join("groundtruth.txt"));
    assert!(
        measured.frames + may_miss >= FRAMES,
        "{} of {FRAMES} frames tracked\n{outcome}",
        measured.frames
    );
    assert!(measured.rmse <= bound, "RMSE {:.4} m, bound {bound} m\n{outcome}", measured.rmse);
    eprintln!("{name}: RMSE {:.4} m, {} of {FRAMES} frames", measured.rmse, measured.frames);
}

// The bounds are about twice what the tracker reaches: 2.1 mm and 1.1 cm.

#[test]
fn the_start_of_parking_a() {
    check("parking_a", 2, 0.005);
}

#[test]
fn the_start_of_tum_fr1_xyz() {
    check("tum_fr1_xyz", 2, 0.022);
}
