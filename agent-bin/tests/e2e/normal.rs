//! Undisturbed runs.

use crate::support::{Case, Outcome, drive, loopbox};
use std::fs;

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
