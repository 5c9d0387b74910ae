//! Pairs of places that are built alike, and of one place seen again with some of its things moved.

use super::parts::Part;
use super::program::Program;
use super::truth::Truth;
use anyhow::{Context, Result};
use geometry::Se3;
use loopbox_tests::lidar::{SIXTEEN, Sensor, THIRTY_TWO, walk, write_recording_of};
use loopbox_tests::lidar_doubles::{Kind, Things};
use loopbox_tests::lidar_sites::Site;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A merge is wrong when it misplaces keyframes by more, metres.
const WRONG: f64 = 0.3;
/// What is moved between two visits, percent of the things.
const MOVED: [u64; 4] = [5, 10, 20, 50];
/// Numbers of things in places of one plan: each is another place.
const PLACES: [u64; 3] = [0, 1, 2];
/// The sensors by their names.
const SENSORS: [(&str, Sensor); 2] = [("16", SIXTEEN), ("32", THIRTY_TWO)];

/// A drive through a place.
struct Drive {
    part: Part,
    site: Site,
    /// The number of its things, and the percentage of them moved.
    place: u64,
    moved: u64,
}

/// What a pair of drives is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Relation {
    /// Two places of one plan.
    Double,
    /// One place, with so many percent of its things moved.
    Same(u64),
}

/// What became of the pairs of a kind and relation.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    pairs: usize,
    right: usize,
    wrong: usize,
    undecided: usize,
    refused: usize,
}

/// Drives through two places of each kind for each sensor, whose plans `seed` names, and merges every two of a plan; `only` names
/// kinds by a part of their names. Returns the table, and how many were merged wrongly.
pub fn measure(program: &Program, seed: u64, only: &[String]) -> Result<(String, usize)> {
    let mut tallies: BTreeMap<(usize, Relation), Tally> = BTreeMap::new();
    let is_asked =
        |kind: &Kind| only.is_empty() || only.iter().any(|name| kind.name().contains(name.as_str()));
    for (number, kind) in Kind::ALL.into_iter().enumerate().filter(|(_, kind)| is_asked(kind)) {
        for (sensor, plan) in SENSORS.iter().zip(2 * seed..) {
            let drives = drives(program, kind, plan, *sensor)?;
            for (relation, outcome) in merged(program, &drives, &format!("doubles-{number}-{plan}"))? {
                let tally = tallies.entry((number, relation)).or_default();
                tally.pairs += 1;
                match outcome {
                    Outcome::Right => tally.right += 1,
                    Outcome::Wrong => tally.wrong += 1,
                    Outcome::Undecided => tally.undecided += 1,
                    Outcome::Refused => tally.refused += 1,
                }
            }
        }
    }
    Ok((table(&tallies), tallies.values().map(|tally| tally.wrong).sum()))
}

/// The drives through places of one plan: each place there and back, one of them again with its things moved.
fn drives(program: &Program, kind: Kind, plan: u64, sensor: (&str, Sensor)) -> Result<Vec<Drive>> {
    let mut found = Vec::new();
    for place in PLACES {
        for way in 0..2 {
            found.push(drive(program, kind, [plan, place, 0, way], sensor)?);
        }
    }
    for moved in MOVED {
        found.push(drive(program, kind, [plan, PLACES[0], moved, 1], sensor)?);
    }
    Ok(found)
}

/// One drive: recorded, mapped, its scans removed again.
fn drive(
    program: &Program,
    kind: Kind,
    [plan, place, moved, way]: [u64; 4],
    (sensor_name, sensor): (&str, Sensor),
) -> Result<Drive> {
    let things = Things::new(place).moved(moved as f64 / 100.0, 77);
    let site = kind.site(plan, things);
    let world = format!("{} {plan} {place}", kind.name());
    let name = format!("{world} {moved} {sensor_name} {way}").replace([' ', ','], "-");
    let (folder, out) = (program.at(&format!("site-{name}")), program.at(&name));
    if !(program.reuse && folder.join("groundtruth.txt").is_file()) {
        let (pose, duration) = walk(&site.ways[way as usize]);
        write_recording_of(&sensor, &folder, &site.boxes, pose, duration)?;
    }
    program.run(&folder, &name, &[])?;
    let truth = Truth::of(&folder)?;
    // A straight way cannot be aligned; its map is judged by what merges it.
    if let Ok(errors) = truth.errors(&out.join("trajectory.txt")) {
        eprintln!("{name}: ATE {:.4} m", errors.ate);
    }
    for scans in ["velodyne", "times", "rings"] {
        std::fs::remove_dir_all(folder.join(scans)).ok();
    }
    let part = Part::whole(&out.join("map.mcap"), &truth, &name, &world)?;
    Ok(Drive { part, site, place, moved })
}

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Right,
    Wrong,
    Undecided,
    Refused,
}

/// Merges every two drives, and judges each pair by the truth.
fn merged(program: &Program, drives: &[Drive], name: &str) -> Result<Vec<(Relation, Outcome)>> {
    let out = program.at(name).display().to_string();
    let files: Vec<String> = drives.iter().map(|drive| drive.part.file.display().to_string()).collect();
    let mut args = vec!["merge"];
    args.extend(files.iter().map(String::as_str));
    args.extend(["--out", &out, "--force", "--json", "--quiet"]);
    let (_, record) = program.json(&args)?;
    let encounters = record["encounters"].as_array().context("the merge reports no pairs")?;
    let order = (1..drives.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    let judge = |((a, b), said): ((usize, usize), &Value)| {
        let relation = relation(&drives[a], &drives[b])?;
        Some((relation, outcome(&drives[a], &drives[b], relation, said)?))
    };
    Ok(order.zip(encounters).filter_map(judge).collect())
}

/// What two drives have to do with each other; nothing where that is not asked.
fn relation(a: &Drive, b: &Drive) -> Option<Relation> {
    match (a.place == b.place || a.site == b.site, a.moved.min(b.moved)) {
        (true, 0) => Some(Relation::Same(a.moved.max(b.moved))),
        // Both were moved, or they are told apart by nothing.
        (true, _) => None,
        (false, _) => Some(Relation::Double),
    }
}

/// Judges what is said of two drives.
fn outcome(a: &Drive, b: &Drive, relation: Relation, said: &Value) -> Option<Outcome> {
    let (decision, reason) = (said["decision"].as_str()?, said["reason"].as_str()?);
    // Of a merge that the others outvote it is asked what became of the pair by itself.
    let accepted = decision == "accepted" || reason.starts_with("taken back");
    let numbers = said["best"]["first_from_second"].as_array();
    let numbers: Vec<f64> = numbers.into_iter().flatten().filter_map(Value::as_f64).collect();
    let pose = <[f64; 7]>::try_from(numbers).ok().map(Se3::from_tum);
    let off = pose.map_or(f64::INFINITY, |pose| a.part.misplaced(&b.part, &pose));
    let outcome = match (accepted, decision) {
        (true, _) if relation != Relation::Double && off < WRONG => Outcome::Right,
        (true, _) => Outcome::Wrong,
        (false, "undecided") => Outcome::Undecided,
        _ => Outcome::Refused,
    };
    eprintln!("{} + {}: {relation:?}, {outcome:?}, {off:.2} m: {reason}", a.part.name, b.part.name);
    Some(outcome)
}

/// The pairs by kinds and relations.
fn table(tallies: &BTreeMap<(usize, Relation), Tally>) -> String {
    let mut text = String::from(
        "| kind | pairs of | pairs | merged rightly | wrongly | undecided | refused |\n|---|---|---|---|---|---|---|\n",
    );
    let mut all: BTreeMap<Relation, Tally> = BTreeMap::new();
    let line = |text: &mut String, kind: &str, relation: &Relation, tally: &Tally| {
        let of = match relation {
            Relation::Double => "two places".to_owned(),
            Relation::Same(0) => "one place".to_owned(),
            Relation::Same(moved) => format!("one place, {moved} % moved"),
        };
        let Tally { pairs, right, wrong, undecided, refused } = tally;
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {kind} | {of} | {pairs} | {right} | {wrong} | {undecided} | {refused} |");
    };
    for ((number, relation), tally) in tallies {
        let kind = Kind::ALL[*number];
        let mark = if kind.is_held_out() { " (held out)" } else { "" };
        line(&mut text, &format!("{}{mark}", kind.name()), relation, tally);
        let sum = all.entry(*relation).or_default();
        sum.pairs += tally.pairs;
        sum.right += tally.right;
        sum.wrong += tally.wrong;
        sum.undecided += tally.undecided;
        sum.refused += tally.refused;
    }
    for (relation, tally) in &all {
        line(&mut text, "**all**", relation, tally);
    }
    text
}
