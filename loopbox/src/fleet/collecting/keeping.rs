//! Verdicts on maps that will not change any more, kept under the names that `loopbox merge --verdicts` gives them: for a station that is
//! started again, and for whoever merges the agents' files. Without them nothing is lost but time, and what goes wrong is told.

use crate::fleet::agents::Inputs;
use crate::fleet::remembering::Memory;
use crate::merging::verdicts::CameraVerdicts;
use crate::merging::{Input, MergingParams, PairResult, PairResults, pairs};
use crate::store::Sharing;
use crate::verdicts::{MapDigest, VerdictKey, Verdicts};
use anyhow::Result;
use std::path::Path;
use std::time::{Duration, Instant};

/// How often a store is asked anew while maps come. What is wanted of N maps takes N² keys.
const ASKING: Duration = Duration::from_secs(5);
/// How long it is waited for verdicts that are in the store before pairs are looked at.
const ANSWER: Duration = Duration::from_secs(2);

/// What a store was asked for last.
#[derive(Default)]
pub(super) struct Asked {
    /// The maps' files.
    files: Vec<Option<MapDigest>>,
    /// Whether they were all that is to come.
    exactly: bool,
    at: Option<Instant>,
}

/// Verdicts on these maps.
pub(super) struct Keeper<'a> {
    pub folder: &'a Path,
    pub maps: &'a Inputs<Input>,
    pub params: &'a MergingParams,
    pub warn: &'a (dyn Fn(&str) + Sync),
}

impl Keeper<'_> {
    /// Those among kept ones. A map that has no file yet is called by its content, by which none is kept.
    fn verdicts(&self) -> Result<CameraVerdicts<'_>> {
        let content = |map: usize| MapDigest::of_content(&self.maps.contents[map].hash);
        let called = |(map, file): (usize, &Option<MapDigest>)| file.clone().unwrap_or_else(|| content(map));
        let files = self.maps.files.iter().enumerate().map(called).collect();
        Ok(CameraVerdicts::among(Verdicts::at(self.folder)?, files, self.params))
    }

    /// Whether both maps have files.
    fn are_written(&self, pair: [usize; 2]) -> bool {
        pair.iter().all(|map| self.maps.files[*map].is_some())
    }

    /// The pairs of maps with files that would be looked at.
    fn lacking<'b>(&'b self, memory: &'b Memory) -> impl Iterator<Item = [usize; 2]> + 'b {
        let all = pairs(self.maps.inputs.len());
        all.filter(|pair| self.are_written(*pair) && !self.is_known(memory, *pair))
    }

    /// What the verdicts on the pairs of maps with files are called that would be looked at.
    ///
    /// # Errors
    /// When the folder of verdicts cannot be used.
    fn wanted(&self, memory: &Memory) -> Result<Vec<VerdictKey>> {
        let verdicts = self.verdicts()?;
        Ok(self.lacking(memory).map(|pair| verdicts.key(pair)).collect())
    }

    /// Whether it is known what two of these maps, as they are, made of each other.
    fn is_known(&self, memory: &Memory, pair: [usize; 2]) -> bool {
        memory.recall(&self.maps.contents, pair, true).is_some_and(|known| !known.is_due)
    }

    /// Asks a store for the verdicts on pairs that would be looked at, where maps have got files since it was `asked` last; waits for a
    /// moment for those that are there, where the maps are all that is to come.
    pub fn ask(&self, memory: &Memory, sharing: &Sharing, asked: &mut Asked, exactly: bool) {
        let is_same = asked.files == self.maps.files && asked.exactly == exactly;
        let is_early = !exactly && asked.at.is_some_and(|at| at.elapsed() < ASKING);
        if is_same || is_early {
            return;
        }
        *asked = Asked { files: self.maps.files.clone(), exactly, at: Some(Instant::now()) };
        match self.wanted(memory) {
            Ok(wanted) => sharing.want(wanted, if exactly { ANSWER } else { Duration::ZERO }),
            Err(error) => (self.warn)(&format!("the store is not asked for verdicts: {error:#}")),
        }
    }

    /// Takes up the verdicts that are kept on pairs that would be looked at; whether there is any.
    pub fn recall(&self, memory: &mut Memory) -> bool {
        let recalled = || -> Result<Vec<PairResult>> {
            let verdicts = self.verdicts()?;
            self.lacking(memory).filter_map(|pair| verdicts.get(pair).transpose()).collect()
        };
        let recalled = recalled().unwrap_or_else(|error| {
            (self.warn)(&format!("all pairs are looked at: {error:#}"));
            Vec::new()
        });
        memory.keep(&self.maps.contents, recalled.iter());
        !recalled.is_empty()
    }

    /// Keeps what pairs made of each other, as far as they were looked at as they are.
    pub fn keep(&self, memory: &Memory, pair_results: &PairResults) {
        let kept = || -> Result<()> {
            let verdicts = self.verdicts()?;
            let is_kept = |pair: [usize; 2]| self.are_written(pair) && self.is_known(memory, pair);
            let mut of_maps = pair_results.iter().filter(|one| is_kept(one.as_given()));
            of_maps.try_for_each(|pair_result| verdicts.put(&pair_result))
        };
        if let Err(error) = kept() {
            (self.warn)(&format!("verdicts are not kept: {error:#}"));
        }
    }
}
