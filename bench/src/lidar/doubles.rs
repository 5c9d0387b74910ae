//! Stretches of places that are built alike, and of one place seen again with some of its things moved: whether they are told apart.
//!
//! Of every kind a place is driven through there and back, back again with 5, 10 and 20 % of its things moved, and its double, a
//! place of the same plan, there. Maps are made of keyframes where they truly were, for what agents err by on such sites (some
//! millimetres) costs a hundred times as much to find, and cut into stretches of 12 m; an even choice of the pairs that share 30 % of what they saw, and of
//! those that would if doubles were one place, is merged in both orders.

use super::parts::{Part, stretches};
use super::program::Program;
use anyhow::{Context, Result, bail};
use geometry::{GrayImage, Se3, Sim3};
use loopbox_tests::lidar::{SIXTEEN, Sensor, THIRTY_TWO, sweep_of, walk};
use loopbox_tests::lidar_doubles::{Kind, Things};
use loopbox_tests::lidar_sites::{Site, hall, office, warehouse};
use map::{Keyframe, KeyframeId, Scan};
use serde_json::Value;
use std::collections::{BTreeMap, HashSet};
use std::fmt::Write;
use std::sync::Arc;

/// A merge is wrong when it misplaces keyframes by more, metres.
const WRONG: f64 = 0.3;
/// From this overlap on maps should be merged.
const SAME: f64 = 0.3;
/// Between keyframes, metres, as agents take them.
const APART: f64 = 1.0;
/// Edge of the voxels of which a keyframe keeps a point, metres, likewise.
const GRID: f32 = 0.15;
/// Between instants at which a keyframe may be taken, seconds.
const STEP: f64 = 0.05;
/// What is moved between two visits, percent of the things.
const MOVED: [u64; 3] = [5, 10, 20];
/// So many pairs of each kind: of one place with nothing moved, of one with each share moved, of doubles.
const PAIRS: [usize; 3] = [3, 1, 4];

/// What places are drawn by.
#[derive(Clone, Copy)]
enum Plan {
    /// Places and their doubles.
    SimilarPlace(Kind),
    /// A site by its number and that of what stands about, of which nothing is moved.
    Site(&'static str, Drawing),
}

/// A site of a plan and of what stands about.
type Drawing = fn(u64, u64) -> Site;

/// All kinds.
fn plans() -> Vec<Plan> {
    let sites: [(&str, Drawing); 3] = [
        ("halls", |plan, stock| hall(plan.wrapping_add(stock))),
        ("warehouses of four rows", |plan, stock| warehouse(plan, plan.wrapping_add(stock))),
        ("floors of corridors", |plan, stock| office(plan, plan.wrapping_add(stock))),
    ];
    let doubles = Kind::ALL.into_iter().map(Plan::SimilarPlace);
    doubles.chain(sites.map(|(name, site)| Plan::Site(name, site))).collect()
}

impl Plan {
    fn name(self) -> &'static str {
        match self {
            Self::SimilarPlace(kind) => kind.name(),
            Self::Site(name, _) => name,
        }
    }

    fn is_held_out(self) -> bool {
        matches!(self, Self::SimilarPlace(kind) if kind.is_held_out())
    }

    /// A place of a plan: `place` is 0 or that of its double.
    fn site(self, plan: u64, place: u64, moved: u64) -> Site {
        match self {
            Self::SimilarPlace(kind) => {
                let things = Things::new(plan.wrapping_mul(2).wrapping_add(place));
                kind.site(plan, things.moved(moved as f64 / 100.0, plan.wrapping_add(77)))
            }
            Self::Site(_, site) => site(plan, place),
        }
    }

    fn moved(self) -> &'static [u64] {
        if matches!(self, Self::SimilarPlace(_)) { &MOVED } else { &[] }
    }
}

/// What a pair of stretches is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Relation {
    /// One place, with so many percent of its things moved.
    Same(u64),
    /// Two places of one plan.
    Double,
}

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Outcome {
    Right,
    Wrong,
    CannotTell,
    Different,
}

/// What became of the pairs of a kind and relation.
type Tally = BTreeMap<Outcome, usize>;

/// Drives through places of every kind, whose plans `seed` names, and merges pairs of stretches; `only` names kinds by a part of their
/// names. Hands on the table after each kind, and returns how many pairs were merged wrongly.
///
/// # Errors
/// When a merge or `tell` fails, when a pair is judged otherwise in the other order, or joined with an answer that joins nothing.
pub fn measure(
    program: &Program,
    seed: u64,
    only: &[String],
    tell: &mut dyn FnMut(String) -> Result<()>,
) -> Result<usize> {
    let mut tallies: BTreeMap<(usize, Relation), Tally> = BTreeMap::new();
    let is_asked =
        |plan: &Plan| only.is_empty() || only.iter().any(|name| plan.name().contains(name.as_str()));
    for (number, plan) in plans().into_iter().enumerate().filter(|(_, plan)| is_asked(plan)) {
        let drawn = seed.saturating_mul(100).saturating_add(number as u64);
        let sensor = [("16", SIXTEEN), ("32", THIRTY_TWO)][number % 2];
        let mut count = |relation, outcome| {
            *tallies.entry((number, relation)).or_default().entry(outcome).or_default() += 1;
        };
        measure_kind(program, plan, drawn, sensor, &mut count)?;
        tell(table(&tallies, seed))?;
    }
    Ok(tallies.values().filter_map(|tally| tally.get(&Outcome::Wrong)).sum())
}

/// Drives through the places of one plan and merges pairs of their stretches.
fn measure_kind(
    program: &Program,
    plan: Plan,
    seed: u64,
    sensor: (&str, Sensor),
    count: &mut dyn FnMut(Relation, Outcome),
) -> Result<()> {
    let mut own = drive(program, plan, [seed, 0, 0, 0], sensor)?;
    own.extend(drive(program, plan, [seed, 0, 0, 1], sensor)?);
    let mut lots = Vec::new();
    for &moved in plan.moved() {
        lots.push((Relation::Same(moved), PAIRS[1], drive(program, plan, [seed, 0, moved, 1], sensor)?));
    }
    lots.push((Relation::Double, PAIRS[2], drive(program, plan, [seed, 1, 0, 0], sensor)?));
    let all = (1..own.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    let pairs: Vec<[&Part; 2]> = all.map(|(a, b)| [&own[a], &own[b]]).collect();
    for pair in chosen(pairs, PAIRS[0]) {
        count(Relation::Same(0), merged(program, pair, Relation::Same(0))?);
    }
    for (relation, most, others) in &lots {
        let pairs: Vec<[&Part; 2]> = others.iter().flat_map(|b| own.iter().map(move |a| [a, b])).collect();
        for pair in chosen(pairs, *most) {
            count(*relation, merged(program, pair, *relation)?);
        }
    }
    Ok(())
}

/// So many of the pairs that share enough of the plan, evenly chosen; of all where none does, as stretches of one corridor that lie
/// apart.
fn chosen(pairs: Vec<[&Part; 2]>, count: usize) -> Vec<[&Part; 2]> {
    let near: Vec<_> = pairs.iter().copied().filter(|[a, b]| a.plan_overlap(b) >= SAME).collect();
    let of = if near.is_empty() { pairs } else { near };
    let count = count.min(of.len());
    (0..count).map(|k| of[(2 * k + 1) * of.len() / (2 * count)]).collect()
}

/// Stretches of one drive: a keyframe a metre where it truly was, without the motion of its sweep.
fn drive(
    program: &Program,
    plan: Plan,
    [seed, place, moved, path]: [u64; 4],
    (sensor_name, sensor): (&str, Sensor),
) -> Result<Vec<Part>> {
    let site = plan.site(seed, place, moved);
    let world = format!("{} {seed} {place}", plan.name());
    let name = format!("{world} {moved} {sensor_name} {path}").replace([' ', ','], "-");
    let (pose, duration) = walk(&site.paths[path as usize]);
    let mut keyframes: Vec<(Keyframe, Se3)> = Vec::new();
    for step in 0..=(duration / STEP) as u32 {
        let time = STEP * f64::from(step);
        let at = pose(time);
        if keyframes.last().is_none_or(|(_, last)| (last.translation - at.translation).norm() >= APART) {
            // Noise is drawn by the stamp: no two drives have the same.
            let stamp = time + 1000.0 * (4 * moved + 2 * place + path) as f64;
            let returns = sweep_of(&sensor, &site.boxes, |_| at, stamp);
            let points = thinned(returns.into_iter().map(|r| r.point));
            let mut keyframe = Keyframe::of_image(
                KeyframeId(keyframes.len() as u32),
                time,
                u64::from(step),
                Sim3::from(at),
                Arc::new(GrayImage::filled(0, 0, 0)),
            );
            keyframe.scan = Some(Arc::new(Scan::new(points)));
            keyframes.push((keyframe, at));
        }
    }
    stretches(&keyframes, &name, &world, &program.at("parts"), false)
}

/// The first point of each voxel, as agents keep them.
fn thinned(points: impl Iterator<Item = [f32; 3]>) -> Vec<[f32; 3]> {
    let mut taken = HashSet::new();
    points.filter(|p| taken.insert(p.map(|v| (v / GRID).floor() as i32))).collect()
}

/// Merges a pair in both orders, and judges what is said of it.
fn merged(program: &Program, [a, b]: [&Part; 2], relation: Relation) -> Result<Outcome> {
    let (forth, back) = (output(program, [a, b])?, output(program, [b, a])?);
    let names = format!("{} + {}", a.name, b.name);
    let [decision, reason] = ["decision", "reason"].map(|key| forth[key].as_str().unwrap_or("–"));
    if (decision, reason)
        != (back["decision"].as_str().unwrap_or("–"), back["reason"].as_str().unwrap_or("–"))
    {
        bail!("{names}: {decision}: {reason}; in the other order: {}: {}", back["decision"], back["reason"]);
    }
    let answer = forth["answer"].as_str().unwrap_or("–");
    if (decision == "accepted") != answer.starts_with("same") {
        bail!("{names}: {decision}, though the answer is {answer}");
    }
    let numbers = forth["best"]["first_from_second"].as_array();
    let numbers: Vec<f64> = numbers.into_iter().flatten().filter_map(Value::as_f64).collect();
    let pose = <[f64; 7]>::try_from(numbers).ok().map(Se3::from_tum);
    let off = pose.map_or(f64::INFINITY, |pose| a.misplaced(b, &pose));
    let outcome = match decision {
        "accepted" if relation != Relation::Double && off < WRONG => Outcome::Right,
        "accepted" => Outcome::Wrong,
        "undecided" => Outcome::CannotTell,
        _ => Outcome::Different,
    };
    eprintln!("{names}: {relation:?}, {outcome:?}, {answer}, {off:.2} m: {reason}");
    Ok(outcome)
}

/// What the program says of two maps.
fn output(program: &Program, parts: [&Part; 2]) -> Result<Value> {
    let [a, b] = parts.map(|part| part.file.display().to_string());
    let out = program.at("pair").display().to_string();
    let (_, record) = program.json(&["merge", &a, &b, "--out", &out, "--force", "--json", "--quiet"])?;
    let output =
        record["encounters"].get(0).with_context(|| format!("{a}, {b}: the merge reports no pair"))?;
    Ok(output.clone())
}

/// The pairs by kinds and relations.
fn table(tallies: &BTreeMap<(usize, Relation), Tally>, seed: u64) -> String {
    let mut text = String::from(
        "| kind | pairs of | pairs | joined rightly | wrongly | cannot be told | different |\n|---|---|---|---|---|---|---|\n",
    );
    let mut all: BTreeMap<Relation, Tally> = BTreeMap::new();
    let line = |text: &mut String, kind: &str, relation: &Relation, tally: &Tally| {
        let of = match relation {
            Relation::Double => "two places of one plan".to_owned(),
            Relation::Same(0) => "one place".to_owned(),
            Relation::Same(moved) => format!("one place, {moved} % moved"),
        };
        let count = |outcome| tally.get(&outcome).copied().unwrap_or(0);
        let [right, wrong, open, other] =
            [Outcome::Right, Outcome::Wrong, Outcome::CannotTell, Outcome::Different].map(count);
        let pairs = right + wrong + open + other;
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {kind} | {of} | {pairs} | {right} | {wrong} | {open} | {other} |");
    };
    for ((number, relation), tally) in tallies {
        let plan = plans()[*number];
        let mark = if plan.is_held_out() { " (held out)" } else { "" };
        line(&mut text, &format!("{}{mark}", plan.name()), relation, tally);
        let sum = all.entry(*relation).or_default();
        tally.iter().for_each(|(outcome, count)| *sum.entry(*outcome).or_default() += count);
    }
    for (relation, tally) in &all {
        line(&mut text, "**all**", relation, tally);
    }
    let _ = writeln!(text, "\nPlans from {} on, each pair in both orders, one verdict for both.", 100 * seed);
    text
}
