//! What cannot be merged is refused by name, and nothing is left behind.

use crate::support::{Case, Outcome, Runs, arg, loopbox};
use geometry::Sim3;
use map::{AgentInfo, Map, SemiDense};
use nalgebra::{UnitQuaternion, Vector3};
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Merges `left` with what `make` makes of it, both ways round; fails unless both are refused and leave nothing.
fn refused(make: impl FnOnce(&Case) -> PathBuf, words: &[&str]) {
    let (left, case) = (Runs::get().run("left"), Case::new());
    let bad = make(&case);
    for maps in [[left.as_path(), &bad], [&bad, left.as_path()]] {
        case.merge(&maps).assert_refused(words);
        assert!(!case.out().exists(), "{:?}", case.results());
    }
    // A folder of the user's stays, as it was.
    fs::create_dir(case.out()).unwrap();
    fs::write(case.out().join("notes.txt"), b"mine").unwrap();
    case.merge(&[&left, &bad]).assert_refused(words);
    assert_eq!(case.results(), ["notes.txt"]);
}

fn left_bytes() -> Vec<u8> {
    fs::read(Runs::get().run("left").join("map.mcap")).unwrap()
}

#[test]
fn a_map_of_another_format() {
    let later = |case: &Case| {
        let mut bytes = left_bytes();
        // The key, the length of the value, the value.
        let key = bytes.windows(6).position(|window| window == b"format").unwrap();
        bytes[key + 10] = b'7';
        case.file("later.mcap", &bytes)
    };
    refused(later, &["later.mcap", "format 7", "use the loopbox version that wrote it"]);
}

#[test]
fn files_that_end_too_early() {
    refused(|case| case.file("nothing.mcap", b""), &["nothing.mcap is empty", "run it again"]);
    refused(|case| case.file("stub.mcap", &left_bytes()[..60]), &["stub.mcap"]);
    refused(
        |case| case.file("text.mcap", b"no map, but long enough to be one"),
        &["text.mcap", "not an MCAP"],
    );
}

/// What is whole of a map whose run was killed is a map; that something is missing is said.
#[test]
fn a_truncated_map_is_used_as_far_as_it_is_whole() {
    let (runs, case) = (Runs::get(), Case::new());
    let bytes = left_bytes();
    let cut = case.file("cut.mcap", &bytes[..bytes.len() * 19 / 20]);
    let outcome = case.merge(&[&cut, &runs.run("right")]);
    assert!(outcome.stderr.contains("warning: ") && outcome.stderr.contains("cut.mcap"), "{outcome:#?}");
    assert!(!outcome.stderr.contains("panicked"), "{outcome:#?}");
    match outcome.code {
        Some(0) => assert!(case.out().join("map.mcap").is_file()),
        _ => assert_eq!(case.results(), ["verdicts"]),
    }
}

/// An agent says its edges when it ends: without them maps hung together by nothing, and all other keyframe pairs failed.
#[test]
fn the_map_of_a_killed_run_has_no_edges_and_is_merged() {
    let (runs, case) = (Runs::get(), Case::new());
    let edgeless = case.map("edgeless.mcap", &Map { edges: Vec::new(), ..runs.map("left") });
    let outcome = case.merge(&[&edgeless, &runs.run("right")]);
    assert_eq!(outcome.code, Some(0), "{outcome:#?}");
}

#[test]
fn a_map_without_keyframes() {
    let empty = |case: &Case| {
        let left = Runs::get().map("left");
        let camera = *left.agents.values().next().unwrap().camera().unwrap();
        case.map("hollow.mcap", &Map::of(AgentInfo::new("hollow", camera)))
    };
    refused(empty, &["hollow.mcap", "no keyframes"]);
}

#[test]
fn a_map_without_depth() {
    let flat = |case: &Case| {
        let mut map = Runs::get().map("right");
        map.keyframes.values_mut().for_each(|keyframe| keyframe.semi_dense = SemiDense::default().into());
        case.map("flat.mcap", &map)
    };
    refused(flat, &["flat.mcap", "no keyframe of the map has depth", "hint: "]);
}

#[test]
fn the_same_map_twice_however_it_is_called_and_wherever_it_lies() {
    let words = ["the same map twice", "give each map once"];
    refused(|_| Runs::get().run("left").join("map.mcap"), &words);
    let renamed = |case: &Case| {
        let mut map = Runs::get().map("left");
        map.agents.values_mut().for_each(|info| info.name = "another".into());
        case.map("renamed.mcap", &map)
    };
    refused(renamed, &words);
    let moved = |case: &Case| {
        let mut map = Runs::get().map("left");
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.1);
        let motion = Sim3::new(rotation, Vector3::new(1.0, 2.0, 3.0), 2.5);
        for keyframe in map.keyframes.values_mut() {
            keyframe.world_from_keyframe = motion * keyframe.world_from_keyframe;
        }
        case.map("moved.mcap", &map)
    };
    refused(moved, &words);
}

#[test]
fn a_map_whose_poses_are_no_numbers() {
    let broken = |case: &Case| {
        let last = Runs::get().map("left").keyframes.into_values().next_back().unwrap();
        let bytes = with_number(&left_bytes(), last.world_from_keyframe.translation.x, f64::NAN);
        case.file("broken.mcap", &bytes)
    };
    refused(broken, &["broken.mcap", "pose", "is not finite"]);
}

/// A map file with one number in the place of another, wherever it stands.
fn with_number(file: &[u8], old: f64, new: f64) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().profile("loopbox.map").create(&mut out).unwrap();
    for record in mcap::read::LinearReader::new(file).unwrap() {
        if let mcap::records::Record::Metadata(metadata) = record.unwrap() {
            writer.write_metadata(&metadata).unwrap();
        }
    }
    let mut replaced = false;
    for message in mcap::MessageStream::new(file).unwrap() {
        let mut message = message.unwrap();
        let data = message.data.to_mut();
        for at in 0..data.len().saturating_sub(7) {
            if data[at..at + 8] == old.to_le_bytes() {
                data[at..at + 8].copy_from_slice(&new.to_le_bytes());
                replaced = true;
            }
        }
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    assert!(replaced, "the file does not hold the number");
    out.into_inner()
}

#[test]
fn what_is_no_map() {
    let folder = |case: &Case| {
        fs::create_dir(case.path("holiday")).unwrap();
        case.path("holiday")
    };
    refused(folder, &["holiday", "there is no map", "loopbox run"]);
    refused(|case| case.path("nowhere.mcap"), &["nowhere.mcap", "there is no map"]);
}

#[test]
fn one_map_alone() {
    let (left, case) = (Runs::get().run("left"), Case::new());
    case.merge(&[&left]).assert_refused(&["is one map", "give two or more"]);
    assert!(!case.out().exists());
}

fn merge_into(out: &Path) -> Outcome {
    let runs = Runs::get();
    let (left, right) = (runs.run("left"), runs.run("right"));
    loopbox(&["merge", arg(&left), arg(&right), "--out", arg(out)])
}

#[test]
fn a_folder_that_cannot_be_written() {
    let case = Case::new();
    let file = case.file("file", b"mine");
    for out in [file.clone(), file.join("below")] {
        merge_into(&out).assert_refused(&["file", "the folder cannot be made", "hint: --out"]);
        assert_eq!(fs::read(&file).unwrap(), b"mine");
    }
}

#[test]
fn results_never_replace_what_is_merged() {
    let right = Runs::get().run("right");
    let before = fs::read(right.join("map.mcap")).unwrap();
    merge_into(&right).assert_refused(&["would replace", "another folder"]);
    assert!(before == fs::read(right.join("map.mcap")).unwrap());
}

#[test]
fn parameters_that_are_none() {
    let (runs, case) = (Runs::get(), Case::new());
    let params = case.file("params.toml", b"[further]\nmax_closure = 2\n");
    let (left, right, out) = (runs.run("left"), runs.run("right"), case.out());
    loopbox(&["merge", arg(&left), arg(&right), "--out", arg(&out), "--params", arg(&params)])
        .assert_refused(&["params.toml", "max_closure", "loopbox params --merge"]);
    assert!(!out.exists());
}
