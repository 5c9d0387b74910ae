//! Maps of places that look alike: rows of equal houses, corridors of equal doors, one pavement, car parks. Every two maps
//! of different places must not be merged; two of one place should be.

mod maps;
mod outcome;
pub mod report;

use crate::merging::Program;
use anyhow::{Context, Result, bail};
use loopbox_tests::similar_places::Kind;
use maps::PlaceMap;
pub use outcome::Outcome;
use serde_json::Value;
use std::path::Path;

/// Ways past each place.
const PASSES: u64 = 2;

/// What to measure.
pub struct Plan<'a> {
    /// The program.
    pub program: &'a Program,
    /// Folder for maps and merges.
    pub work: &'a Path,
    /// Pairs of maps of different places that are wanted, at least.
    pub pairs: usize,
    /// Another seed, other places.
    pub seed: u64,
}

/// What came of the pairs of a kind.
pub struct Measured {
    /// The kind.
    pub kind: Kind,
    /// Recordings that gave no map.
    pub unmapped: usize,
    /// Every pair of maps.
    pub pairs: Vec<Outcome>,
    /// Pairs whose maps were given in the other order as well, and those of them with another verdict.
    pub turned: [usize; 2],
}

/// Places of each kind that give so many pairs of different ones.
fn places(pairs: usize) -> u64 {
    let wanted = pairs.div_ceil(Kind::ALL.len()) as u64;
    let count = |places: u64| places * (places - 1) / 2 * PASSES * PASSES;
    (2..).find(|&places| count(places) >= wanted).unwrap_or(2)
}

/// Makes the maps that are missing, and merges every two of a kind.
///
/// # Errors
/// When the program fails, or files cannot be written or read.
pub fn measure(plan: &Plan) -> Result<Vec<Measured>> {
    if plan.pairs == 0 {
        bail!("--strangers 0 measures nothing");
    }
    let measured = Kind::ALL.into_iter().map(|kind| {
        let measured = measure_kind(plan, kind)?;
        eprintln!("{}", report::line(&measured));
        Ok(measured)
    });
    measured.collect()
}

fn measure_kind(plan: &Plan, kind: Kind) -> Result<Measured> {
    let wanted = (0..places(plan.pairs)).flat_map(|place| (0..PASSES).map(move |pass| (place, pass)));
    let wanted: Vec<(u64, u64)> = wanted.collect();
    let folder = plan.work.join(format!("alike-{}", plan.seed));
    let made = maps::make(kind, plan.seed, &wanted, plan.program, &folder)?;
    let unmapped = wanted.len() - made.len();
    let merge = |maps: &[&PlaceMap], name: &str| -> Result<Vec<Outcome>> {
        let name = format!("{}-{name}", maps::name(kind));
        let record = merged(plan.program, maps, &folder.join(name))?;
        outcome::all(&record, maps)
    };
    let all: Vec<&PlaceMap> = made.iter().collect();
    let pairs = merge(&all, "merged")?;
    // A few of them, the other way round.
    let few: Vec<&PlaceMap> = all.iter().copied().take(10).rev().collect();
    let again = merge(&few, "turned")?;
    let other = again.iter().filter(|turned| pairs.iter().any(|pair| pair.differs_from(turned)));
    let turned = [again.len(), other.count()];
    Ok(Measured { kind, unmapped, pairs, turned })
}

/// merge.json of all these maps, in which every pair is judged as if it were alone.
fn merged(program: &Program, maps: &[&PlaceMap], out: &Path) -> Result<Value> {
    // The defaults.
    let params = out.with_extension("toml");
    std::fs::write(&params, "").with_context(|| format!("{}: cannot be written", params.display()))?;
    let files: Vec<_> = maps.iter().map(|map| map.file.clone()).collect();
    let record = program.record(&files, out, &params)?;
    if out.is_dir() {
        std::fs::remove_dir_all(out).with_context(|| format!("{}: cannot be removed", out.display()))?;
    }
    let path = out.with_extension("json");
    std::fs::write(&path, record.to_string())
        .with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_places_as_needed_are_made() {
        assert_eq!(places(16), 2);
        assert_eq!(places(17), 3);
        // 20 places seen twice: 190 pairs of places, four pairs of maps each.
        assert_eq!(places(3000), 20);
    }
}
