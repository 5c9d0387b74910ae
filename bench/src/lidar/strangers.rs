//! Many pairs of maps that have nothing in common, and of maps that overlap: none may be merged wrongly, and most that
//! overlap should be.

use super::parts::{Part, Whole, cut};
use super::program::Program;
use super::truth::Truth;
use super::{METHODS, Recording, mapped};
use anyhow::{Context, Result};
use geometry::Se3;
use loopbox_tests::lidar::{walk, write_recording};
use loopbox_tests::lidar_sites::{Site, hall, office, warehouse};
use serde_json::Value;
use std::fmt::Write;

/// A merge is wrong when it misplaces keyframes by more, metres: less than any repetition, more than any drift over a
/// stretch.
const WRONG: f64 = 0.3;
/// From this overlap on maps should be merged.
const SAME: f64 = 0.3;
/// Below this they have nothing in common.
const NOTHING: f64 = 0.02;

/// The rendered sites of a measurement by their names: two floors of a warehouse, two of an office, and a hall; `first` is
/// the number of the first.
fn sites(first: u64) -> Vec<(String, Site)> {
    let mut found = vec![(format!("hall-{first}"), hall(first))];
    for number in [first, first + 1] {
        found.push((format!("warehouse-{first}-{number}"), warehouse(first, number)));
        found.push((format!("office-{first}-{number}"), office(first, number)));
    }
    found
}

/// Numbers of sites from one lot to the next.
const SITES: u64 = 100;

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Right,
    Wrong,
    Undecided,
    Refused,
}

/// A pair of parts.
struct Pair {
    kind: &'static str,
    overlap: f64,
    outcome: Outcome,
}

/// Cuts the recordings into stretches, those tracked also mirrored, and merges every two; returns the table and how many were
/// merged wrongly.
pub fn of_recordings(program: &Program, recordings: &[Recording]) -> Result<(String, usize)> {
    let home = program.at("parts");
    let mut parts = Vec::new();
    for recording in recordings {
        // The run that drew this recording's figures, where there is one, else a new one.
        let program = Program { reuse: true, ..*program };
        let map = mapped(&program, recording, METHODS[0])?.join("map.mcap");
        let truth = Truth::of(&recording.path)?;
        let world = recording.name.split('/').next().unwrap_or_default();
        let whole = Whole { map: &map, truth: &truth, name: &recording.name, world };
        parts.extend(cut(&whole, &home, false)?);
        if !recording.given {
            parts.extend(cut(&whole, &home, true)?);
        }
    }
    Ok(table_of(&merged(program, &parts, "recorded")?))
}

/// Records drives through rendered sites of two lots, which the seed names, and merges every two stretches of a lot.
pub fn of_sites(program: &Program, seed: u64) -> Result<(String, usize)> {
    let mut pairs = Vec::new();
    let last = seed.saturating_mul(2);
    for lot in [last.saturating_sub(1), last] {
        let mut parts = Vec::new();
        for (name, site) in sites(lot.saturating_mul(SITES)) {
            parts.extend(of_site(program, &name, &site)?);
        }
        pairs.extend(merged(program, &parts, &format!("rendered-{lot}"))?);
    }
    Ok(table_of(&pairs))
}

/// The table, and how many were merged wrongly.
fn table_of(pairs: &[Pair]) -> (String, usize) {
    (table(pairs), pairs.iter().filter(|pair| pair.outcome == Outcome::Wrong).count())
}

/// Records drives through a site, maps them and cuts the maps.
fn of_site(program: &Program, name: &str, site: &Site) -> Result<Vec<Part>> {
    let mut parts = Vec::new();
    for (number, path) in site.paths.iter().enumerate() {
        let drive = format!("{}-{number}", name.replace(' ', "-"));
        let folder = program.at(&format!("site-{drive}"));
        if !(program.reuse && folder.join("groundtruth.txt").is_file()) {
            let (pose, duration) = walk(path);
            write_recording(&folder, &site.boxes, pose, duration)?;
        }
        let out = program.run(&folder, &drive, &[])?;
        let truth = Truth::of(&folder)?;
        let errors = truth.errors(&out.join("trajectory.txt"))?;
        eprintln!("{drive}: ATE {:.4} m", errors.ate);
        let whole = Whole { map: &out.join("map.mcap"), truth: &truth, name: &drive, world: name };
        parts.extend(cut(&whole, &program.at("parts"), false)?);
        // Scans are large, and can be made again.
        for scans in ["velodyne", "times", "rings"] {
            std::fs::remove_dir_all(folder.join(scans)).ok();
        }
    }
    Ok(parts)
}

/// Merges every two parts and judges each pair.
fn merged(program: &Program, parts: &[Part], lot: &str) -> Result<Vec<Pair>> {
    let out = program.at(&format!("strangers-{lot}")).display().to_string();
    let files: Vec<String> = parts.iter().map(|part| part.file.display().to_string()).collect();
    let mut args = vec!["merge"];
    args.extend(files.iter().map(String::as_str));
    args.extend(["--out", &out, "--force", "--json", "--quiet"]);
    let (_, record) = program.json(&args)?;
    let pair_results = record["encounters"].as_array().context("the merge tells of no pairs")?;
    let order = (1..parts.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    Ok(order
        .zip(pair_results)
        .filter_map(|((a, b), output)| evaluated(&parts[a], &parts[b], output))
        .collect())
}

/// Judges what is said of two parts; nothing of two that are mirrored, which are a pair that was counted.
fn evaluated(a: &Part, b: &Part, output: &Value) -> Option<Pair> {
    let mirrored = [a, b].map(|part| part.world.starts_with("mirrored "));
    if mirrored == [true, true] {
        return None;
    }
    let overlap = a.overlap(b);
    let (decision, reason) = (output["decision"].as_str()?, output["reason"].as_str()?);
    // Of a merge that the others outvote it is asked what became of the pair by itself.
    let accepted = decision == "accepted" || reason.starts_with("taken back");
    let numbers: Vec<f64> = output["best"]["first_from_second"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_f64)
        .collect();
    let pose = <[f64; 7]>::try_from(numbers).ok().map(Se3::from_tum);
    let off = pose.filter(|_| a.world == b.world).map_or(f64::INFINITY, |pose| a.misplaced(b, &pose));
    let outcome = match (accepted, decision) {
        (true, _) if off < WRONG => Outcome::Right,
        (true, _) => Outcome::Wrong,
        (false, "undecided") => Outcome::Undecided,
        _ => Outcome::Refused,
    };
    let best = |key: &str| output["best"][key].as_f64().unwrap_or(f64::NAN);
    eprintln!(
        "{} + {}: overlap {overlap:.2}, {outcome:?}, {off:.2} m: {reason}; pieces {} overlap {:.2} agreeing {:.3} violated {:.3}",
        a.name,
        b.name,
        best("pieces"),
        best("overlap"),
        best("agreeing"),
        best("violated"),
    );
    Some(Pair { kind: kind(a, b, overlap), overlap, outcome })
}

/// What two parts have to do with each other.
fn kind(a: &Part, b: &Part, overlap: f64) -> &'static str {
    let plain = |world: &str| world.trim_start_matches("mirrored ").to_owned();
    // Rendered sites are called by their plan and by what stands about in them.
    let plan = |world: &str| {
        let mut words = world.split('-');
        Some((words.next()?.to_owned(), words.next()?.to_owned(), words.next()?.to_owned()))
    };
    let [one, other] = [a, b].map(|part| plain(&part.world));
    if a.world == b.world {
        return match overlap {
            o if o < NOTHING => "one world, nothing in common",
            o if o < SAME => "one world, little in common",
            _ => "one world, 30 % and more in common",
        };
    }
    if one == other {
        return "one of them mirrored";
    }
    let similar = plan(&one).zip(plan(&other)).is_some_and(|(x, y)| (x.0, x.1) == (y.0, y.1));
    if similar { "two floors of one plan" } else { "different worlds" }
}

/// The pairs by their kinds.
fn table(pairs: &[Pair]) -> String {
    let mut text = String::from(
        "| pairs of stretches of 12 m | pairs | merged rightly | wrongly | undecided | refused |\n|---|---|---|---|---|---|\n",
    );
    let row = |text: &mut String, name: &str, of: &[&Pair]| {
        let count = |outcome| of.iter().filter(|pair| pair.outcome == outcome).count();
        let [right, wrong, undecided, refused] =
            [Outcome::Right, Outcome::Wrong, Outcome::Undecided, Outcome::Refused].map(count);
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {name} | {} | {right} | {wrong} | {undecided} | {refused} |", of.len());
        (right, wrong)
    };
    for kind in [
        "different worlds",
        "two floors of one plan",
        "one of them mirrored",
        "one world, nothing in common",
        "one world, little in common",
        "one world, 30 % and more in common",
    ] {
        let of: Vec<&Pair> = pairs.iter().filter(|pair| pair.kind == kind).collect();
        row(&mut text, kind, &of);
    }
    let nothing: Vec<&Pair> = pairs.iter().filter(|pair| pair.overlap < NOTHING).collect();
    let (_, wrong) = row(&mut text, "**all with nothing in common**", &nothing);
    let same: Vec<&Pair> = pairs.iter().filter(|pair| pair.overlap >= SAME).collect();
    let right = same.iter().filter(|pair| pair.outcome == Outcome::Right).count();
    let all = pairs.iter().filter(|pair| pair.outcome == Outcome::Wrong).count();
    let _ = writeln!(
        text,
        "\nOf {} pairs with nothing in common {wrong} were merged, of all {} pairs {all} wrongly (by more than {WRONG} m). Of the \
         {} that share 30 % of what they saw, {right} were merged rightly: recall {:.0} %.",
        nothing.len(),
        pairs.len(),
        same.len(),
        100.0 * right as f64 / same.len().max(1) as f64
    );
    text
}
