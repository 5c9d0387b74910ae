//! Verdicts on pairs, found apart from the merge and kept for it.

use crate::support::{Case, Outcome, Runs, arg, loopbox};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

fn verdict(maps: [&Path; 2], verdicts: &Path) -> Outcome {
    loopbox(&["verdict", arg(maps[0]), arg(maps[1]), "--verdicts", arg(verdicts)])
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(path).unwrap()))
        .collect()
}

#[test]
fn a_verdict_is_the_same_to_the_byte_alone_among_others_and_in_either_order() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, right, elsewhere) = (runs.run("left"), runs.run("right"), runs.run("elsewhere"));
    let [first, turned, all] = ["first", "turned", "all"].map(|name| case.path(name));
    let outcome = verdict([&left, &right], &first);
    outcome.assert_success();
    for word in ["left + right: accepted, travelling opposite ways", "closures join them"] {
        assert!(outcome.stdout.contains(word), "{outcome:#?}");
    }
    verdict([&right.join("map.mcap"), &left], &turned).assert_success();
    let one = files(&first);
    assert!(one.len() == 1 && one == files(&turned), "{:?}", one.keys());

    // A merge finds and keeps the same, among others.
    let out = case.out();
    let merge = |verdicts: &Path| {
        let maps = [arg(&elsewhere), arg(&right), arg(&left)];
        let options = ["--out", arg(&out), "--verdicts", arg(verdicts)];
        let outcome = loopbox(&[&["merge"][..], &maps, &options].concat());
        outcome.assert_success();
        (outcome, fs::read(out.join("map.mcap")).unwrap())
    };
    let (found, map) = merge(&all);
    let kept = files(&all);
    assert_eq!(kept.len(), 3);
    assert!(one.iter().all(|(name, bytes)| kept.get(name) == Some(bytes)), "{:?}", kept.keys());

    // What is kept is not looked at again, and comes to the same.
    let (again, same) = merge(&all);
    assert!(found.stderr.contains("looking where right and left met"), "{found:#?}");
    assert!(!again.stderr.contains("looking where"), "{again:#?}");
    assert!(map == same && files(&all) == kept, "another map, or other verdicts");
    let output = |outcome: &Outcome| {
        let lines = outcome.stdout.lines().filter(|line| !line.contains(" s in all"));
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(output(&found), output(&again));
    let without = case.merge(&[&elsewhere, &right, &left]);
    without.assert_success();
    assert!(map == fs::read(out.join("map.mcap")).unwrap(), "verdicts make another map");
}

#[test]
fn maps_of_two_places_are_not_joined_and_the_verdict_is_kept() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, elsewhere) = (runs.run("left"), runs.run("elsewhere"));
    let kept = case.path("verdicts");
    let outcome = verdict([&left, &elsewhere], &kept);
    outcome.assert_ended(3, &["the maps are not joined", "left + elsewhere: refused: "]);
    assert_eq!(files(&kept).len(), 1);
    let args = ["verdict", arg(&elsewhere), arg(&left), "--verdicts", arg(&kept), "--json", "--quiet"];
    let outcome = loopbox(&args);
    assert_eq!(outcome.code, Some(3));
    let numbers: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!((numbers.as_array().unwrap().len(), &numbers[0]["accepted"]), (1, &Value::Bool(false)));
}

/// A person settles a pair that the surface leaves open; that is kept with the verdict, and a pair without a common pose stays apart.
#[test]
fn a_person_confirms_a_pair_that_stays_undecided() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, right, elsewhere) = (runs.run("left"), runs.run("right"), runs.run("elsewhere"));
    let kept = case.path("verdicts");
    // What is asked of the surface here none reaches.
    let strict = ["meeting.acceptance.min_untold_change=0", "further.place.prior.certainty=0.9999999"];
    let judge = |maps: [&Path; 2], more: &[&str]| {
        let asked =
            [&["verdict", arg(maps[0]), arg(maps[1]), "--set", strict[0], "--set", strict[1]][..], more];
        loopbox(&asked.concat())
    };
    let open = judge([&left, &right], &["--verdicts", arg(&kept)]);
    open.assert_ended(
        3,
        &["left + right: undecided", "does not tell one place from two", "--confirm left+right"],
    );

    let confirm = ["--verdicts", arg(&kept), "--confirm", "right+left"];
    let confirmed = judge([&left, &right], &confirm);
    confirmed.assert_success();
    for word in ["left + right: accepted", "confirmed by a person"] {
        assert!(confirmed.stdout.contains(word), "{confirmed:#?}");
    }
    let again = judge([&right, &left], &["--verdicts", arg(&kept), "--json", "--quiet"]);
    again.assert_success();
    let record: Value = serde_json::from_str(&again.stdout).unwrap();
    assert_eq!((&record[0]["confirmed"], &record[0]["answer"]), (&Value::Bool(true), &"same".into()));

    // A common map that grows keeps it too.
    let merge = |maps: [&Path; 2], out: &str, more: &[&str]| {
        let (out, sets) = (case.path(out), ["--set", strict[0], "--set", strict[1], "--no-map"]);
        let asked = [&["merge", arg(maps[0]), arg(maps[1]), "--out", arg(&out)][..], &sets, more].concat();
        let outcome = loopbox(&asked);
        outcome.assert_success();
        assert!(outcome.stdout.contains("confirmed by a person"), "{outcome:#?}");
        out
    };
    let two = merge([&left, &right], "two", &["--confirm", "left+right"]);
    merge([&two, &elsewhere], "three", &[]);

    judge([&left, &elsewhere], &["--confirm", "left+elsewhere"])
        .assert_ended(1, &["--confirm left+elsewhere: they cannot be joined", "no pose between the maps"]);
    judge([&left, &right], &["--confirm", "left+nobody"]).assert_ended(1, &["they are called left, right"]);
}

/// Whoever is first keeps it; the others find the same.
#[test]
fn several_processes_share_a_folder_of_verdicts() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, right, kept) = (runs.run("left"), runs.run("right"), case.path("verdicts"));
    let begin = |maps: [&Path; 2]| {
        let args = ["verdict", arg(maps[0]), arg(maps[1]), "--quiet", "--verdicts", arg(&kept)];
        Command::new(env!("CARGO_BIN_EXE_loopbox")).args(args).spawn().expect("loopbox starts")
    };
    let mut killed = begin([&left, &right]);
    let all = [begin([&left, &right]), begin([&right, &left]), begin([&left, &right])];
    killed.kill().unwrap();
    killed.wait().unwrap();
    for mut one in all {
        assert!(one.wait().unwrap().success());
    }
    let verdicts = files(&kept).into_keys().filter(|name| name.ends_with(".verdict")).count();
    assert_eq!(verdicts, 1, "{:?}", files(&kept).keys());
}

#[test]
fn a_damaged_verdict_is_named_with_what_to_do() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, elsewhere, kept) = (runs.run("left"), runs.run("elsewhere"), case.path("verdicts"));
    verdict([&left, &elsewhere], &kept);
    let name = files(&kept).into_keys().next().unwrap();
    let bytes = fs::read(kept.join(&name)).unwrap();
    fs::write(kept.join(&name), &bytes[..bytes.len() / 2]).unwrap();
    verdict([&left, &elsewhere], &kept).assert_refused(&[&name, "delete it, and it is found again"]);
    fs::remove_file(kept.join(&name)).unwrap();
    verdict([&left, &elsewhere], &kept);
    assert!(files(&kept)[&name] == bytes);
}

#[test]
fn pairs_worth_a_verdict_are_listed_the_likeliest_first() {
    let runs = Runs::get();
    let maps = [runs.run("elsewhere"), runs.run("left"), runs.run("right")];
    let [elsewhere, left, right] = maps.each_ref().map(|map| arg(map));
    let outcome = loopbox(&["propose", elsewhere, left, right, "--quiet"]);
    outcome.assert_success();
    let first: Vec<&str> = outcome.stdout.lines().next().unwrap().split('\t').collect();
    assert_eq!(first[1..], [left, right], "{outcome:#?}");
    assert!(first[0].parse::<f32>().is_ok_and(|score| (0.0..=1.0).contains(&score)), "{outcome:#?}");
    let outcome = loopbox(&["propose", elsewhere, left, right, "--json", "--quiet"]);
    let pairs: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!((&pairs[0]["maps"][0], &pairs[0]["maps"][1]), (&left.into(), &right.into()));
    assert!(pairs[0]["places"].as_u64().is_some_and(|places| places > 0), "{pairs:#}");
    loopbox(&["propose", left]).assert_refused(&["there is nothing to merge it with"]);
}
