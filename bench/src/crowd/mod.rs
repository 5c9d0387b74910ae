//! Many agents in one place: what merging all their maps costs, from nothing and one more at a time, and whether it is right.

pub mod maps;
pub mod report;

use crate::merging::Program;
use crate::merging::truth::{Deviation, Side};
use anyhow::{Context, Result, bail};
use geometry::Sim3;
use maps::CrowdMap;
use measuring::views::{SAME, View};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Degrees between the rays from two keyframes to a point up to which it looks alike: what merging asks of pairs.
const MAX_VIEW_ANGLE: f64 = 40.0;
/// Every so many keyframes of two maps are compared to see whether they show a place alike.
const EVERY: usize = 4;

/// What to measure.
pub struct Plan<'a> {
    /// The program.
    pub program: &'a Program,
    /// Folder for maps and merges.
    pub work: &'a Path,
    /// How many agents are merged at once; one more is added.
    pub agents: usize,
    /// Keyframes of each.
    pub keyframes: usize,
}

/// What came of a merge.
pub struct Merge {
    /// Wall-clock seconds of the program, all of it.
    pub seconds: f64,
    /// Largest resident memory, bytes.
    pub memory: f64,
    /// Bytes of the maps read, and of the results.
    pub bytes: [u64; 2],
    /// Pairs of inputs, those that show a place alike, those merged, and of these the wrong ones.
    pub pairs: Pairs,
    /// Maps in the group of most.
    pub together: usize,
    /// merge.json's costs.
    pub cost: Value,
}

/// Pairs of maps, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pairs {
    /// Those that were looked at.
    pub all: usize,
    /// Those that show a place alike.
    pub related: usize,
    /// Those merged.
    pub merged: usize,
    /// Of the related, those merged.
    pub found: usize,
    /// Of those merged, the ones that are not where the truth has them.
    pub wrong: usize,
}

/// What was measured.
pub struct Measured {
    /// All maps but one.
    pub all: Merge,
    /// That common map, and the last.
    pub one_more: Merge,
}

/// Makes the maps that are missing, merges all but the last, and then that one with the common map.
///
/// # Errors
/// When the program fails, or files cannot be written or read.
pub fn measure(plan: &Plan) -> Result<Measured> {
    if plan.agents < 2 || plan.keyframes < 10 {
        bail!("{} agents of {} keyframes are no crowd: 2 and 10 at the least", plan.agents, plan.keyframes);
    }
    let folder = plan.work.join(format!("crowd-{}x{}", plan.agents, plan.keyframes));
    let make = |number| {
        eprintln!("map {number} of {}", plan.agents + 1);
        maps::make(number, plan.agents + 1, plan.keyframes, plan.program, &folder)
    };
    let maps: Vec<CrowdMap> = (0..=plan.agents).map(make).collect::<Result<_>>()?;
    eprintln!("{} maps are there", maps.len());
    let (first, common) = (&maps[..plan.agents], folder.join("common"));
    let files: Vec<&Path> = first.iter().map(|map| &*map.file).collect();
    let all = merge(plan, &files, first, &common)?;
    eprintln!("{}", report::line(&all));
    let more = [&*common, &maps[plan.agents].file];
    let one_more = merge(plan, &more, &maps, &folder.join("one-more"))?;
    eprintln!("{}", report::line(&one_more));
    Ok(Measured { all, one_more })
}

fn merge(plan: &Plan, files: &[&Path], maps: &[CrowdMap], out: &Path) -> Result<Merge> {
    let mut command = Command::new(&plan.program.loopbox);
    command.arg("merge").args(files).arg("--out").arg(out).args(["--json", "--quiet", "--force"]);
    let start = Instant::now();
    let printed = crate::measure::finish(&mut command)?;
    let seconds = start.elapsed().as_secs_f64();
    let record: Value = serde_json::from_slice(&printed).context("merge.json is not JSON")?;
    let size = |path: &Path| -> u64 {
        let file: PathBuf = if path.is_dir() { path.join("map.mcap") } else { path.to_owned() };
        file.metadata().map_or(0, |data| data.len())
    };
    // The largest files, which nobody looks at.
    for name in ["cloud.ply", "report.html"] {
        let file = out.join(name);
        std::fs::remove_file(&file).with_context(|| format!("{}: cannot be removed", file.display()))?;
    }
    let groups = record["groups"].as_array().into_iter().flatten();
    let together = groups.filter_map(|group| group["agents"].as_array().map(Vec::len)).max().unwrap_or(0);
    Ok(Merge {
        seconds,
        memory: record.pointer("/cost/peak_memory_bytes").and_then(Value::as_f64).unwrap_or(f64::NAN),
        bytes: [files.iter().map(|file| size(file)).sum(), size(out)],
        pairs: judge(&record, maps)?,
        together,
        cost: record["cost"].clone(),
    })
}

/// Every pair of maps of the record by the truth. Agents are called as their maps are.
fn judge(record: &Value, maps: &[CrowdMap]) -> Result<Pairs> {
    let mut pairs = Pairs::default();
    for pair in record["encounters"].as_array().context("merge.json has no encounters")? {
        let map = |of: &str| maps.iter().find(|map| pair[of] == *map.name);
        let Some((target, source)) = map("target").zip(map("source")) else { continue };
        let related = are_views_of_one_place(&target.views, &source.views);
        let merged = pair["accepted"] == true;
        pairs.all += 1;
        pairs.related += usize::from(related);
        pairs.merged += usize::from(merged);
        pairs.found += usize::from(merged && related);
        if merged && !is_right(pair, [target, source])? {
            eprintln!("wrong: {} + {}", pair["target"], pair["source"]);
            pairs.wrong += 1;
        }
    }
    Ok(pairs)
}

fn are_views_of_one_place(a: &[View], b: &[View]) -> bool {
    let few = |views: &[View]| views.iter().step_by(EVERY).cloned().collect::<Vec<_>>();
    let (a, b) = (few(a), few(b));
    a.iter().any(|a| b.iter().any(|b| a.overlap_within(b, MAX_VIEW_ANGLE) >= SAME))
}

/// Whether an accepted closure is where the truth has it.
fn is_right(pair: &Value, [target, source]: [&CrowdMap; 2]) -> Result<bool> {
    let tested = pair["tried"].as_array().into_iter().flatten();
    let place = tested.into_iter().find(|place| place["outcome"] == "accepted");
    let place = place.context("no place was accepted")?;
    let motion = pair.pointer("/closure/target_from_source").context("no motion of the maps")?;
    let motion: Sim3 = serde_json::from_value(motion.clone())?;
    let time = |of: &str| place[of].as_f64().with_context(|| format!("a place has no {of}"));
    let side = |map: &CrowdMap, time: f64, motion: &Sim3| -> Option<(Side, f64)> {
        let (world_from_camera, depth) = map.truth_at(time)?;
        let pose = *motion * map.own_at(time)?;
        // Maps drift: their unit is that of the keyframe where they met.
        let (growth, metres) = (pose.scale, map.metres);
        Some((Side { common_from_camera: pose.rigid(), world_from_camera, growth, metres }, depth))
    };
    let sides = side(target, time("target_time")?, &Sim3::identity()).zip(side(
        source,
        time("source_time")?,
        &motion,
    ));
    let ((target, depth), (source, _)) = sides.context("a keyframe has no pose")?;
    Ok(Deviation::new(&target, &source, depth).is_right())
}
