//! Manifests: common maps of which the file is made when it is asked for.

use crate::support::{Case, Outcome, Runs, arg, loopbox};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Merges maps with these options into a folder of the case.
fn merge(case: &Case, maps: &[&Path], out: &str, options: &[&str]) -> (PathBuf, Outcome) {
    let out = case.path(out);
    let maps: Vec<&str> = maps.iter().map(|map| arg(map)).collect();
    let outcome = loopbox(&[&["merge"][..], &maps, &["--out", arg(&out)], options].concat());
    (out, outcome)
}

/// The bytes of the map at a path, as it is exported.
fn exported(case: &Case, map: &Path) -> Vec<u8> {
    let file = case.path("exported.mcap");
    loopbox(&["export", arg(map), "--mcap", arg(&file)]).assert_success();
    fs::read(file).unwrap()
}

/// What a manifest in a folder says besides where verdicts are.
fn content(folder: &Path) -> Value {
    let mut content: Value =
        serde_json::from_slice(&fs::read(folder.join("manifest.json")).unwrap()).unwrap();
    content.as_object_mut().unwrap().remove("verdicts");
    content
}

#[test]
fn a_manifest_makes_the_map_of_the_merge_to_the_byte() {
    let (runs, case) = (Runs::get(), Case::new());
    let maps = [&*runs.run("right"), &runs.run("elsewhere"), &runs.run("left")];
    for (name, options) in
        [("jointly", &[][..]), ("by-closures", &["--no-optimise"]), ("paper", &["--method", "loop-box"])]
    {
        let (out, outcome) = merge(&case, &maps, name, options);
        outcome.assert_success();
        let written = fs::read(out.join("map.mcap")).unwrap();
        assert!(written == exported(&case, &out.join("manifest.json")), "{name}");
        let (small, outcome) =
            merge(&case, &maps, &format!("{name}-small"), &[options, &["--no-map"]].concat());
        outcome.assert_success();
        assert!(outcome.stdout.contains("manifest.json: right and left\n"), "{outcome:#?}");
        let mut names: Vec<_> =
            fs::read_dir(&small).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["manifest.json", "verdicts"]);
        assert_eq!(content(&out), content(&small));
        assert!(written == exported(&case, &small), "{name}");
        // All that a merge writes is made of it, without looking at a pair again.
        let (made, outcome) = merge(&case, &[&small], &format!("{name}-made"), options);
        outcome.assert_success();
        assert!(!outcome.stderr.contains("looking where"), "{outcome:#?}");
        for file in ["map.mcap", "map-elsewhere.mcap", "cloud.ply", "trajectory-left.txt"] {
            assert!(
                fs::read(out.join(file)).unwrap() == fs::read(made.join(file)).unwrap(),
                "{name}: {file}"
            );
        }
    }
}

#[test]
fn commands_that_read_maps_read_manifests() {
    let (runs, case) = (Runs::get(), Case::new());
    let (out, outcome) = merge(&case, &[&runs.run("left"), &runs.run("right")], "both", &[]);
    outcome.assert_success();
    let (file, manifest) = (out.join("map.mcap"), out.join("manifest.json"));
    let summary = |map: &Path| {
        let outcome = loopbox(&["info", arg(map), "--json"]);
        outcome.assert_success();
        let mut content: Value = serde_json::from_str(&outcome.stdout).unwrap();
        assert!(content.as_object_mut().unwrap().remove("file_bytes").is_some(), "{content:#}");
        content
    };
    assert_eq!(summary(&file), summary(&manifest));
    let (apart, name) = (case.path("apart"), Path::new("left").join("map.mcap"));
    loopbox(&["unmerge", arg(&manifest), "--out", arg(&apart)]).assert_success();
    assert!(fs::read(apart.join(&name)).unwrap() == fs::read(runs.run("left").join("map.mcap")).unwrap());
    let localised = |map: &Path, name: &str| {
        let out = case.path(name);
        let recording = runs.truth("left").parent().unwrap().to_owned();
        loopbox(&["run", arg(&recording), "--localise", arg(map), "--out", arg(&out), "--quiet"])
            .assert_success();
        fs::read(out.join("trajectory.txt")).unwrap()
    };
    assert!(localised(&file, "in-map") == localised(&manifest, "in-manifest"));
}

/// Only pairs with the new map are looked at, and what comes of it is what comes of all at once.
#[test]
fn a_manifest_grows_by_what_is_new() {
    let (runs, case) = (Runs::get(), Case::new());
    let [left, right, elsewhere] = ["left", "right", "elsewhere"].map(|name| runs.run(name));
    let (two, outcome) = merge(&case, &[&left, &right], "two", &["--no-map"]);
    outcome.assert_success();
    let before = fs::read_dir(two.join("verdicts")).unwrap().count();
    let (three, outcome) = merge(&case, &[&two, &elsewhere], "three", &["--no-map"]);
    outcome.assert_success();
    let looked: Vec<_> = outcome.stderr.lines().filter(|line| line.starts_with("looking where")).collect();
    assert_eq!(looked, ["looking where left and elsewhere met", "looking where right and elsewhere met"]);
    assert_eq!((before, fs::read_dir(two.join("verdicts")).unwrap().count()), (1, 3));
    let (all, outcome) = merge(&case, &[&left, &right, &elsewhere], "all", &[]);
    outcome.assert_success();
    assert_eq!(content(&three), content(&all));
    assert!(exported(&case, &three) == fs::read(all.join("map.mcap")).unwrap());
    // In its own folder it grows as well, and the maps of two manifests are none twice.
    let (_, outcome) = merge(&case, &[&two, &three], "two", &["--no-map"]);
    outcome.assert_success();
    assert_eq!(content(&two), content(&three));
}

/// Repeated it looks at no pair, and grown by a map only at pairs with that.
#[test]
fn a_merge_that_writes_a_map_keeps_its_verdicts_too() {
    let (runs, case) = (Runs::get(), Case::new());
    let [left, right, elsewhere] = ["left", "right", "elsewhere"].map(|name| runs.run(name));
    let looked = |outcome: &Outcome| {
        let lines = outcome.stderr.lines().filter_map(|line| line.strip_prefix("looking where "));
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    let maps: [&Path; 2] = [&left, &right];
    let (both, outcome) = merge(&case, &maps, "both", &[]);
    outcome.assert_success();
    assert_eq!((looked(&outcome).len(), fs::read_dir(both.join("verdicts")).unwrap().count()), (1, 1));
    let before = fs::read(both.join("map.mcap")).unwrap();
    let (_, again) = merge(&case, &maps, "both", &[]);
    again.assert_success();
    assert!(looked(&again).is_empty(), "{again:#?}");
    assert!(before == fs::read(both.join("map.mcap")).unwrap(), "another map");
    let (_, grown) = merge(&case, &[&both.join("manifest.json"), &elsewhere], "grown", &[]);
    grown.assert_success();
    assert_eq!(looked(&grown), ["left and elsewhere met", "right and elsewhere met"]);
    // What did not meet is not looked at again either.
    let apart: [&Path; 2] = [&left, &elsewhere];
    let (strangers, outcome) = merge(&case, &apart, "strangers", &[]);
    outcome.assert_ended(3, &["no two of the maps met"]);
    assert_eq!(fs::read_dir(&strangers).unwrap().count(), 1, "verdicts alone");
    let (_, again) = merge(&case, &apart, "strangers", &[]);
    again.assert_ended(3, &["no two of the maps met"]);
    assert!(looked(&again).is_empty(), "{again:#?}");
}

#[test]
fn a_map_that_is_left_out_leaves_nothing_behind() {
    let (runs, case) = (Runs::get(), Case::new());
    let [left, right, elsewhere] = ["left", "right", "elsewhere"].map(|name| runs.run(name));
    let (three, outcome) = merge(&case, &[&left, &elsewhere, &right], "three", &["--no-map"]);
    outcome.assert_success();
    let (without, outcome) = merge(&case, &[&three], "without", &["--without", "elsewhere"]);
    outcome.assert_success();
    assert!(!outcome.stderr.contains("looking where"), "{outcome:#?}");
    let (two, outcome) = merge(&case, &[&left, &right], "two", &[]);
    outcome.assert_success();
    assert_eq!(content(&without), content(&two));
    assert!(fs::read(without.join("map.mcap")).unwrap() == fs::read(two.join("map.mcap")).unwrap());
    let refused = |names: &[&str], words: &[&str]| {
        let options: Vec<&str> = names.iter().flat_map(|name| ["--without", name]).collect();
        merge(&case, &[&three], "none", &options).1.assert_refused(words);
        assert!(!case.path("none").exists());
    };
    refused(&["nobody"], &["--without nobody", "no map of a manifest"]);
    refused(&["left", "right"], &["one map"]);
}

#[test]
fn a_map_that_is_missing_or_another_is_named_with_what_to_do() {
    let (runs, case) = (Runs::get(), Case::new());
    let moved = case.map("moved.mcap", &runs.map("right"));
    let (both, outcome) = merge(&case, &[&runs.run("left"), &moved], "both", &["--no-map"]);
    outcome.assert_success();
    let refuse = |words: &[&str]| {
        let words = [words, &["moved.mcap", "manifest.json", "--without right"]].concat();
        loopbox(&["info", arg(&both)]).assert_refused(&words);
        let (out, outcome) = merge(&case, &[&both, &runs.run("elsewhere")], "more", &[]);
        outcome.assert_refused(&words);
        assert!(!out.exists());
    };
    let bytes = fs::read(&moved).unwrap();
    fs::write(&moved, &bytes[..bytes.len() - 1]).unwrap();
    refuse(&["is not the map that", "SHA-256"]);
    fs::remove_file(&moved).unwrap();
    refuse(&["is missing"]);
    fs::write(&moved, &bytes).unwrap();
    loopbox(&["info", arg(&both)]).assert_success();
}

#[test]
fn a_manifest_that_is_damaged_or_later_is_named() {
    let (runs, case) = (Runs::get(), Case::new());
    let (both, outcome) = merge(&case, &[&runs.run("left"), &runs.run("right")], "both", &["--no-map"]);
    outcome.assert_success();
    let file = both.join("manifest.json");
    let text = fs::read_to_string(&file).unwrap();
    let later = text.replace("\"loopbox_manifest\": 1", "\"loopbox_manifest\": 7");
    let another = text.replacen("\"map\": 1", "\"map\": 9", 1);
    let no_number = text.replacen("\"pose\": \"", "\"pose\": \"x", 1);
    let no_keyframe = text.replacen("\"keyframe\": ", "\"keyframe\": 99", 1);
    for (damaged, word) in [
        (later, "format 7"),
        (another, "damaged manifest"),
        (no_number, "8 numbers"),
        (no_keyframe, "has keyframe 99"),
    ] {
        assert!(damaged != text, "{word}");
        fs::write(&file, damaged).unwrap();
        loopbox(&["info", arg(&both)]).assert_refused(&["manifest.json", word]);
    }
}
