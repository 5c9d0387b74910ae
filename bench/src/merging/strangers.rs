//! Many pairs of maps, of which a good part has nothing in common: none may be merged wrongly.

use super::cut::cut;
use super::judge::{Part, ScoredPair, Verdict, judge};
use super::maps::MapWithTruth;
use super::program::{Attempt, Program};
use crate::side_by_side::side_by_side;
use anyhow::{Context, Result};
use geometry::Random;
use map::{Map, save_map};
use measuring::share_world;
use measuring::views::{DIFFERENT, SAME};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Keyframes of the shortest and of the longest cut.
const CUT: [usize; 2] = [10, 40];
/// The share of a map's keyframes that the parts at its two ends have.
const END: f64 = 0.3;
/// Pairs of cuts that are drawn to find one as wanted.
const DRAWS: usize = 20_000;

/// A part of the map of a known sequence: its index, and positions of keyframes.
type Cut = (usize, Range<usize>);

/// All pairs of the maps in the files `maps`, merged at once.
///
/// # Errors
/// When the program fails, or its results cannot be read.
pub fn all_pairs(
    known: &[MapWithTruth],
    maps: &[PathBuf],
    program: &Program,
    work: &Path,
) -> Result<Vec<ScoredPair>> {
    let parts: Vec<Part> = known.iter().map(|known| Part { known, map: &known.map }).collect();
    merged(&parts, maps, program, &work.join("merges").join("all"))
}

/// The two ends of each map, where they see nothing in common.
///
/// # Errors
/// When the program fails, or files cannot be written or read.
pub fn ends(known: &[MapWithTruth], program: &Program, work: &Path) -> Result<Vec<ScoredPair>> {
    let mut all = Vec::new();
    for (i, one) in known.iter().enumerate() {
        let count = one.map.keyframes.len();
        let length = (END * count as f64) as usize;
        let cuts = [(i, 0..length), (i, count - length..count)];
        let home = work.join("ends");
        if overlap(known, &cuts) < DIFFERENT {
            all.push(merged_cuts(known, &cuts, program, &home)?);
        }
    }
    Ok(all)
}

/// `count` random pairs of cuts: of each four two show a place alike, one is of one world but shares no view, one is
/// of any maps and shares no view.
///
/// # Errors
/// When the program fails, or files cannot be written or read.
pub fn random_cuts(
    known: &[MapWithTruth],
    count: usize,
    program: &Program,
    work: &Path,
) -> Result<Vec<ScoredPair>> {
    let mut random = Random::new(1);
    let pairs: Vec<[Cut; 2]> =
        (0..count).filter_map(|i| draw(known, &mut random, |cuts| wanted(i, known, cuts))).collect();
    let numbered: Vec<(usize, [Cut; 2])> = pairs.into_iter().enumerate().collect();
    side_by_side(&numbered, |(i, cuts)| merged_cuts(known, cuts, program, &work.join(format!("cuts-{i}"))))
}

/// Whether a drawn pair is of the kind that is number `i`'s turn.
fn wanted(i: usize, known: &[MapWithTruth], cuts: &[Cut; 2]) -> bool {
    let [a, b] = cuts.each_ref().map(|cut| &known[cut.0].sequence);
    match i % 4 {
        0 | 1 => share_world(a, b) && overlap(known, cuts) >= SAME,
        2 => share_world(a, b) && overlap(known, cuts) < DIFFERENT,
        _ => overlap(known, cuts) < DIFFERENT,
    }
}

/// Draws until a pair is as wanted; nothing when that does not come.
fn draw(known: &[MapWithTruth], random: &mut Random, wanted: impl Fn(&[Cut; 2]) -> bool) -> Option<[Cut; 2]> {
    (0..DRAWS)
        .map(|_| [one(known, random), one(known, random)])
        .find(|cuts| !share_keyframes(cuts) && wanted(cuts))
}

/// A random cut of a random map.
fn one(known: &[MapWithTruth], random: &mut Random) -> Cut {
    let map = random.index(known.len());
    let count = known[map].map.keyframes.len();
    let length = (CUT[0] + random.index(CUT[1] - CUT[0] + 1)).min(count);
    let start = random.index(count - length + 1);
    (map, start..start + length)
}

/// Whether two cuts have keyframes in common: it would be the same recording twice.
fn share_keyframes([a, b]: &[Cut; 2]) -> bool {
    a.0 == b.0 && a.1.start < b.1.end && b.1.start < a.1.end
}

/// The largest overlap of two cuts' views, 0–1.
fn overlap(known: &[MapWithTruth], [a, b]: &[Cut; 2]) -> f64 {
    let (first, second) = (&known[a.0], &known[b.0]);
    if !share_world(&first.sequence, &second.sequence) {
        return 0.0;
    }
    let views = |known: &MapWithTruth, range: &Range<usize>| {
        let ids: Vec<_> = known.map.keyframes.keys().skip(range.start).take(range.len()).collect();
        known
            .views
            .iter()
            .filter(|view| ids.binary_search(&&view.keyframe).is_ok())
            .cloned()
            .collect::<Vec<_>>()
    };
    measuring::views::largest_overlap(&views(first, &a.1), &views(second, &b.1))
}

/// Merges two cuts. What was written goes, unless the merge is wrong: then someone will want to see it.
fn merged_cuts(
    known: &[MapWithTruth],
    cuts: &[Cut; 2],
    program: &Program,
    home: &Path,
) -> Result<ScoredPair> {
    let maps: [Map; 2] = cuts.each_ref().map(|(i, range)| cut(&known[*i].map, range.clone()));
    let mut files = Vec::new();
    for (i, map) in maps.iter().enumerate() {
        let folder = home.join(i.to_string());
        std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
        files.push(folder.join("map.mcap"));
        save_map(&files[i], map)?;
    }
    let parts = [0, 1].map(|i| Part { known: &known[cuts[i].0], map: &maps[i] });
    let mut scored = merged(&parts, &files, program, &home.join("out"))?;
    let mut scored = scored.pop().context("the program says nothing of the pair")?;
    let name =
        |(i, range): &Cut| format!("`{}` keyframes {}–{}", known[*i].sequence, range.start, range.end - 1);
    scored.name = format!("{} + {}", name(&cuts[0]), name(&cuts[1]));
    if !matches!(scored.verdict, Verdict::Wrong(_)) {
        std::fs::remove_dir_all(home).with_context(|| format!("{}: cannot be removed", home.display()))?;
    }
    Ok(scored)
}

/// Merges maps all at once and judges every pair.
fn merged(parts: &[Part], maps: &[PathBuf], program: &Program, out: &Path) -> Result<Vec<ScoredPair>> {
    let pairs = (1..parts.len()).flat_map(|source| (0..source).map(move |target| (target, source)));
    let scored = |(target, source): (usize, usize), verdict| {
        let (target, source) = (&parts[target], &parts[source]);
        let name = format!("`{}` + `{}`", target.known.sequence, source.known.sequence);
        ScoredPair { name, common: target.common(source), verdict }
    };
    match program.merge(maps, out, None)? {
        Attempt::Refused(reasons) => {
            Ok(pairs.zip(reasons).map(|(pair, reason)| scored(pair, Verdict::Refused(reason))).collect())
        }
        Attempt::Merged(merged) => {
            let verdict = |pair: (usize, usize), pair_record| {
                Ok(scored(pair, judge(&merged, pair_record, [&parts[pair.0], &parts[pair.1]])?))
            };
            let found = merged.pair_results();
            let all = found.iter().map(|e| verdict((e.target, e.source), e)).collect::<Result<Vec<_>>>()?;
            if !all.iter().any(|scored| matches!(scored.verdict, Verdict::Wrong(_))) {
                merged.remove()?;
            }
            Ok(all)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_of_one_map_must_be_disjoint() {
        assert!(share_keyframes(&[(0, 0..10), (0, 9..20)]));
        assert!(!share_keyframes(&[(0, 0..10), (0, 10..20)]));
        assert!(!share_keyframes(&[(0, 0..10), (1, 5..20)]));
    }
}
