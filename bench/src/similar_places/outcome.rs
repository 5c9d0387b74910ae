//! What became of a pair of maps.

use super::maps::PlaceMap;
use crate::merging::truth::Deviation;
use anyhow::{Context, Result};
use geometry::Sim3;
use measuring::views::{SAME, largest_overlap};
use serde_json::Value;

/// A line of the verdict on a closure.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its name.
    pub name: String,
    /// What was found.
    pub value: f64,
    /// The limit.
    pub limit: f64,
    /// Whether the closure passes it.
    pub passes: bool,
}

/// What became of a pair.
pub struct Outcome {
    /// Place and way of both maps.
    pub maps: [(u64, u64); 2],
    /// Whether the two show a place alike: one place, and a quarter of a view.
    pub related: bool,
    /// Whether both are of one place.
    pub one_place: bool,
    /// `accepted`, `undecided` or `refused`.
    pub verdict: String,
    /// Of a pair that was merged: whether as the truth has it.
    pub right: bool,
    /// The lines of every closure that was judged.
    pub closures: Vec<Vec<Line>>,
}

impl Outcome {
    /// Whether it was merged.
    pub fn accepted(&self) -> bool {
        self.verdict == "accepted"
    }

    /// Whether it was merged though it must not be so.
    pub fn wrong(&self) -> bool {
        self.accepted() && !self.right
    }

    /// Whether a closure was judged at all.
    pub fn hard(&self) -> bool {
        !self.closures.is_empty()
    }

    /// Whether the other is the same pair with another verdict.
    pub fn differs_from(&self, other: &Self) -> bool {
        let turned = [other.maps[1], other.maps[0]];
        (self.maps == turned || self.maps == other.maps) && self.verdict != other.verdict
    }
}

/// What became of every pair in merge.json of maps.
///
/// # Errors
/// When the record lacks something.
pub fn all(record: &Value, maps: &[&PlaceMap]) -> Result<Vec<Outcome>> {
    let pair_results = record["encounters"].as_array().context("merge.json has no encounters")?;
    let pairs = (1..maps.len()).flat_map(|later| (0..later).map(move |earlier| [earlier, later]));
    let name = |input: usize| record.pointer(&format!("/inputs/{input}/name"));
    let outcome = |([earlier, later], pair): ([usize; 2], &Value)| {
        let turned = name(later).is_some_and(|name| *name == pair["target"]);
        let sides = if turned { [maps[later], maps[earlier]] } else { [maps[earlier], maps[later]] };
        one(pair, sides).with_context(|| format!("{} of merge.json", pair["source"]))
    };
    pairs.zip(pair_results).map(outcome).collect()
}

fn one(pair: &Value, [target, source]: [&PlaceMap; 2]) -> Result<Outcome> {
    let verdict = pair["verdict"].as_str().context("an encounter has no verdict")?.to_owned();
    let one_place = target.place == source.place;
    let tested = pair["tried"].as_array().context("an encounter says nothing of places")?;
    let lines = |place: &Value| -> Vec<Line> {
        let line = |line: &Value| {
            Some(Line {
                name: line["name"].as_str()?.to_owned(),
                // What is no number is written as null, and passes nothing.
                value: line["value"].as_f64().unwrap_or(f64::NAN),
                limit: line["limit"].as_f64()?,
                passes: line["says"] == "for",
            })
        };
        place["lines"].as_array().into_iter().flatten().filter_map(line).collect()
    };
    let closures = tested.iter().map(lines).filter(|lines| !lines.is_empty()).collect();
    Ok(Outcome {
        maps: [target, source].map(|map| (map.place, map.pass)),
        related: one_place && largest_overlap(&target.views, &source.views) >= SAME,
        one_place,
        right: verdict == "accepted" && one_place && is_right(pair, tested, [target, source])?,
        verdict,
        closures,
    })
}

/// Whether an accepted closure of one place is where the truth has it.
fn is_right(pair: &Value, tested: &[Value], [target, source]: [&PlaceMap; 2]) -> Result<bool> {
    let place =
        tested.iter().find(|place| place["outcome"] == "accepted").context("no place was accepted")?;
    let motion = pair.pointer("/closure/target_from_source").context("no motion of the maps")?;
    let motion: Sim3 = serde_json::from_value(motion.clone())?;
    let time = |of: &str| place[of].as_f64().with_context(|| format!("a place has no {of}"));
    let (target_time, source_time) = (time("target_time")?, time("source_time")?);
    let sides = target.side(&Sim3::identity(), target_time).zip(source.side(&motion, source_time));
    let (target_side, source_side) = sides.context("a keyframe has no pose")?;
    let depth = target.depth(target_time).context("a keyframe sees nothing")?;
    Ok(Deviation::new(&target_side, &source_side, depth).is_right())
}
