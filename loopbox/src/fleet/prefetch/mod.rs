//! Where agents met, found out by as few bytes as it takes: which objects of two maps are worth fetching next, and when
//! there are enough of them to merge these parts.
//!
//! ```text
//! digests of all keyframes → features of those whose words are alike → images and depths at the likeliest place,
//! → merge → those of keyframes that overlap by the motion found → merge → the verdict
//! ```
//!
//! A verdict on parts rests on the same lines as one on whole maps. What of these the rest of both maps is asked for
//! would be empty where only the place itself is here, so that it is asked for before the verdict is told.

mod known_map;
mod pair;

use super::components::Components;
use fleet::manifest::Kind;
use fleet::merge_results::MergeResults;
use fleet::node::MapSnapshot;
use fleet::store::Objects;
use geometry::Sim3;
use known_map::KnownMap;
use map::{Identity, KeyframeId};
use merge::further::{FurtherParams, worth_trying};
use pair::{Budget, Pair, Step};
use place_recog::Vocabulary;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// Further keyframe pairs that are asked for at a motion that was found; at most as many as merging tries.
const CONFIRMING: usize = 4;
/// What is looked at in one batch of maps that are new: with features that were read before it takes some 0.1 s.
const GO: Budget = Budget { keyframes: 2000, choices: 6 };

/// What is known of all agents' maps, and of every two of them.
pub(super) struct Prefetcher {
    vocabulary: Arc<Vocabulary>,
    agents: BTreeMap<Identity, KnownMap>,
    pairs: BTreeMap<[Identity; 2], Pair>,
    /// Agents of whom all is fetched.
    released: BTreeSet<Identity>,
}

/// What is to be done next.
#[derive(Default)]
pub(super) struct Plan {
    /// Objects to be fetched of each agent's map, the most urgent first, and whether all others too.
    pub wanted: BTreeMap<Identity, (Vec<(Kind, u32)>, bool)>,
    /// The keyframes by which it is to be seen now who met whom; nothing while that takes more objects.
    pub ready: Option<BTreeMap<Identity, BTreeSet<KeyframeId>>>,
    /// The pairs of which it is to be seen, the smaller identity first, and how likely each is.
    pub pairs: Vec<([Identity; 2], f32)>,
    /// Whether there is more to look at than fits into one go.
    pub is_cut: bool,
    /// Maps of which all is fetched.
    pub released: BTreeSet<Identity>,
    /// Who told what is none.
    pub wrong: Vec<(Identity, String)>,
}

/// What pairs ask for, taken together.
#[derive(Default)]
struct Asked {
    /// Objects of each agent's map, the most urgent first.
    wanted: BTreeMap<Identity, Vec<(Kind, u32)>>,
    /// Agents of whom no more is fetched than was asked for, until it is seen whom they met.
    busy: BTreeSet<Identity>,
    /// Keyframes by which it is seen who met whom.
    keyframes: BTreeMap<Identity, BTreeSet<KeyframeId>>,
    /// Pairs of which that can be seen by now, and how likely each is.
    pairs: Vec<([Identity; 2], f32)>,
    /// Whether there is more to look at than fits into one go.
    is_cut: bool,
}

impl Asked {
    /// Takes note of what a pair takes next; of its agents those that are kept are busy with it, and some are `away`.
    fn take(
        &mut self,
        names: [Identity; 2],
        step: Step,
        similarity: f32,
        away: &BTreeSet<Identity>,
        is_kept: impl Fn(&Identity) -> bool,
    ) {
        match step {
            Step::Idle => {}
            Step::Later => {
                self.is_cut = true;
                self.busy.extend(names.into_iter().filter(is_kept));
            }
            Step::Waits(digests) => self.want(names, digests),
            Step::Fetch(objects) => {
                let lacking = names.into_iter().zip(&objects).filter(|(_, lacking)| !lacking.is_empty());
                let awaited = lacking.map(|(agent, _)| agent).filter(|agent| away.contains(agent));
                self.busy.extend(kept(names, &awaited.collect()).filter(is_kept));
                self.want(names, objects);
            }
            Step::Ready => {
                self.busy.extend(names.into_iter().filter(is_kept));
                self.pairs.push((names, similarity));
            }
        }
    }

    fn want(&mut self, names: [Identity; 2], objects: [Vec<(Kind, u32)>; 2]) {
        for (agent, objects) in names.into_iter().zip(objects) {
            self.wanted.entry(agent).or_default().push_new(objects);
        }
    }
}

/// Two agents that met, as merging has it.
pub(super) struct MergedPair<'a> {
    /// Whose map is the target, and whose the source.
    pub agents: [Identity; 2],
    /// target_world_from_source_world.
    pub motion: Sim3,
    /// The closures that it rests on.
    pub edges: &'a [map::Edge],
}

impl Prefetcher {
    /// Of nobody yet.
    pub fn new(vocabulary: Arc<Vocabulary>) -> Self {
        let (agents, pairs, released) = Default::default();
        Self { vocabulary, agents, pairs, released }
    }

    /// The pairs among `all`, the smaller identity first, that are left to others, so that what it takes to look at both maps goes
    /// one way only: to the agent with the smaller one, where the other is one's `own`, until its `remote_results` say what became of
    /// it or it takes too long.
    pub fn left_to_others(
        &mut self,
        all: &[Identity],
        own: &[Identity],
        remote_results: &[Arc<MergeResults>],
    ) -> BTreeSet<[Identity; 2]> {
        let others = all.iter().filter(|agent| !own.contains(agent));
        let pairs = others.flat_map(|other| own.iter().map(move |own| [*other, *own]));
        let mut is_left = |pair: &[Identity; 2]| {
            let agents = pair.map(|agent| agent.to_string());
            self.pairs.entry(*pair).or_default().leave(Instant::now())
                && !remote_results.iter().any(|found| found.has_decided(&agents))
        };
        pairs.filter(|[other, own]| other < own).filter(|pair| is_left(pair)).collect()
    }

    /// What to do, by what is here of all agents' maps. Pairs that are looked at `elsewhere`, the smaller identity
    /// first, are left to whoever does; some of the maps are one's `own`. Of agents that are in one component no more is to be
    /// seen by parts of their maps: all of these says how they lie to each other.
    pub fn plan(
        &mut self,
        all: &[MapSnapshot],
        own: &[Identity],
        store: &dyn Objects,
        elsewhere: &BTreeSet<[Identity; 2]>,
        components: &Components,
    ) -> Plan {
        let wrong = self.take_in(all, store, elsewhere);
        let Asked { mut wanted, busy, keyframes, pairs, is_cut } =
            self.ask_pairs(all, store, elsewhere, components);
        self.release(own, &busy, components);
        let of = |agent: &Identity| {
            (*agent, (wanted.remove(agent).unwrap_or_default(), self.released.contains(agent)))
        };
        let wanted = self.agents.keys().map(of).collect();
        let ready = (!pairs.is_empty()).then_some(keyframes);
        Plan { wanted, ready, pairs, is_cut, released: self.released.clone(), wrong }
    }

    /// Takes in what is here of all agents' maps, and forgets who is gone; who told what is none.
    fn take_in(
        &mut self,
        all: &[MapSnapshot],
        store: &dyn Objects,
        elsewhere: &BTreeSet<[Identity; 2]>,
    ) -> Vec<(Identity, String)> {
        let mut wrong = Vec::new();
        for snapshot in all {
            let known_map = self.agents.entry(snapshot.agent).or_default();
            if let Err(reason) = known_map.update(snapshot, store, &self.vocabulary) {
                wrong.push((snapshot.agent, reason));
            }
        }
        let there: BTreeSet<Identity> = all.iter().map(|snapshot| snapshot.agent).collect();
        self.agents.retain(|agent, _| there.contains(agent));
        // What is looked at just now is judged when that is done.
        self.pairs.retain(|names, pair| {
            let is_kept = names.iter().all(|agent| there.contains(agent));
            if !is_kept {
                pair.take_back();
            }
            is_kept || elsewhere.contains(names)
        });
        wrong
    }

    /// What every pair takes next that is not looked at `elsewhere`, as far as one go reaches.
    fn ask_pairs(
        &mut self,
        all: &[MapSnapshot],
        store: &dyn Objects,
        elsewhere: &BTreeSet<[Identity; 2]>,
        components: &Components,
    ) -> Asked {
        let agents: Vec<Identity> = self.agents.keys().copied().collect();
        let away = all.iter().filter(|snapshot| !snapshot.is_near).map(|snapshot| snapshot.agent);
        let away: BTreeSet<Identity> = away.collect();
        let here =
            all.iter().filter(|snapshot| snapshot.missing == 0 && self.released.contains(&snapshot.agent));
        let here: BTreeSet<Identity> = here.map(|snapshot| snapshot.agent).collect();
        let (mut asked, mut budget) = (Asked::default(), GO);
        for names in self.in_order(&agents, &here, components) {
            let pair = self.pairs.entry(names).or_default();
            if elsewhere.contains(&names) {
                asked.busy.extend(kept(names, &away));
                continue;
            }
            let [Some(mut a), Some(mut b)] = names.map(|name| self.agents.remove(&name)) else {
                continue;
            };
            // Who is in a component is fetched for good: it is not waited for what others make of it.
            let is_confirming = pair.is_confirming();
            let is_kept = |agent: &Identity| is_confirming || !components.is_joined(agent);
            let step = pair.step([&mut a, &mut b], store, &self.vocabulary, &mut budget);
            asked.take(names, step, pair.urgency().1, &away, is_kept);
            let keyframes = names.into_iter().zip(pair.keyframes([&a, &b]));
            for (agent, keyframes) in keyframes.filter(|(_, keyframes)| !keyframes.is_empty()) {
                asked.keyframes.entry(agent).or_default().extend(keyframes);
            }
            self.agents.extend(names.into_iter().zip([a, b]));
        }
        asked
    }

    /// Has fetched for good the maps whose digests are all here, and that are about to be compared with none, and so those that
    /// can meet none, or that go on and met one: nobody asks for their further digests then; and those that are overdue, since a
    /// map that grows among many is about to be compared with some of them all the time, and nobody else has it. What is one's own
    /// is here anyway, and is put together when it is to be merged with others.
    fn release(&mut self, own: &[Identity], busy: &BTreeSet<Identity>, components: &Components) {
        let is_alone = |agent: &Identity| {
            let mut others = self.agents.keys().filter(|other| *other != agent);
            !others.any(|other| self.may_meet(agent, other))
        };
        let is_here = |agent: &Identity| {
            self.agents[agent].missing == 0 || is_alone(agent) || components.is_joined(agent)
        };
        let is_done =
            |agent: &&Identity| !busy.contains(*agent) && is_here(agent) || self.agents[*agent].is_overdue();
        let (ready_own, others): (Vec<Identity>, Vec<Identity>) =
            self.agents.keys().filter(is_done).partition(|agent| own.contains(agent));
        self.released.extend(others);
        let meets = |one: &Identity| {
            let mut others = self.released.iter().filter(|other| !own.contains(other));
            others.any(|other| self.may_meet(one, other))
        };
        let paired: Vec<Identity> = ready_own.into_iter().filter(meets).collect();
        self.released.extend(paired);
    }

    /// The pairs that are to be looked at, those aside of whom all is `here` or who are in one component; the smaller identity first, the most urgent before all others.
    fn in_order(
        &mut self,
        agents: &[Identity],
        here: &BTreeSet<Identity>,
        components: &Components,
    ) -> Vec<[Identity; 2]> {
        let firsts = components.firsts(agents);
        let are_here: Vec<bool> = agents.iter().map(|agent| here.contains(agent)).collect();
        let mut order = Vec::new();
        for (number, one) in agents.iter().enumerate() {
            for (at, (other, first)) in agents[..number].iter().zip(&firsts).enumerate() {
                if !self.may_meet(one, other) {
                    continue;
                }
                let pair = self.pairs.entry([*other, *one]).or_default();
                // Where all of both is here, they are merged as wholes anyway.
                let are_whole = are_here[number] && are_here[at];
                if are_whole || *first == firsts[number] && !pair.is_confirming() {
                    if pair.is_pending() {
                        pair.abandon();
                    }
                    continue;
                }
                order.push((pair.urgency(), [*other, *one]));
            }
        }
        // Stable: of equals the first.
        order.sort_by(|(a, _), (b, _)| b.0.cmp(&a.0).then(b.1.total_cmp(&a.1)));
        order.into_iter().map(|(_, names)| names).collect()
    }

    /// Whether two agents may meet; cameras do not meet LiDARs.
    fn may_meet(&self, one: &Identity, other: &Identity) -> bool {
        let prefetcher = self.agents.get(one).zip(self.agents.get(other));
        prefetcher.is_none_or(|(one, other)| one.may_meet(other))
    }

    /// Takes note of what a merge of the parts found of the pairs that were `looked_at`, the smaller identity first: those that
    /// met. Others that were ready meanwhile still are, and who is gone meanwhile met nobody.
    pub fn record_outcome(
        &mut self,
        met: &[MergedPair],
        looked_at: &BTreeSet<[Identity; 2]>,
        store: &dyn Objects,
    ) {
        let is_there = |names: &[Identity; 2]| names.iter().all(|name| self.agents.contains_key(name));
        let ready = looked_at.iter().filter(|names| self.pairs.get(*names).is_some_and(Pair::is_ready));
        let ready: Vec<[Identity; 2]> = ready.filter(|names| is_there(names)).copied().collect();
        for names in ready {
            let found = met.iter().find(|met| names.iter().all(|name| met.agents.contains(name)));
            let keyframes = found.map(|met| self.overlapping(names, met, store));
            let [a, b] = names.map(|name| &self.agents[&name]);
            let Some(pair) = self.pairs.get_mut(&names) else { continue };
            let here = pair.keyframes([a, b]);
            let has_all = |keyframes: &[Vec<KeyframeId>; 2]| {
                keyframes.iter().zip(&here).all(|(wanted, here)| wanted.iter().all(|id| here.contains(id)))
            };
            match keyframes {
                Some(keyframes) if has_all(&keyframes) => pair.mark_merged(),
                keyframes => pair.record_outcome(keyframes),
            }
        }
    }

    /// Pairs of whose maps more is to be looked at before anything is said of them.
    pub fn pending(&self) -> Vec<[Identity; 2]> {
        self.pairs.iter().filter(|(_, pair)| pair.is_pending()).map(|(names, _)| *names).collect()
    }

    /// Takes note of pairs that met by all that is here.
    pub fn mark_merged(&mut self, met: &[MergedPair]) {
        for (names, pair) in &mut self.pairs {
            if met.iter().any(|met| names.iter().all(|name| met.agents.contains(name))) {
                pair.mark_merged();
            }
        }
    }

    /// The keyframes of both agents that overlap by their motion and are to be looked at.
    fn overlapping(
        &self,
        names: [Identity; 2],
        met: &MergedPair,
        store: &dyn Objects,
    ) -> [Vec<KeyframeId>; 2] {
        let [target, source] = met.agents.map(|agent| &self.agents[&agent]);
        let (Some((to_camera, to_poses)), Some((from_camera, from_poses))) =
            (target.places(store), source.places(store))
        else {
            return Default::default();
        };
        let (sources, targets) =
            (source.glimpses(&from_camera, &from_poses), target.glimpses(&to_camera, &to_poses));
        let params = FurtherParams { max_closures: CONFIRMING, ..FurtherParams::default() };
        let pairs = worth_trying(&sources, &targets, &met.motion, met.edges, &params);
        let (of_source, of_target): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
        if names[0] == met.agents[0] { [of_target, of_source] } else { [of_source, of_target] }
    }
}

/// Who of two agents is kept for what is to be seen of both, where some are `awaited` who are not there: these, if any of
/// the two is. When they come back nobody knows, and the other one is not to wait for it.
fn kept(names: [Identity; 2], awaited: &BTreeSet<Identity>) -> impl Iterator<Item = Identity> {
    let is_any = names.iter().any(|agent| awaited.contains(agent));
    names.into_iter().filter(move |agent| !is_any || awaited.contains(agent))
}

/// A list in which everything is once.
trait PushNew<T> {
    fn push_new(&mut self, more: Vec<T>);
}

impl<T: PartialEq> PushNew<T> for Vec<T> {
    fn push_new(&mut self, more: Vec<T>) {
        more.into_iter().for_each(|one| {
            if !self.contains(&one) {
                self.push(one);
            }
        });
    }
}

#[cfg(test)]
mod tests;
