//! Closing loops within one map. It is needed when the camera comes back with more drift than patches are searched
//! over, so that tracking alone does not find the old points again.
//!
//! A keyframe with depth proposes old ones by pose and by appearance, and [`evidence`] tests the first: cheap direct
//! alignment, then patches of both sides' keyframes, then reciprocal Sim(3) alignment. If it passes, a Sim(3) pose
//! graph ([`edges`], [`correct`]) spreads the drift over the loop. Then each side's points are found in the other
//! ([`join`]), so that the joint optimisation and the tracker see one place.

mod correct;
mod drift;
pub(crate) mod edges;
mod evidence;
mod join;
pub(crate) mod params;
#[cfg(test)]
mod tests;

use crate::background::Task;
use crate::local_map::LocalMap;
use crate::loops;
use crate::mapping;
use crate::params::Params;
use crate::publish;
use correct::{Correction, GraphJob};
use drift::Reach;
pub use drift::Trajectory;
pub use evidence::NoLoop;
use evidence::Proposal;
pub(crate) use join::match_side;
use map::{Edge, EdgeKind, KeyframeId, Map, PlaceIndex};
pub use params::ClosingParams;
use std::collections::BTreeSet;

/// A loop that stands all tests, not yet closed in the map.
#[derive(Clone, Debug)]
pub(crate) struct FoundLoop {
    /// From the newer to the older keyframe.
    edge: Edge,
    /// Keyframes at its two ends.
    new_side: Vec<usize>,
    old_side: Vec<usize>,
}

impl FoundLoop {
    /// The newer and the older keyframe.
    pub fn keyframes(&self) -> (KeyframeId, KeyframeId) {
        (self.edge.from, self.edge.to)
    }
}

/// Finds loops and closes them; remembers the closed ones and where attempts were futile.
#[derive(Default)]
pub(crate) struct LoopCloser {
    /// Closed loops as they were measured; their relative pose is that of the map.
    closed: Vec<Edge>,
    /// `(newer, older)` keyframe of attempts that failed.
    futile: Vec<(usize, usize)>,
    /// The loop being closed.
    pending: Option<(FoundLoop, Task<Result<Correction, NoLoop>>)>,
}

impl LoopCloser {
    /// Of a map in which these loops are closed.
    pub fn of(closed: Vec<Edge>) -> Self {
        Self { closed, ..Self::default() }
    }

    /// Looks for a loop between a settled keyframe and older ones; one attempt at most.
    pub fn find(
        &mut self,
        local: &LocalMap,
        places: &dyn PlaceIndex,
        keyframe: usize,
        params: &Params,
    ) -> Option<FoundLoop> {
        let p = &params.closing;
        if !p.enabled || keyframe < p.search.min_gap as usize {
            return None;
        }
        let proposal = self.propose(local, places, keyframe, p)?;
        let old = proposal.candidate.keyframe.0 as usize;
        match evidence::test(local, &proposal, params) {
            Ok(found) => Some(found),
            Err(_) => {
                self.note_futile(keyframe, old, p);
                None
            }
        }
    }

    /// The most promising old keyframe that no recent attempt has refused.
    fn propose(
        &self,
        local: &LocalMap,
        places: &dyn PlaceIndex,
        keyframe: usize,
        params: &ClosingParams,
    ) -> Option<Proposal> {
        let reach = Reach::of(local, keyframe, params)?;
        let gap = params.search.min_gap as usize;
        let within: Vec<usize> = (0..(keyframe + 1).saturating_sub(gap))
            .filter(|&old| reach.contains(local, old, params) && !self.is_futile(keyframe, old, params))
            .collect();
        if within.is_empty() {
            return None;
        }
        let joined = joined(local, keyframe, params);
        let admitted: Vec<usize> = within.into_iter().filter(|old| !joined.contains(old)).collect();
        if admitted.is_empty() {
            // Most keyframes end here, before the images of all others are compared.
            return None;
        }
        // The newest are the most alike and of no interest: ask for more than those.
        let wanted = gap + 2 * params.side;
        let mut similar = places.query(local.keyframes[keyframe].pyramid.base(), wanted);
        similar.retain(|place| place.score >= params.min_appearance);
        let current = publish::keyframe(local, keyframe);
        let admitted = admitted.into_iter().map(|old| publish::keyframe(local, old));
        let candidates = loops::candidates(&local.camera, &current, admitted, &similar, &params.search);
        candidates.into_iter().next().map(|candidate| Proposal { keyframe, candidate })
    }

    fn is_futile(&self, keyframe: usize, old: usize, params: &ClosingParams) -> bool {
        let spacing = params.search.spacing as usize;
        self.futile.iter().any(|f| f.1.abs_diff(old) <= spacing && keyframe.abs_diff(f.0) <= params.patience)
    }

    fn note_futile(&mut self, keyframe: usize, old: usize, params: &ClosingParams) {
        self.futile.retain(|f| keyframe.abs_diff(f.0) <= params.patience);
        self.futile.push((keyframe, old));
    }

    /// Begins to close a found loop: its pose graph is made and solved in the background. In a large map, keyframes
    /// older than the loop stay fixed, so the cost is that of the part between its ends.
    pub fn start(&mut self, local: &LocalMap, found: FoundLoop, params: &Params) {
        let is_large = local.keyframes.len() > params.closing.whole_map;
        let oldest = found.old_side.iter().copied().min().filter(|_| is_large).unwrap_or(0);
        let (local, closed, edge) = (local.clone(), self.closed.clone(), found.edge.clone());
        let graph = params.closing.graph.clone();
        let job = move || GraphJob::new(&local, oldest, &closed, edge, &graph).solve();
        self.pending = Some((found, Task::spawn(job)));
    }

    /// Whether a loop is being closed.
    pub fn is_busy(&self) -> bool {
        self.pending.is_some()
    }

    /// Corrects the map by the loop of [`LoopCloser::start`], joins its two ends and optimises; returns the keyframes
    /// that moved. The map is unchanged when the loop contradicts the rest of the graph; `None` when none was begun.
    pub fn finish(
        &mut self,
        local: &mut LocalMap,
        params: &Params,
    ) -> Option<Result<(FoundLoop, BTreeSet<usize>), NoLoop>> {
        let p = &params.closing;
        let (found, task) = self.pending.take()?;
        let before = local.clone();
        let correction = match task.join() {
            Ok(correction) => correction.apply(local),
            Err(refusal) => {
                self.note_futile(found.edge.from.0 as usize, found.edge.to.0 as usize, p);
                return Some(Err(refusal));
            }
        };
        let ends = [&found.new_side, &found.old_side];
        match join_and_optimise(local, ends, 0, params) {
            Ok(polish) => {
                self.closed.push(found.edge.clone());
                let corrected = correction.into_iter().map(|change| change.keyframe);
                Some(Ok((found, corrected.chain(polish).collect())))
            }
            Err(refusal) => {
                *local = before;
                self.note_futile(found.edge.from.0 as usize, found.edge.to.0 as usize, p);
                Some(Err(refusal))
            }
        }
    }

    /// Appends the loops of a map whose keyframes came behind the `count` of this one. What was being closed is left.
    pub fn append(&mut self, other: Self, count: usize) {
        let behind = |id: KeyframeId| KeyframeId(id.0 + count as u32);
        let moved = |edge: Edge| Edge { from: behind(edge.from), to: behind(edge.to), ..edge };
        self.closed.extend(other.closed.into_iter().map(moved));
        self.pending = None;
    }

    /// Parts with the loops among the keyframes behind the first `count`; those between both parts are dropped, and so is one that is
    /// being closed.
    pub fn split_off(&mut self, count: usize) -> Self {
        let own = |id: KeyframeId| Some(KeyframeId(id.0.checked_sub(count as u32)?));
        let later = |edge: &Edge| Some(Edge { from: own(edge.from)?, to: own(edge.to)?, ..edge.clone() });
        let later = Self::of(self.closed.iter().filter_map(later).collect());
        self.closed.retain(|edge| own(edge.from.max(edge.to)).is_none());
        self.futile.retain(|(newer, _)| *newer < count);
        self.pending = None;
        later
    }

    /// The loops that were closed.
    pub fn closed(&self) -> &[Edge] {
        &self.closed
    }
}

/// Closes a loop in a finished map: `edges` between its ends, as others measured them. The keyframes between move to the
/// minimum of the Sim(3) pose graph, and the edges stay in the map as those of a loop.
///
/// # Errors
/// When an edge reveals more drift than the path between its keyframes explains, or the rest of the graph contradicts one; the
/// map is as it was.
pub fn close_loop(map: &mut Map, edges: Vec<Edge>, params: &ClosingParams) -> Result<(), NoLoop> {
    let edges: Vec<Edge> = edges.into_iter().map(|edge| Edge { kind: EdgeKind::Loop, ..edge }).collect();
    let trajectory = Trajectory::of_map(map);
    for edge in &edges {
        let pose = |id| Some(map.keyframes.get(&id)?.world_from_keyframe);
        let (old, new) = (edge.from.min(edge.to), edge.from.max(edge.to));
        let (Some(from), Some(to), Some([_, path_length])) =
            (pose(edge.from), pose(edge.to), trajectory.between(old, new))
        else {
            return Err(NoLoop::NoScale);
        };
        drift::check([from, to], &edge.from_from_to, path_length, params)?;
    }
    let correction = GraphJob::of_map(map, edges.clone(), &params.graph).solve()?;
    map.edges.extend(edges);
    correction.apply_to(map);
    Ok(())
}

/// Lets the keyframes around two that show one place, and lie where they belong, see each other's points, and optimises;
/// tells which keyframes moved. Refuses when the rest of the map pulls the two apart again: what was changed is then to be
/// dropped.
pub(crate) fn join_places(
    local: &mut LocalMap,
    newer: usize,
    older: usize,
    params: &Params,
) -> Result<BTreeSet<usize>, NoLoop> {
    let p = &params.closing;
    let ends = [(newer, older), (older, newer)].map(|(k, other)| evidence::side(local, k, other, p.side));
    join_and_optimise(local, ends.each_ref(), p.min_matched, params)
}

/// Joins the `[newer, older]` ends of a loop, of which at `least` so many points are to be found across.
fn join_and_optimise(
    local: &mut LocalMap,
    [newer, older]: [&Vec<usize>; 2],
    least: usize,
    params: &Params,
) -> Result<BTreeSet<usize>, NoLoop> {
    let p = &params.closing;
    join::join(local, newer, older, &params.track);
    let joined = join::across(local, newer, older);
    if joined < least {
        return Err(NoLoop::FewMatches { found: joined, searched: least });
    }
    let polish = if local.keyframes.len() <= p.whole_map {
        mapping::optimise_all(local, p.iterations, &params.mapping, &|| false)
    } else {
        [older[0], newer[0]].map(|end| mapping::optimise_around(local, end, &params.mapping)).concat()
    };
    let left = join::across(local, newer, older);
    if (left as f32) < p.min_kept * joined as f32 {
        return Err(NoLoop::TakenBack { joined, left });
    }
    Ok(polish.into_iter().map(|change| change.keyframe).collect())
}

/// Keyframes that a keyframe sees one place with already: those it shares points with, and what the nearest and
/// the oldest of those share points with in turn.
fn joined(local: &LocalMap, keyframe: usize, params: &ClosingParams) -> BTreeSet<usize> {
    const NEAREST: usize = 3;
    let sharing = |k: usize| -> Vec<usize> {
        local.covisible(k).into_iter().filter(|c| c.1 >= params.min_shared).map(|c| c.0).collect()
    };
    let near = sharing(keyframe);
    let is_old = |k: usize| keyframe.abs_diff(k) >= params.search.min_gap as usize;
    let mut joined: BTreeSet<usize> = near.iter().copied().collect();
    for (rank, &k) in near.iter().enumerate() {
        if rank < NEAREST || is_old(k) {
            joined.extend(sharing(k));
        }
    }
    joined
}
