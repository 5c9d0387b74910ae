//! LiDAR maps of several agents brought into one.

pub(crate) mod input;
pub(crate) mod params;
mod record;
pub(crate) mod verdicts;

pub(crate) use input::Files;
pub use input::Input;
pub use params::LidarMergeParams;
pub use record::{DifferenceRecord, EvidenceRecord, InputRecord, LidarMergeRecord, MergeCost, PairRecord};

use super::convert::edge;
use crate::common_map::names::named_pair;
use anyhow::{Result, bail};
use backend::verdict::Answer;
use geometry::{Se3, Sim3};
use map::{AgentId, Edge, EdgeKind, KeyframeId, Map};
use merge::common_map::{Arrangement, Numbers, Placed};
use merge::merge_graph::rigid::{DEVIATION, Joined, RigidMerge, joined};
use slam_lidar::merging::verdict::{Decision, MergeEvidence, Verdict};
use slam_lidar::merging::{MergeMethod, merge_by};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Instant;
use verdicts::LidarVerdicts;

/// A merge that the others contradict ends with a weight below this, and is taken back.
const OUTVOTED: f64 = 0.5;

/// What came of a pair of maps.
pub struct Pair {
    /// The first, by its place among the inputs.
    pub a: usize,
    /// The second.
    pub b: usize,
    /// Whether they belong together, and where.
    pub verdict: Verdict,
    /// The merge's weight among all, 0–1, where it was accepted; one that is outvoted is taken back.
    pub weight: Option<f64>,
    /// Seconds it took.
    pub seconds: f64,
}

impl Pair {
    /// Whether it joins its maps in the result.
    pub fn is_kept(&self) -> bool {
        self.weight.is_some_and(|weight| weight >= OUTVOTED)
    }

    /// Whether it joins its maps because a person said that both show one place.
    pub fn is_confirmed(&self) -> bool {
        self.is_kept() && self.verdict.is_confirmed
    }

    /// What is said of the two: the same place or another.
    pub fn answer(&self) -> Answer {
        match self.weight {
            Some(weight) if weight < OUTVOTED => Answer::CannotTell,
            _ => self.verdict.answer,
        }
    }

    /// The line that decided, for people.
    pub fn reason(&self) -> String {
        match self.weight {
            Some(weight) if weight < OUTVOTED => "taken back: other merges contradict it".into(),
            Some(_) if self.verdict.is_confirmed => {
                "confirmed by a person: what looks otherwise does not keep them apart".into()
            }
            _ => self.verdict.line.to_string(),
        }
    }
}

/// Maps that hang together.
pub struct Group {
    /// The inputs in it, ascending.
    pub members: Vec<usize>,
    /// Where the maps of these lie: `root_from_map`, metres.
    pub root_from_map: Vec<Se3>,
    /// Their maps in the world of the first.
    pub map: Map,
}

/// Maps brought together.
pub struct LidarMerging {
    /// How poses were found.
    pub method: MergeMethod,
    /// Every two of the inputs.
    pub pairs: Vec<Pair>,
    /// Those that hang together, that of the first input first.
    pub groups: Vec<Group>,
    /// Seconds for all pairs.
    pub seconds: f64,
}

impl LidarMerging {
    /// Whether any two maps were joined.
    pub fn any_joined(&self) -> bool {
        self.groups.iter().any(|group| group.members.len() > 1)
    }

    /// How the agents of each group lie, whose inputs came from these files; `provenance` is that of groups of several.
    pub(crate) fn arrangements(&self, files: &Files, provenance: &[(String, String)]) -> Vec<Arrangement> {
        let placed = |(input, root_from_map): (&usize, &Se3)| {
            let ((map, agent), root_from_agent) =
                (files.agents[*input], Numbers::of(&(*root_from_map).into()));
            Placed { map, agent, root_from_agent }
        };
        let group = |group: &Group| {
            let placed: Vec<Placed> = group.members.iter().zip(&group.root_from_map).map(placed).collect();
            let provenance = provenance.iter().filter(|_| placed.len() > 1).cloned().collect();
            Arrangement::of(&group.map, placed, provenance)
        };
        self.groups.iter().map(group).collect()
    }
}

/// Merges maps: compares every pair, optimises the accepted merges jointly, and unites the maps that they connect in the world
/// of the first (EMR-FLOAM, Eq. 11). `stage` is told what is being done; its error ends the merging.
///
/// # Errors
/// With fewer than two inputs, when `stage` fails, or when maps cannot be united.
pub fn merge(
    inputs: &[Input],
    params: &LidarMergeParams,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<LidarMerging> {
    merge_knowing(inputs, params, (&[], None), stage)
}

/// Pairs of inputs of which a person says that both show one place, and what is kept of pairs.
pub(crate) type Known<'a> = (&'a [[usize; 2]], Option<&'a LidarVerdicts<'a>>);

/// The pairs of inputs that `confirm` names as `A+B`.
///
/// # Errors
/// When one names no two inputs.
pub(crate) fn confirmed_pairs(inputs: &[Input], confirm: &[String]) -> Result<Vec<[usize; 2]>> {
    let names: Vec<&str> = inputs.iter().map(|input| &*input.name).collect();
    confirm.iter().map(|text| named_pair(text, &names)).collect()
}

/// The same where something is known of pairs.
///
/// # Errors
/// As [`merge`], and when a verdict cannot be read or kept, or a pair cannot be joined that is confirmed.
pub(crate) fn merge_knowing(
    inputs: &[Input],
    params: &LidarMergeParams,
    known: Known,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<LidarMerging> {
    if inputs.len() < 2 {
        bail!("there is one map only; there is nothing to merge it with");
    }
    let begin = Instant::now();
    let mut pairs = Vec::new();
    for b in 1..inputs.len() {
        for a in 0..b {
            if !known.1.map_or(Ok(false), |verdicts| verdicts.has([a, b]))? {
                stage(&format!("comparing {} and {}", inputs[a].name, inputs[b].name))?;
            }
            pairs.push(compared(inputs, [a, b], params, known)?);
        }
    }
    let joined = join(inputs.len(), &mut pairs);
    let groups = groups(inputs, &pairs, &joined)?;
    Ok(LidarMerging { method: params.method, pairs, groups, seconds: begin.elapsed().as_secs_f64() })
}

/// Two inputs compared, or their verdict taken from those that are kept.
fn compared(
    inputs: &[Input],
    [a, b]: [usize; 2],
    params: &LidarMergeParams,
    (confirm, verdicts): Known,
) -> Result<Pair> {
    let begin = Instant::now();
    // In an order that has nothing to do with how maps are given, so that what is kept is the same to the byte.
    let is_swapped = inputs[b].ready.comes_before(&inputs[a].ready);
    let order @ [first, second] = if is_swapped { [b, a] } else { [a, b] };
    let kept = verdicts.map(|verdicts| verdicts.get(order)).transpose()?.flatten();
    let verdict = match kept {
        Some(verdict) => verdict,
        None => {
            let found = merge_by(params.method, &inputs[first].ready, &inputs[second].ready, &params.prior);
            verdicts.map_or(Ok(()), |verdicts| verdicts.put(order, &found))?;
            found
        }
    };
    let confirmed = || verdict.confirmed(&inputs[first].ready, &inputs[second].ready, &params.prior);
    let verdict = if verdict.decision == Decision::Accepted {
        verdict
    } else if confirm.contains(&[a.min(b), a.max(b)]) {
        let confirmed = confirmed();
        if confirmed.decision != Decision::Accepted {
            let [a, b] = [a, b].map(|input| &inputs[input].name);
            bail!("--confirm {a}+{b}: they cannot be joined: {}", confirmed.line);
        }
        verdicts.map_or(Ok(()), |verdicts| verdicts.confirm(order))?;
        confirmed
    } else if verdicts.map_or(Ok(false), |verdicts| verdicts.is_confirmed(order))? {
        confirmed()
    } else {
        verdict
    };
    let verdict = if is_swapped { verdict.swapped() } else { verdict };
    Ok(Pair { a, b, verdict, weight: None, seconds: begin.elapsed().as_secs_f64() })
}

/// Two inputs compared as if there were no others.
///
/// # Errors
/// When a verdict cannot be read or kept, or they cannot be joined and are confirmed.
pub(crate) fn pair_alone(
    inputs: &[Input],
    pair: [usize; 2],
    params: &LidarMergeParams,
    known: Known,
) -> Result<Pair> {
    let mut pair = compared(inputs, pair, params, known)?;
    pair.weight = accepted(&pair).map(|_| 1.0);
    Ok(pair)
}

/// What was decided of two inputs and by what evidence, for people.
pub(crate) fn summary(inputs: &[Input], pair: &Pair) -> String {
    let [a, b] = [pair.a, pair.b].map(|input| &inputs[input].name);
    let mut text = format!("{a} + {b}: {}: {}\n", decision(pair), pair.reason());
    if let Some(best) = &pair.verdict.best {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "  {}; overlap {:.2}; {:.0} m² are there in both, {:.2} m² in {} areas in one only (ln ratio {:.1}); {} of {} pieces \
             agree ({} found by Scan Context) to {:.0} mm",
            pair.answer(),
            best.overlap,
            best.things.shared,
            best.things.differences.iter().map(|d| d.area).sum::<f64>(),
            best.things.differences.len(),
            best.weighed.ln_ratio,
            best.pieces,
            best.of_pieces,
            best.finding,
            1e3 * best.rmse
        );
    }
    text
}

/// The pose of an accepted pair.
fn accepted(pair: &Pair) -> Option<&MergeEvidence> {
    pair.verdict.best.as_ref().filter(|_| pair.verdict.decision == Decision::Accepted)
}

/// Joins the accepted pairs; those that the others contradict are taken back, and the rest joined anew.
fn join(count: usize, pairs: &mut [Pair]) -> Joined {
    let merge = |pair: &Pair| {
        let best = accepted(pair)?;
        Some(RigidMerge { from: pair.a, to: pair.b, from_from_to: best.a_from_b, trust: best.support })
    };
    let merges: Vec<(usize, RigidMerge)> =
        pairs.iter().enumerate().filter_map(|(i, pair)| Some((i, merge(pair)?))).collect();
    let all = joined(count, &merges.iter().map(|(_, merge)| *merge).collect::<Vec<_>>());
    for ((i, _), weight) in merges.iter().zip(&all.weights) {
        pairs[*i].weight = Some(*weight);
    }
    let kept: Vec<RigidMerge> =
        merges.iter().filter(|(i, _)| pairs[*i].is_kept()).map(|(_, merge)| *merge).collect();
    if kept.len() == merges.len() { all } else { joined(count, &kept) }
}

/// The maps of each group, united.
fn groups(inputs: &[Input], pairs: &[Pair], joined: &Joined) -> Result<Vec<Group>> {
    let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (input, root) in joined.root.iter().enumerate() {
        members.entry(*root).or_default().push(input);
    }
    let group = |members: Vec<usize>| {
        let is_alone = members.len() == 1;
        let place = |input: &usize| if is_alone { Se3::identity() } else { joined.root_from_map[*input] };
        let root_from_map: Vec<Se3> = members.iter().map(place).collect();
        Ok(Group { map: united(inputs, pairs, &members, &root_from_map)?, members, root_from_map })
    };
    members.into_values().map(group).collect()
}

/// The union of the maps of some inputs in the world of the first: Eq. 11, `M_global = ∪ T_i(M_i)`, with `root_from_map` as T_i. In
/// place of its threshold on a confidence, only maps of merges that were accepted and not taken back are joined. The map of one
/// input alone is its own.
fn united(inputs: &[Input], pairs: &[Pair], members: &[usize], root_from_map: &[Se3]) -> Result<Map> {
    if let [alone] = members {
        return Ok(inputs[*alone].map.clone());
    }
    let maps = members.iter().map(|&input| inputs[input].map.clone()).collect();
    let mut map = Map::unite(maps)?;
    let place = |input: usize| members.iter().position(|member| *member == input);
    let poses: Vec<Sim3> = root_from_map.iter().map(|pose| Sim3::from(*pose)).collect();
    for keyframe in map.keyframes.values_mut() {
        if let Some(root_from_map) = poses.get(usize::from(keyframe.agent.0)) {
            keyframe.world_from_keyframe = *root_from_map * keyframe.world_from_keyframe;
        }
    }
    let edges: Vec<Edge> = pairs
        .iter()
        .filter(|pair| pair.is_kept())
        .filter_map(|pair| {
            let (a, b) = (place(pair.a)?, place(pair.b)?);
            link_edge(&map, inputs, pair, [a, b])
        })
        .collect();
    map.edges.extend(edges);
    Ok(map)
}

/// Where two maps were found to belong together: a keyframe of each, by its id in its own map.
pub(crate) struct MapLink {
    /// Of the first map.
    pub from: KeyframeId,
    /// Of the second.
    pub to: KeyframeId,
    /// The second keyframe in the frame of the first.
    pub from_from_to: Se3,
    /// What that errs by, metres and radians.
    pub deviation: (f64, f64),
}

/// The meeting of an accepted pair, where the two ways come nearest: there its error is smallest.
pub(crate) fn map_link(inputs: &[Input], pair: &Pair) -> Option<MapLink> {
    let a_from_b = accepted(pair)?.a_from_b;
    let (a, b) = (&inputs[pair.a], &inputs[pair.b]);
    let (mut nearest, mut found) = (f64::INFINITY, None);
    for (to, other) in b.names.iter().zip(&b.keyframes) {
        let a_from_other = a_from_b * other.world_from_sensor;
        for (from, own) in a.names.iter().zip(&a.keyframes) {
            let apart = (own.world_from_sensor.translation - a_from_other.translation).norm();
            if apart < nearest {
                let from_from_to = own.world_from_sensor.inverse() * a_from_other;
                nearest = apart;
                found = Some(MapLink { from: *from, to: *to, from_from_to, deviation: DEVIATION });
            }
        }
    }
    found
}

/// The edge of a merge between agents of a united map.
fn link_edge(map: &Map, inputs: &[Input], pair: &Pair, agents: [usize; 2]) -> Option<Edge> {
    let met = map_link(inputs, pair)?;
    let first = |agent: usize| {
        let info = map.agents.get(&AgentId(u16::try_from(agent).ok()?))?;
        Some(info.own.as_ref()?.first_keyframe)
    };
    let ends = [KeyframeId(met.from.0 + first(agents[0])?), KeyframeId(met.to.0 + first(agents[1])?)];
    Some(edge(ends, &met.from_from_to, met.deviation, EdgeKind::Merge))
}

/// `accepted`, `undecided` or `refused`.
pub fn decision(pair: &Pair) -> &'static str {
    match pair.verdict.decision {
        Decision::Accepted if pair.is_kept() => "accepted",
        // One that other merges contradict cannot be told.
        Decision::Accepted | Decision::Undecided => "undecided",
        Decision::Refused => "refused",
    }
}

/// Where an input's map lies in its group's.
pub(crate) fn place_of(merging: &LidarMerging, input: usize) -> Se3 {
    let found = merging.groups.iter().find_map(|group| {
        let place = group.members.iter().position(|member| *member == input)?;
        group.root_from_map.get(place).copied()
    });
    found.unwrap_or_else(Se3::identity)
}
