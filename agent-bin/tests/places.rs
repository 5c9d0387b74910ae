//! `loopbox vocab train` and `loopbox places` through the binary.

mod common;

use common::*;
use loopbox_tests::{Encoding, Recording, World, trajectory};
use std::path::Path;
use tempfile::tempdir;

/// A recording of the yard, long enough for a map; `part` 0 and 1 overlap by half.
fn record(folder: &Path, part: usize) {
    let path = trajectory::sideways(60, 3.0);
    let part = &path[15 * part..15 * part + 45];
    let recording = Recording::render(&World::yard(1), Recording::SMALL_CAMERA, part, 30.0);
    recording.write(folder, Encoding::Png).unwrap();
}

#[test]
fn maps_of_one_yard_have_places_in_common() {
    let folder = tempdir().unwrap();
    let run = |part: usize| {
        let (recording, out) =
            (folder.path().join(format!("recording{part}")), folder.path().join(format!("run{part}")));
        record(&recording, part);
        let output = loopbox(&["run", arg(&recording), "--out", arg(&out)]);
        assert!(output.status.success(), "{}", stderr(&output));
        out
    };
    let (a, b) = (run(0), run(1));
    let output = loopbox(&["places", arg(&a), arg(&b.join("map.mcap")), "--json", "--count", "5"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let pairs: serde_json::Value = serde_json::from_str(&stdout(&output)).unwrap();
    let best = &pairs[0];
    assert!(best["score"].as_f64().unwrap() > 0.1 && best["shared"].as_u64().unwrap() > 20, "{pairs}");
    // The second recording starts half a second into the first.
    let apart = best["a_time"].as_f64().unwrap() - best["b_time"].as_f64().unwrap() - 0.5;
    assert!(apart.abs() < 0.4, "{pairs}");
    let table = stdout(&loopbox(&["places", arg(&a), arg(&b)]));
    assert!(table.starts_with("       a") && table.contains("FAB-MAP"), "{table}");
}

#[test]
fn a_vocabulary_is_trained_from_images_and_used() {
    let folder = tempdir().unwrap();
    let (recording, file) = (folder.path().join("recording"), folder.path().join("words"));
    record(&recording, 0);
    let train = |more: &[&str]| {
        let arguments =
            ["vocab", "train", arg(&recording), "--every", "9", "--levels", "2", "--out", arg(&file)];
        let output = loopbox(&[&arguments, more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        std::fs::read(&file).unwrap()
    };
    let first = train(&[]);
    assert_eq!(first, train(&[]));
    assert_ne!(first, train(&["--seed", "2"]));
    write(file.clone(), &first[..first.len() / 2]);
    let missing = arg(folder.path());
    assert_refused(&["places", missing, missing, "--vocabulary", arg(&file)], &["cut short"]);
}

#[test]
fn what_is_not_there_is_named() {
    let folder = tempdir().unwrap();
    let (empty, nothing) = (arg(folder.path()), folder.path().join("nothing"));
    assert_refused(&["places", empty, empty], &["map.mcap", "there is no map", "loopbox run"]);
    let out = folder.path().join("words");
    assert_refused(&["vocab", "train", arg(&nothing), "--out", arg(&out)], &["nothing", "no such file"]);
    assert_refused(&["vocab", "train", empty, "--out", arg(&out)], &["holds no images"]);
    assert!(!out.exists());
}
