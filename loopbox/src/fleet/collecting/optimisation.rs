//! The joint pose graph of all maps, and the writing of the common map, by copies that share all that is large: so it can be
//! done while more is merged.

use crate::fleet::agents::Inputs;
use crate::fleet::merge_results::found;
use crate::fleet::remembering::Content;
use crate::merging::{
    Input, MergeRecord, Merging, MergingParams, Names, PairResults, common_map, write_results,
};
use crate::results::Results;
use anyhow::Result;
use fleet::merge_results::MergeResults;
use map::Identity;
use merge::common_map::Fused;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What is to be settled.
pub(super) struct Job {
    /// Counts what the merging looked at: which state of it this is.
    pub revision: u64,
    /// The maps.
    pub maps: Inputs<Input>,
    /// The pairs of which more is to be looked at.
    pub open: BTreeSet<[usize; 2]>,
    /// What they made of each other.
    pub pair_results: Arc<PairResults>,
    /// How they are merged.
    pub params: MergingParams,
    /// Where the common map is written.
    pub results: Results,
    /// Whether it is.
    pub writes: bool,
}

/// What came of it.
pub(super) struct Outcome {
    /// Of which state.
    pub revision: u64,
    /// Where common maps are written.
    pub results: Results,
    /// How long the joint pose graph took.
    pub took: Duration,
    /// The common maps.
    pub optimised: Result<Optimised>,
}

/// The common maps of all agents.
pub(super) struct Optimised {
    /// A map for each group of agents that hang together.
    pub fused: Vec<Fused>,
    /// Where the agents are.
    pub found: MergeResults,
    /// Merges that the joint pose graph took back, and why.
    pub undone: Vec<([Identity; 2], String)>,
    /// Whether any two met; otherwise there is nothing to write.
    pub has_met: bool,
    /// How it was written, if it was to be.
    pub written: Option<Result<()>>,
}

/// Makes the joint pose graph, and writes the common map where that is to be done.
pub(super) fn optimise(mut job: Job) -> Outcome {
    let begun = Instant::now();
    let made = common_map(&job.maps.inputs, std::mem::take(&mut job.pair_results), &job.params, true, &[]);
    let took = begun.elapsed();
    let optimised = made.map(|merging| Optimised {
        found: found(&job.maps.inputs, &merging, &job.maps.whole, |pair| job.open.contains(&pair)),
        undone: undone_by(&merging, &job.maps.contents),
        has_met: merging.any_joined(),
        written: (job.writes && merging.any_joined()).then(|| write(&mut job, &merging)),
        fused: merging.fused,
    });
    Outcome { revision: job.revision, results: job.results, took, optimised }
}

fn write(job: &mut Job, merging: &Merging) -> Result<()> {
    job.results.start_over()?;
    let names = Names::new(&merging.common);
    let mut record = MergeRecord::new(&job.maps.inputs, merging, &job.params, &names)?;
    write_results(&mut job.results, &job.maps.inputs, merging, &names, None, &mut record)?;
    job.results.commit()
}

/// The merges that were taken back, by whose maps they were of, and why.
fn undone_by(merging: &Merging, contents: &[Content]) -> Vec<([Identity; 2], String)> {
    let undone = merging.pair_results.joined().filter_map(|([target, source], _)| {
        let why = merging.undone([target, source])?.to_owned();
        Some(([target.min(source), target.max(source)].map(|map| contents[map].agent), why))
    });
    undone.collect()
}
