//! Maps that met, and maps that did not.

use crate::documented::assert_documented;
use crate::support::{Case, Outcome, Runs, arg, loopbox};
use eval::{AgentTracks, Options, evaluate_agents, read_trajectory};
use map::{EdgeKind, load_map};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// What the error of the other agent's trajectory may be, in parts of its path of 4.7 m, after aligning the first.
/// Reached is 0.0006.
const ERROR_SHARE: f64 = 0.004;

/// By how much the other agent's scale may be off, percent. Reached is 0.07.
const SCALE_PERCENT: f64 = 0.5;

/// Fails unless both trajectories lie right in one frame.
fn assert_accurate(out: &Path) {
    let runs = Runs::get();
    let tracks = ["left", "right"].map(|name| AgentTracks {
        estimate: read_trajectory(&out.join(format!("trajectory-{name}.txt"))).expect("it was written"),
        truth: read_trajectory(&runs.truth(name)).expect("it was written"),
        frames: None,
    });
    let found = evaluate_agents(tracks.into(), &Options::default()).expect("the trajectories match");
    let right = &found.agents[1];
    let error = right.evaluation.ate.rmse;
    let scale = right.merge.expect("the paths show it").scale_percent;
    eprintln!("error of the other agent {error:.4} m, scale {scale:+.3} %");
    assert!(error <= ERROR_SHARE * 4.7, "{error} m");
    assert!(scale.abs() <= SCALE_PERCENT, "{scale} %");
}

fn merged_left_and_right(case: &Case) -> Outcome {
    let runs = Runs::get();
    case.merge(&[&runs.run("left"), &runs.run("right").join("map.mcap")])
}

#[test]
fn two_agents_that_met_get_one_map() {
    let case = Case::new();
    let outcome = merged_left_and_right(&case);
    outcome.assert_success();
    for word in ["left + right: accepted", "opposite ways", "γ", "σ*", "closures join", "left and right"] {
        assert!(outcome.stdout.contains(word), "nothing is said of \"{word}\"\n{outcome:#?}");
    }
    for word in ["reading", "looking where left and right met", "making the common map", "writing"] {
        assert!(outcome.stderr.contains(word), "nothing is said of \"{word}\"\n{outcome:#?}");
    }
    let files = ["cloud.ply", "map.mcap", "merge.json", "trajectory-left.txt", "trajectory-right.txt"];
    assert!(files.iter().all(|file| case.results().contains(&(*file).to_owned())), "{:?}", case.results());
    assert_accurate(&case.out());
    let united = load_map(case.out().join("map.mcap")).unwrap().map;
    assert_eq!(united.agents.values().map(|info| &*info.name).collect::<Vec<_>>(), ["left", "right"]);
    assert!(united.edges.iter().any(|edge| edge.kind == EdgeKind::Merge));
    assert!(["program", "maps", "parameters"].iter().all(|key| united.merge_provenance.contains_key(*key)));
    check_numbers(&case);
    check_other_commands(&case);
    check_again(&case);
}

#[test]
fn a_common_map_is_optimised_jointly_unless_it_is_not_wanted_or_too_large() {
    let (case, plain, runs) = (Case::new(), Case::new(), Runs::get());
    let maps = ["left", "right"].map(|name| runs.run(name));
    let out = case.out();
    let args = ["merge", arg(&maps[0]), arg(&maps[1]), "--out", arg(&out)];
    let outcome = loopbox(&args);
    outcome.assert_success();
    assert!(outcome.stderr.contains("optimising the common map jointly"), "{outcome:#?}");
    assert_accurate(&out);
    let numbers: Value = serde_json::from_slice(&fs::read(out.join("merge.json")).unwrap()).unwrap();
    assert_eq!(numbers["params"]["joint"], true);
    let without = |more: &[&str]| {
        let out = plain.out();
        let args = ["merge", arg(&maps[0]), arg(&maps[1]), "--force", "--out", arg(&out)];
        let outcome = loopbox(&[&args[..], more].concat());
        outcome.assert_success();
        assert!(!outcome.stderr.contains("optimising") || more[0] == "--set", "{outcome:#?}");
        (load_map(out.join("map.mcap")).expect("it was written").map.keyframes, outcome.stderr)
    };
    let (keyframes, output) = without(&["--set", "joint_keyframes=3"]);
    assert!(output.contains("is not optimised jointly") && output.contains("--optimise does it"), "{output}");
    assert!(keyframes == without(&["--no-optimise"]).0);
    assert!(keyframes == without(&["--set", "joint=false"]).0);
    let [optimised, merged] =
        [&out, &plain.out()].map(|out| load_map(out.join("map.mcap")).expect("it was written").map);
    assert!(optimised.edges == merged.edges && optimised.agents == merged.agents);
    let moved = merged
        .keyframes
        .iter()
        .filter(|(id, keyframe)| optimised.keyframes[id].world_from_keyframe != keyframe.world_from_keyframe);
    assert!(moved.count() > merged.keyframes.len() / 2, "nothing moved");
    assert!(optimised.split() == merged.split(), "the agents' own maps come out of it bit by bit");
    let outcome =
        loopbox(&["merge", "--optimise", "--method", "pcr-pro", arg(&maps[0]), arg(&maps[1]), "--out", "x"]);
    assert!(outcome.code == Some(1) && outcome.stderr.contains("--method direct"), "{outcome:#?}");
    // What is compared with it is not optimised, and its record says so.
    let out = plain.out();
    let args = ["merge", "--method", "pcr-pro", arg(&maps[0]), arg(&maps[1]), "--force", "--json", "--out"];
    let outcome = loopbox(&[&args[..], &[arg(&out)]].concat());
    outcome.assert_success();
    let numbers: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!(numbers["params"]["joint"], false, "{}", outcome.stderr);
}

/// The numbers hold what the verdict rests on.
fn check_numbers(case: &Case) {
    let text = fs::read_to_string(case.out().join("merge.json")).unwrap();
    let numbers: Value = serde_json::from_str(&text).unwrap();
    assert_documented(&numbers);
    let pair = &numbers["encounters"][0];
    assert_eq!(pair["closure"]["travel"], "opposite");
    assert!(pair["links"].as_u64().is_some_and(|links| links >= 2), "{pair:#}");
    assert!(pair["closure"]["scale"]["scale"].as_f64().is_some_and(|scale| scale > 0.0));
    assert!(pair["closure"]["evidence"]["matches"].as_u64().is_some_and(|matches| matches >= 60));
    assert!(pair["tried"].as_array().is_some_and(|tested| tested[0]["outcome"] == "accepted"));
    for part in ["places", "meeting", "method"] {
        assert!(pair["seconds"][part].as_f64().is_some_and(|seconds| seconds >= 0.0));
    }
    let right = &numbers["agents"][1];
    assert_eq!((&right["root"], &right["path"]), (&"left".into(), &serde_json::json!(["left", "right"])));
    assert!(right["deviations"]["scale"].as_f64().is_some_and(|deviation| deviation > 0.0));
    assert_eq!(numbers["groups"][0]["map"], "map.mcap");
    assert_eq!(numbers["groups"].as_array().map(Vec::len), Some(1));
    assert!(numbers["groups"][0]["pose_graph"]["final_cost"].is_number());
    assert!(numbers["cost"]["peak_memory_bytes"].as_u64().is_some_and(|bytes| bytes > 1 << 20));
    let names: Vec<&str> = numbers["files"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    assert!(names.iter().all(|name| case.out().join(name).is_file()), "{names:?}");
    let written = case.results().into_iter().filter(|name| name != "verdicts").count();
    assert_eq!(names.len(), written, "{names:?} {:?}", case.results());
}

/// The common map is a map like any other.
fn check_other_commands(case: &Case) {
    let map = case.out().join("map.mcap");
    let info = loopbox(&["info", arg(&map)]);
    info.assert_success();
    assert!(info.stdout.contains("left") && info.stdout.contains("right"), "{info:#?}");
    let (tum, ply) = (case.path("exported.txt"), case.path("exported.ply"));
    let export = loopbox(&["export", arg(&map), "--tum", arg(&tum), "--ply", arg(&ply)]);
    export.assert_success();
    assert_eq!(fs::read(ply).unwrap(), fs::read(case.out().join("cloud.ply")).unwrap());
}

/// A second merge replaces the results of the first, and gives the same.
fn check_again(case: &Case) {
    let stale = case.out().join("map-of-old.mcap");
    let numbers = case.out().join("merge.json");
    fs::write(&stale, b"old").unwrap();
    let text = fs::read_to_string(&numbers)
        .unwrap()
        .replace("\"cloud.ply\",", "\"cloud.ply\", \"map-of-old.mcap\",");
    fs::write(&numbers, text).unwrap();
    let first = fs::read(case.out().join("map.mcap")).unwrap();
    merged_left_and_right(case).assert_success();
    assert!(!stale.exists(), "{:?}", case.results());
    assert!(first == fs::read(case.out().join("map.mcap")).unwrap(), "the same maps give another map");
}

/// What is thought of two maps does not depend on which is given first, nor on which others are in the command: not the decision, nor
/// any number of it.
#[test]
fn the_order_of_the_maps_and_other_maps_change_no_verdict() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, right, elsewhere, out) =
        (runs.run("left"), runs.run("right"), runs.run("elsewhere"), case.out());
    let sets: [&[&Path]; 3] = [&[&left, &right], &[&right, &left], &[&elsewhere, &right, &left]];
    let tested = sets.map(|maps| {
        let mut args = vec!["merge", "--out", arg(&out), "--json", "--quiet"];
        args.extend(maps.iter().map(|map| arg(map)));
        let outcome = loopbox(&args);
        outcome.assert_success();
        let mut numbers: Value = serde_json::from_str(&outcome.stdout).unwrap();
        let pair_results = numbers["encounters"].as_array_mut().expect("every pair");
        let of_both = |pair: &&mut Value| ["target", "source"].iter().all(|side| pair[*side] != "elsewhere");
        let pair = pair_results.iter_mut().find(of_both).expect("of left and right");
        assert!(pair["answer"].as_str().is_some_and(|answer| answer.starts_with("same")), "{pair:#}");
        assert!(pair["place"]["ln_ratio"].is_number(), "{pair:#}");
        assert_eq!(pair["verdict"], "accepted");
        let lines =
            pair["tried"].as_array().and_then(|tested| tested.iter().find_map(|t| t["lines"].as_array()));
        assert!(lines.is_some_and(|lines| !lines.is_empty()), "{pair:#}");
        ["target", "source", "tried", "closure", "answer", "place", "pieces"].map(|part| pair[part].take())
    });
    assert_eq!(tested[0], tested[1]);
    assert_eq!(tested[0], tested[2]);
}

#[test]
fn maps_that_share_nothing_are_refused_with_the_reason() {
    let (runs, case) = (Runs::get(), Case::new());
    let outcome = case.merge(&[&runs.run("left"), &runs.run("elsewhere")]);
    outcome.assert_ended(3, &["no two of the maps met", "left + elsewhere: refused: "]);
    assert_eq!(case.results(), ["verdicts"]);
}

#[test]
fn a_merge_that_is_refused_keeps_the_common_map_of_before() {
    let (runs, case) = (Runs::get(), Case::new());
    let (left, elsewhere) = (runs.run("left"), runs.run("elsewhere"));
    merged_left_and_right(&case).assert_success();
    let content = || -> Vec<(String, Vec<u8>)> {
        let results = case.results().into_iter().filter(|name| name != "verdicts");
        results.map(|name| (name.clone(), fs::read(case.out().join(name)).unwrap())).collect()
    };
    let before = content();
    let outcome = loopbox(&["merge", arg(&left), arg(&elsewhere), "--out", arg(&case.out()), "--json"]);
    outcome.assert_ended(3, &["no two of the maps met"]);
    let numbers: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert!(numbers["encounters"][0]["refusal"].is_string(), "{numbers:#}");
    assert!(before == content(), "{:?}", case.results());
    let run = loopbox(&["merge", arg(&left), arg(&elsewhere), "--out", arg(&runs.run("right"))]);
    run.assert_refused(&["holds the results of a run over", "--force"]);
}

#[test]
fn a_third_map_that_met_nobody_is_named_and_stays_apart() {
    let (runs, case) = (Runs::get(), Case::new());
    let outcome = case.merge(&[&runs.run("left"), &runs.run("elsewhere"), &runs.run("right")]);
    outcome.assert_success();
    assert!(outcome.stderr.contains("warning: elsewhere met none of the others"), "{outcome:#?}");
    assert!(outcome.stdout.contains("map-elsewhere.mcap"), "{outcome:#?}");
    let alone = fs::read(case.out().join("map-elsewhere.mcap")).unwrap();
    assert!(alone == fs::read(runs.run("elsewhere").join("map.mcap")).unwrap(), "its map is another one");
    assert_accurate(&case.out());
}

#[test]
fn numbers_are_printed_on_request_and_parameters_are_taken() {
    let (runs, case) = (Runs::get(), Case::new());
    let params = case.file("params.toml", b"[further]\nmax_closures = 0\n");
    let (left, right, out) = (runs.run("left"), runs.run("right"), case.out());
    let args =
        ["merge", arg(&left), arg(&right), "--out", arg(&out), "--json", "--quiet", "--params", arg(&params)];
    let outcome = loopbox(&args);
    outcome.assert_success();
    assert_eq!(outcome.stderr, "");
    let numbers: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!(numbers["params"]["further"]["max_closures"], 0);
    assert!(numbers["encounters"][0]["links"].as_u64().is_some_and(|links| links <= 3));
}

/// One of two agents knows its unit; the common map is in metres, whichever is given first.
#[test]
fn what_meets_a_map_in_metres_gets_metres() {
    let (runs, case) = (Runs::get(), Case::new());
    let (truth, metric) = (runs.truth("right"), case.out().with_file_name("right.mcap"));
    let run = runs.run("right");
    let outcome = loopbox(&["export", arg(&run), "--track", arg(&truth), "--mcap", arg(&metric)]);
    outcome.assert_success();
    assert!(!runs.map("right").is_metric() && load_map(&metric).unwrap().map.is_metric());
    let out = case.out();
    case.merge(&[&runs.run("left"), &metric]).assert_success();
    let united = load_map(out.join("map.mcap")).unwrap().map;
    assert!(united.is_metric());
    let left = out.join("trajectory-left.txt");
    let outcome =
        loopbox(&["eval", arg(&left), "--gt", arg(&runs.truth("left")), "--align", "none", "--json"]);
    let found: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert!(found["ate"]["rmse"].as_f64().unwrap() < 0.1, "{found:#}");
}
