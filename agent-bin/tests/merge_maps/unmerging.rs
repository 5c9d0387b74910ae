//! Merged maps taken apart.

use crate::support::{Case, Runs, arg, loopbox};
use std::fs;

#[test]
fn a_merge_is_undone_bit_by_bit() {
    let (runs, case) = (Runs::get(), Case::new());
    case.merge(&[&runs.run("left"), &runs.run("right")]).assert_success();
    let (merged, apart) = (case.out(), case.path("apart"));
    let outcome = loopbox(&["unmerge", arg(&merged), "--out", arg(&apart)]);
    outcome.assert_success();
    let between = case.path("between");
    let outcome_between =
        loopbox(&["unmerge", arg(&merged), "--between", "right", "left", "--out", arg(&between)]);
    outcome_between.assert_success();
    for (name, file) in [("left", "map.mcap"), ("right", "map-right.mcap")] {
        let original = fs::read(runs.run(name).join("map.mcap")).unwrap();
        assert!(original == fs::read(apart.join(name).join("map.mcap")).unwrap(), "{name} is not as it was");
        assert!(original == fs::read(between.join(file)).unwrap(), "{file} is not as {name} was");
        assert!(outcome.stdout.contains(name) && outcome_between.stdout.contains(name), "{outcome:#?}");
    }
    let refused = |args: &[&str], words: &[&str]| {
        let out = case.path("refused");
        loopbox(&[&["unmerge", arg(&merged), "--out", arg(&out)], args].concat()).assert_refused(words);
        assert!(!out.exists());
    };
    refused(&["--between", "left", "nobody"], &["no agent \"nobody\"", "left and right"]);
    refused(&["--between", "left", "left"], &["not merged with itself"]);
    let inside = loopbox(&["unmerge", arg(&merged), "--out", arg(&merged)]);
    inside.assert_refused(&["would replace"]);
    assert!(merged.join("map.mcap").is_file());
}

#[test]
fn agents_that_were_never_merged_cannot_be_separated() {
    let (runs, case) = (Runs::get(), Case::new());
    let united = map::Map::unite(vec![runs.map("left"), runs.map("elsewhere")]).unwrap();
    let united = case.map("united.mcap", &united);
    let out = case.out();
    loopbox(&["unmerge", arg(&united), "--between", "left", "elsewhere", "--out", arg(&out)])
        .assert_refused(&["no closure joins left and elsewhere"]);
    let single = runs.run("left");
    loopbox(&["unmerge", arg(&single), "--out", arg(&out)]).assert_refused(&["one agent only", "left"]);
    assert!(!out.exists());
}
