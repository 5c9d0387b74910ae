//! Verdicts on maps that will not change any more, kept under the names that `loopbox merge --verdicts` gives them: for a station that is
//! started again, and for whoever merges the agents' files. Without them nothing is lost but time, and what goes wrong is told.

use crate::fleet::agents::Inputs;
use crate::fleet::remembering::Memory;
use crate::merging::{Input, MergingParams, PairResult, pairs};
use crate::verdicts::{CameraVerdicts, MapDigest};
use anyhow::Result;
use std::path::Path;

/// Verdicts on these maps.
pub(super) struct Keeper<'a> {
    pub folder: &'a Path,
    pub maps: &'a Inputs<Input>,
    pub params: &'a MergingParams,
    pub warn: &'a (dyn Fn(&str) + Sync),
}

impl Keeper<'_> {
    /// Those among kept ones; nothing where a map has no file yet.
    fn verdicts(&self) -> Result<Option<CameraVerdicts<'_>>> {
        let files: Option<Vec<MapDigest>> = self.maps.files.iter().cloned().collect();
        files.map(|files| CameraVerdicts::at(self.folder, files, self.params)).transpose()
    }

    /// Whether it is known what two of these maps, as they are, made of each other.
    fn is_known(&self, memory: &Memory, pair: [usize; 2]) -> bool {
        memory.recall(&self.maps.contents, pair, true).is_some_and(|known| !known.is_due)
    }

    /// Takes up the verdicts that are kept on pairs that would be looked at; whether there is any.
    pub fn recall(&self, memory: &mut Memory) -> bool {
        let recalled = || -> Result<Vec<PairResult>> {
            let Some(verdicts) = self.verdicts()? else { return Ok(Vec::new()) };
            let lacking = pairs(self.maps.inputs.len()).filter(|pair| !self.is_known(memory, *pair));
            lacking.filter_map(|pair| verdicts.get(pair).transpose()).collect()
        };
        let recalled = recalled().unwrap_or_else(|error| {
            (self.warn)(&format!("all pairs are looked at: {error:#}"));
            Vec::new()
        });
        memory.keep(&self.maps.contents, recalled.iter());
        !recalled.is_empty()
    }

    /// Keeps what pairs made of each other, as far as they were looked at as they are.
    pub fn keep(&self, memory: &Memory, pair_results: &[PairResult]) {
        let kept = || -> Result<()> {
            let Some(verdicts) = self.verdicts()? else { return Ok(()) };
            let mut of_maps = pair_results.iter().filter(|one| self.is_known(memory, one.as_given()));
            of_maps.try_for_each(|pair_result| verdicts.put(pair_result))
        };
        if let Err(error) = kept() {
            (self.warn)(&format!("verdicts are not kept: {error:#}"));
        }
    }
}
