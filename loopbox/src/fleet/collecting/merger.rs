//! How maps of cameras are merged here: by what, and on which threads.

use crate::describing::lower_priority;
use crate::fleet::agents::Inputs;
use crate::fleet::components::Components;
use crate::fleet::prefetch::MergedPair;
use crate::fleet::remembering::Content;
use crate::fleet::remembering::Memory;
use crate::merging::{
    Batch, Groups, Input, Looked, Merging, MergingParams, PairResults, Places, Share, common_map, look,
};
use anyhow::{Context, Result, anyhow};
use map::Identity;
use place_recog::Vocabulary;
use sources::Stop;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// How much is looked at in a batch, of whole maps and of parts.
pub(super) const SHARE: Share = Share { pairs: 64, time: Duration::from_millis(500) };

/// Merges maps of cameras.
pub(super) struct Merger {
    /// By whose words places are recognised.
    pub vocabulary: Arc<Vocabulary>,
    /// How.
    pub params: MergingParams,
    /// Threads that give way to all others, where they do.
    pool: Option<rayon::ThreadPool>,
}

/// What is looked at, as [`Batch`] has it.
pub(super) struct Looking<'a> {
    pub wanted: Option<BTreeMap<[usize; 2], f32>>,
    pub places: BTreeMap<[usize; 2], Places>,
    pub share: Share,
    /// Whether the result is to last.
    pub exactly: bool,
    pub is_awaited: &'a (dyn Fn() -> bool + Sync),
}

impl Looking<'_> {
    /// A share of all pairs, of which no places are known, for now, whatever else comes.
    pub fn share(share: Share) -> Self {
        let places = BTreeMap::new();
        Self { wanted: None, places, share, exactly: false, is_awaited: &|| false }
    }
}

impl Merger {
    /// One that works on one core and gives way to others if it is `in_background`.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub fn new(in_background: bool) -> Result<Self> {
        let pool = in_background.then(|| on_threads(1, true)).transpose()?;
        // Maps that grow are not held up for it.
        let params = MergingParams { joint: false, ..MergingParams::default() };
        Ok(Self { vocabulary: Vocabulary::shipped(), params, pool })
    }

    /// Whether it gives way to nobody.
    pub fn is_alone(&self) -> bool {
        self.pool.is_none()
    }

    /// Gives way to nobody any more.
    pub fn make_haste(&mut self) {
        self.pool = None;
    }

    /// Does something where merging is done.
    pub fn on_pool<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Looks at pairs of maps, but for those that are remembered.
    pub fn look(
        &self,
        maps: &Inputs<Input>,
        memory: &Memory,
        components: &Components,
        looking: Looking,
        stop: &Stop,
    ) -> Result<Looked> {
        let Looking { wanted, places, share, exactly, is_awaited } = looking;
        let go_on = || if stop.requested() { Err(anyhow!("interrupted")) } else { Ok(()) };
        let known = |pair: [usize; 2]| Ok(memory.recall(&maps.contents, pair, exactly));
        let agents: Vec<Identity> = maps.contents.iter().map(|content| content.agent).collect();
        let mut groups = Groups::new(agents.len());
        components.firsts(&agents).into_iter().enumerate().for_each(|(number, first)| {
            groups.join([first, number]);
        });
        let go = Batch {
            known: &known,
            wanted,
            groups,
            places,
            share: Some(share),
            swap: None,
            keep: &|_| Ok(()),
            is_awaited,
        };
        self.on_pool(|| look(&maps.inputs, &self.vocabulary, &self.params, go, &mut |_| go_on()))
    }

    /// Where the agents are by what pairs of maps made of each other, merges `undone` aside: the common map without its joint
    /// pose graph.
    pub fn placed(
        &self,
        maps: &Inputs<Input>,
        pair_results: PairResults,
        undone: &[([usize; 2], String)],
    ) -> Result<Merging> {
        self.on_pool(|| common_map(&maps.inputs, pair_results.into(), &self.params, false, undone))
    }
}

/// So many threads, that give way to all others where that is asked for.
pub(super) fn on_threads(count: usize, low_priority: bool) -> Result<rayon::ThreadPool> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(count);
    let threads = threads.start_handler(move |_| {
        if low_priority {
            lower_priority()
        }
    });
    threads.build().context("cannot start threads")
}

/// The pairs that met, and whose merge stands.
pub(super) fn merged_pairs<'a>(merging: &'a Merging, contents: &[Content]) -> Vec<MergedPair<'a>> {
    let standing = merging.pair_results.joined().filter(|(pair, _)| merging.undone(*pair).is_none());
    let met = standing.filter_map(|([target, source], joined)| {
        let pair_result = merging.pair_results.get([target, source])?;
        let motion = pair_result.accepted()?.closure.motion.a_from_b;
        let agents = [target, source].map(|map| contents[map].agent);
        Some(MergedPair { agents, motion, edges: &joined.edges })
    });
    met.collect()
}
