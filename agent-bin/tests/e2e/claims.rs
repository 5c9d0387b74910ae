//! A camera that is covered and uncovered, or localised in a map: in the place that it knows, or in a double of it.

use crate::support::{Case, Outcome};
use loopbox_tests::covered::{AFTER, BEFORE, COVERED, RATE, Uncovered, covered};
use loopbox_tests::doubles::Kind;
use loopbox_tests::{Encoding, Recording};
use std::path::{Path, PathBuf};

/// A façade of equal windows with other things in each of them, whose bricks have a grain of their own.
fn facade(uncovered: Uncovered) -> Recording {
    covered(Kind::Facade, 1, uncovered, 4.0)
}

/// Frames in the first trajectory from before the camera was covered, and from after.
fn halves(out: &Path) -> [usize; 2] {
    let poses = eval::read_trajectory(&out.join("trajectory.txt")).expect("it was written");
    let covered = BEFORE as f64 / RATE;
    let times = poses.timestamps.expect("each has one");
    let before = times.iter().filter(|time| **time < covered).count();
    [before, times.len() - before]
}

#[test]
fn a_camera_uncovered_where_it_was_continues_its_map() {
    let case = Case::new(&facade(Uncovered::There(0.0)));
    let outcome = case.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["tracking is lost since frame 120", "tracking goes on since frame 1"]);
    assert_eq!(halves(&case.out()), [BEFORE, AFTER], "{outcome}");
}

#[test]
fn a_camera_uncovered_in_a_double_makes_a_map_of_its_own() {
    // In a row of houses where little differs, the fragments are not joined in the end either, nor in a train that shares most of what is seen.
    let elsewhere = |kind, seed| covered(kind, seed, Uncovered::Elsewhere(0.3), 4.0);
    let recordings = [
        (facade(Uncovered::Elsewhere(1.0)), Encoding::Png),
        (elsewhere(Kind::Row, 1), Encoding::Png),
        (elsewhere(Kind::Carriage, 424), Encoding::Jpeg),
    ];
    for (recording, encoding) in recordings {
        let case = Case::with_encoding(&recording, encoding);
        let outcome = case.run(&[]);
        outcome.assert_success();
        outcome.assert_says(&[
            "tracking goes on since frame 1",
            "in another map",
            "in trajectory-2.txt: a fragment",
        ]);
        let halves = halves(&case.out());
        assert!(halves.contains(&0), "{halves:?}\n{outcome}");
    }
}

/// A part of a recording, in a folder beside it.
fn part(case: &Case, name: &str, recording: &Recording, frames: std::ops::Range<usize>) -> PathBuf {
    let folder = case.source().with_file_name(name);
    let part = Recording { camera: recording.camera, shots: recording.shots[frames].to_vec() };
    part.write(&folder, Encoding::Png).expect("the temporary folder takes the recording");
    folder
}

#[test]
fn a_map_is_localised_and_gone_on_in_only_where_it_is_the_place() {
    let (there, elsewhere) = (facade(Uncovered::There(0.0)), facade(Uncovered::Elsewhere(1.0)));
    let case = Case::empty();
    let kept = case.source().with_file_name("kept");
    let run = |source: &Path, out: &str, arguments: &[&str]| {
        let out = case.source().with_file_name(out);
        let mut command = crate::support::loopbox();
        command.arg("run").arg(source).arg("--out").arg(&out).args(arguments);
        (Outcome::of(command), out)
    };
    run(&part(&case, "first", &there, 0..BEFORE), "kept", &[]).0.assert_success();
    let kept = kept.to_str().expect("the path is text");
    let after = BEFORE + COVERED..there.shots.len();
    let (there, elsewhere) =
        (part(&case, "there", &there, after.clone()), part(&case, "elsewhere", &elsewhere, after));
    let (outcome, out) = run(&there, "localised", &["--localise", kept]);
    outcome.assert_success();
    let poses = eval::read_trajectory(&out.join("trajectory.txt")).expect("it was written");
    assert_eq!(poses.world_from_camera.len(), AFTER, "{outcome}");
    let (outcome, out) = run(&elsewhere, "not-localised", &["--localise", kept]);
    outcome.assert_refused(&["no frame could be tracked", "does not confirm that it is that place"]);
    assert!(!out.join("trajectory.txt").exists());
    let (outcome, _) = run(&elsewhere, "apart", &["--continue", kept]);
    outcome.assert_refused(&["resembles a part of", "a map of its own"]);
}
