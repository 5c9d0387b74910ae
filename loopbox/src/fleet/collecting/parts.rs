//! Parts of maps by which it is seen whether they met, before all of them is here.

use super::merger::{Looking, Merger, SHARE, merged_pairs};
use super::planning::Planner;
use super::step::Step;
use crate::fleet::agents::{Inputs, Maps, NotUpdated};
use crate::fleet::components::Components;
use crate::fleet::merge_results::{found, lacking};
use crate::fleet::prefetch::Plan;
use crate::fleet::remembering::Content;
use crate::merging::{Input, Merging};
use anyhow::Result;
use fleet::merge_results::{MergeResults, PlacedAgent};
use map::{Identity, KeyframeId};
use sources::Stop;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What is known by parts.
#[derive(Default)]
pub(super) struct Parts {
    maps: Maps,
    /// Keyframes by which parts were looked at; what was looked at once is not taken away from them.
    only: BTreeMap<Identity, BTreeSet<KeyframeId>>,
    found: MergeResults,
}

impl Parts {
    /// What was found by parts beside all that is `known` of whole maps, where nothing is said yet of `pending` pairs, which are
    /// looked at more closely.
    pub fn overlaid_by(&self, known: &MergeResults, pending: Vec<[Identity; 2]>) -> MergeResults {
        let mut found = self.found.clone().overlaid_by(known);
        let names: Vec<[String; 2]> =
            pending.into_iter().map(|pair| pair.map(|agent| agent.to_string())).collect();
        found.postpone(|agents| names.iter().any(|names| agents.iter().all(|agent| names.contains(agent))));
        found
    }

    /// Forgets the maps.
    pub fn tidy(&mut self) {
        self.maps.clear();
        self.only.clear();
    }

    /// What whole maps say stands; of what they do not say yet what was found here, while pairs of them `is_left` or they say it
    /// of less of a map than was looked at here.
    pub fn supersede(&mut self, whole: &MergeResults, is_left: bool) {
        let is_whole = |part: &PlacedAgent| {
            let mut whole = whole.agents.iter().filter(|whole| whole.agent == part.agent);
            whole.any(|whole| whole.keyframes >= part.keyframes)
        };
        let found = std::mem::take(&mut self.found);
        if is_left || !found.agents.iter().all(is_whole) {
            self.found = lacking(found, whole);
        }
    }

    /// Takes in those parts of the maps by which it is to be seen who met whom.
    ///
    /// # Errors
    /// When a map cannot be written.
    pub fn take_in(&mut self, plan: &Plan, merger: &Merger, folder: &Path, step: &Step) -> Result<()> {
        for (agent, keyframes) in plan.ready.iter().flatten() {
            self.only.entry(*agent).or_default().extend(keyframes);
        }
        let place = step.place(folder, &merger.vocabulary);
        for snapshot in &step.all {
            let Some(only) = self.only.get(&snapshot.agent) else { continue };
            match merger.on_pool(|| self.maps.update(snapshot, Some(only), &place)) {
                Ok(_) => {}
                Err(NotUpdated::Wrong(reason)) => step.leave_out(snapshot.agent, reason),
                Err(NotUpdated::Unwritten(error)) => return Err(error),
            }
        }
        Ok(())
    }

    /// Looks at the parts that are taken in, at the pairs which the plan names. Whether anything came of it.
    pub fn look(
        &mut self,
        plan: &Plan,
        components: &Components,
        merger: &Merger,
        step: &Step,
        planner: &mut Planner,
    ) -> bool {
        let maps = self.maps.of_cameras();
        // Parts may have too little depth to be looked at.
        let is_any = maps.inputs.len() > 1;
        let wanted = numbered(&plan.pairs, &maps.contents);
        let mut pairs: BTreeSet<[Identity; 2]> = plan.pairs.iter().map(|(names, _)| *names).collect();
        let look = |comes: &(dyn Fn() -> bool + Sync)| {
            let is_awaited = || plan.is_cut || comes();
            let looking = Looking { wanted: Some(wanted), is_awaited: &is_awaited, ..Looking::share(SHARE) };
            self.look_at(&maps, components, looking, merger, step.stop)
        };
        let looked = is_any.then(|| planner.meanwhile(step, components, merger, &pairs, look)).transpose();
        match looked {
            Ok(Some((left, merging))) => {
                pairs.retain(|names| !left.contains(names));
                planner.prefetcher.record_outcome(
                    &merged_pairs(&merging, &maps.contents),
                    &pairs,
                    &*step.store,
                );
                // Pairs that were forgotten since they were looked at are not among these.
                let mut before = std::mem::take(&mut self.found);
                let there: BTreeSet<String> =
                    step.all.iter().map(|snapshot| snapshot.agent.to_string()).collect();
                before.agents.retain(|agent| there.contains(&agent.agent));
                before
                    .pair_verdicts
                    .retain(|pair_verdict| pair_verdict.agents.iter().all(|agent| there.contains(agent)));
                self.found = before.overlaid_by(&found(&maps.inputs, &merging, &maps.whole, |_| true));
                true
            }
            nothing => {
                planner.prefetcher.record_outcome(&[], &pairs, &*step.store);
                if let (Err(error), false) = (nothing, step.stop.requested()) {
                    (step.warn)(&format!("parts of the maps are not merged: {error:#}"));
                }
                false
            }
        }
    }

    /// Looks at some of the pairs. Those that are left, and what came of all of them.
    fn look_at(
        &mut self,
        maps: &Inputs<Input>,
        components: &Components,
        looking: Looking,
        merger: &Merger,
        stop: &Stop,
    ) -> Result<(BTreeSet<[Identity; 2]>, Merging)> {
        let looked = merger.look(maps, &self.maps.memory, components, looking, stop)?;
        self.maps.memory.keep(&maps.contents, looked.now());
        let left = looked.left.iter().map(|pair| {
            let [a, b] = pair.map(|map| maps.contents[map].agent);
            [a.min(b), a.max(b)]
        });
        let left = left.collect();
        let merging = merger.placed(maps, looked.pair_results, &[])?;
        Ok((left, merging))
    }
}

/// Pairs of agents with how likely each is, by the numbers of their maps.
fn numbered(pairs: &[([Identity; 2], f32)], contents: &[Content]) -> BTreeMap<[usize; 2], f32> {
    let numbers: BTreeMap<Identity, usize> =
        contents.iter().enumerate().map(|(number, content)| (content.agent, number)).collect();
    let numbered = |(names, similarity): &([Identity; 2], f32)| {
        let (a, b) = (*numbers.get(&names[0])?, *numbers.get(&names[1])?);
        Some(([a.min(b), a.max(b)], *similarity))
    };
    pairs.iter().filter_map(numbered).collect()
}
