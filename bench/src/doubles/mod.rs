//! Maps of places that share what is made in numbers and differ in a share of their things, and of one place seen again with some of
//! its things moved: the first must not be merged, the second should be.
//!
//! The maps are exact, straight from the renderer: what is measured is the verdict, and neither tracking nor mapping.
//! Every pair is merged by itself. On six of the kinds limits may be set ([`Kind::TUNED`]); the others are shown only
//! ([`Kind::HELD_OUT`]).

#[path = "../../../merge/tests/meetings/rendered.rs"]
mod rendered;
mod report;

pub use report::{section, wrong};

use crate::merging::Program;
use crate::side_by_side::side_by_side;
use anyhow::{Context, Result, bail};
use geometry::Sim3;
use loopbox_tests::doubles::{Kind, Version};
use map::{Map, save_map};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Keyframes of a way past a place.
const KEYFRAMES: usize = 8;
/// Standard deviation of the image noise, grey levels.
const NOISE: f64 = 2.0;
/// Grains that surfaces have for themselves, grey levels; plaster, paint and cloth have 2 to 6.
const GRAINS: [f32; 2] = [0.0, 3.0];
/// Shares of their things in which doubles differ.
const DIFFERING: [f64; 4] = [0.05, 0.1, 0.3, 1.0];
/// Shares of its things that were moved in a place that is seen again the same day.
const MOVED: [f64; 3] = [0.0, 0.05, 0.2];
/// The same days later.
const MOVED_LATER: [f64; 5] = [0.05, 0.1, 0.2, 0.3, 0.5];
/// A merge of one place is wrong when it is farther off, metres and radians (3°): the maps' worlds are one.
const OFF: [f64; 2] = [0.1, 0.052];

/// What to measure.
pub struct Plan<'a> {
    /// The program.
    pub program: &'a Program,
    /// Folder for maps and merges.
    pub work: &'a Path,
    /// Places of each kind, each with its doubles.
    pub places: u64,
    /// Another seed, other places.
    pub seed: u64,
    /// Names of kinds; all where there are none.
    pub only: &'a [String],
    /// Days between the maps, as the program is told. With more than none only places with a grain of their own are measured: of the
    /// others nothing is promised.
    pub days_apart: f64,
}

impl Plan<'_> {
    /// Shares of its things that were moved in a place that is seen again.
    fn moved(&self) -> &'static [f64] {
        moved(self.days_apart)
    }

    fn grains(&self) -> &'static [f32] {
        if self.days_apart > 0.0 { &GRAINS[1..] } else { &GRAINS }
    }
}

/// Shares of its things that were moved in a place that is seen again so many days later.
fn moved(days_apart: f64) -> &'static [f64] {
    if days_apart > 0.0 { &MOVED_LATER } else { &MOVED }
}

/// What a pair of maps is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Relation {
    /// Two places that differ in such a share of their things.
    Double(f64),
    /// One place of which such a share was moved.
    Same(f64),
}

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Became {
    /// Merged, and so it should be.
    Right,
    /// Merged, and of different places or elsewhere.
    Wrong,
    /// It is said that it cannot be told.
    Undecided,
    /// Refused, or nothing was found that they share.
    Apart,
}

/// A pair that was merged, or not.
pub struct Pair {
    kind: Kind,
    grain: f32,
    relation: Relation,
    /// Whether it is a double whose images are those of the place itself, to the bit: nothing that differs is in view.
    has_same_images: bool,
    became: Became,
}

/// Renders, and merges every place with its doubles and with itself.
///
/// # Errors
/// When the program fails, or files cannot be written or read.
pub fn measure(plan: &Plan) -> Result<Vec<Pair>> {
    if plan.places == 0 {
        bail!("--doubles 0 measures nothing");
    }
    let is_asked = |kind: &Kind| plan.only.is_empty() || plan.only.iter().any(|name| *name == name_of(*kind));
    let kinds: Vec<Kind> = Kind::TUNED.into_iter().chain(Kind::HELD_OUT).filter(is_asked).collect();
    if kinds.is_empty() {
        bail!("no kind of doubles is called {}: try {}", plan.only.join(" or "), name_of(Kind::Posters));
    }
    let jobs: Vec<(Kind, f32, u64)> = kinds
        .iter()
        .flat_map(|&kind| plan.grains().iter().map(move |&grain| (kind, grain)))
        .flat_map(|(kind, grain)| (0..plan.places).map(move |number| (kind, grain, number)))
        .collect();
    let pairs = side_by_side(&jobs, |&(kind, grain, number)| {
        let pairs = of_place(plan, kind, grain, number)?;
        eprintln!("{} {grain} {number}: {pairs:?}", name_of(kind));
        Ok(pairs)
    })?;
    Ok(pairs.into_iter().flatten().collect())
}

/// A kind's name on the command line and in tables.
fn name_of(kind: Kind) -> String {
    format!("{kind:?}").to_lowercase()
}

/// A place beside its doubles and itself.
fn of_place(plan: &Plan, kind: Kind, grain: f32, number: u64) -> Result<Vec<Pair>> {
    let seed = plan.seed.wrapping_mul(1000) + number;
    let here = Version::first(seed, grain);
    let name = format!("{}-{grain}-{seed}", name_of(kind));
    let home = plan.work.join("doubles").join(&name);
    let first = saved(&rendered(kind, &here, 2 * number), &home.join("first.mcap"))?;
    let doubles = DIFFERING.map(|share| (Relation::Double(share), Version { place: 1, share, ..here }));
    let same = plan.moved().iter().map(|&moved| (Relation::Same(moved), Version { time: 1, moved, ..here }));
    let again = rendered(kind, &Version { time: 1, ..here }, 2 * number + 1);
    let merged = |(relation, version): (Relation, Version)| {
        let second = rendered(kind, &version, 2 * number + 1);
        let has_same_images = matches!(relation, Relation::Double(_)) && has_same_images(&second, &again);
        let second = saved(&second, &home.join("second.mcap"))?;
        let record = record(plan, &[first.clone(), second], &home)?;
        let became = became(&record, relation).with_context(|| format!("{name} {relation:?}"))?;
        Ok(Pair { kind, grain, relation, has_same_images, became })
    };
    let pairs = doubles.into_iter().chain(same).map(merged).collect();
    std::fs::remove_dir_all(&home).with_context(|| format!("{}: cannot be removed", home.display()))?;
    pairs
}

/// The map of a way past a place.
fn rendered(kind: Kind, version: &Version, pass: u64) -> Map {
    rendered::noisy_map(&kind.world(version), &kind.path(pass, KEYFRAMES), (NOISE, pass))
}

/// Whether two maps of one way have the same images.
fn has_same_images(one: &Map, other: &Map) -> bool {
    one.keyframes.len() == other.keyframes.len()
        && one.keyframes.values().zip(other.keyframes.values()).all(|(a, b)| a.image == b.image)
}

/// A map in a file.
fn saved(map: &Map, file: &Path) -> Result<PathBuf> {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    }
    save_map(file, map).with_context(|| format!("{}: cannot be written", file.display()))?;
    Ok(file.to_owned())
}

/// merge.json of two maps.
fn record(plan: &Plan, maps: &[PathBuf], home: &Path) -> Result<Value> {
    let params = home.join("params.toml");
    let days_apart = format!("[further.place.prior]\ndays_apart = {:?}\n", plan.days_apart);
    std::fs::write(&params, days_apart)
        .with_context(|| format!("{}: cannot be written", params.display()))?;
    let out = home.join("merged");
    let record = plan.program.record(maps, &out, &params)?;
    if out.is_dir() {
        std::fs::remove_dir_all(&out).with_context(|| format!("{}: cannot be removed", out.display()))?;
    }
    Ok(record)
}

fn became(record: &Value, relation: Relation) -> Result<Became> {
    let pair = record.pointer("/encounters/0").context("merge.json has no encounters")?;
    Ok(match pair["verdict"].as_str().context("an encounter has no verdict")? {
        "accepted" => {
            let motion = pair.pointer("/closure/target_from_source").context("no motion of the maps")?;
            let motion: Sim3 = serde_json::from_value(motion.clone())?;
            let is_there = motion.translation.norm() <= OFF[0] && motion.rotation.angle() <= OFF[1];
            if matches!(relation, Relation::Same(_)) && is_there { Became::Right } else { Became::Wrong }
        }
        "undecided" => Became::Undecided,
        _ => Became::Apart,
    })
}

impl std::fmt::Debug for Pair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let alike = if self.has_same_images { " (alike)" } else { "" };
        write!(f, "{:?}{alike} {:?}", self.relation, self.became)
    }
}
