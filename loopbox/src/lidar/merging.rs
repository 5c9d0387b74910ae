//! LiDAR maps of several agents brought into one.

use super::convert::{edge, keyframes};
use anyhow::{Context, Result, bail};
use geometry::{Se3, Sim3};
use map::{AgentId, Edge, EdgeKind, KeyframeId, Map};
use serde::Serialize;
use slam_lidar::keyframe;
use slam_lidar::merging::graph::{Joined, Merge, joined};
use slam_lidar::merging::robot_map::RobotMap;
use slam_lidar::merging::verdict::{Decision, MergeEvidence, Verdict};
use slam_lidar::merging::{MergeMethod, merge_by};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Instant;

/// What a merge errs by at its place, metres and radians: an edge between agents is worth so much.
const DEVIATION: (f64, f64) = (0.02, 0.002);
/// A merge that the others contradict ends with a weight below this, and is taken back.
const OUTVOTED: f64 = 0.5;

/// A map to be merged.
pub struct Input {
    /// The file or folder it was given as.
    pub path: PathBuf,
    /// What to call it, unique among the inputs: its agent's name.
    pub name: String,
    /// The agent's own map.
    pub map: Map,
    names: Vec<KeyframeId>,
    keyframes: Vec<keyframe::Keyframe>,
    ready: RobotMap,
}

impl Input {
    /// The agents of the maps in `given`, each with its own map: what was merged before is taken apart.
    ///
    /// # Errors
    /// Names the map that is not of LiDARs, or that has no keyframes; and those of [`Map::can_unite`].
    pub fn all(given: Vec<(PathBuf, Map)>) -> Result<Vec<Self>> {
        let mut inputs: Vec<Self> = Vec::new();
        Map::can_unite(&given.iter().map(|(_, map)| map).collect::<Vec<_>>())?;
        for (path, map) in given {
            map.of_lidars()
                .with_context(|| format!("{}: cannot be merged with LiDAR maps", path.display()))?;
            for own in map.split() {
                inputs.push(Self::of(path.clone(), own)?);
            }
        }
        let mut taken = BTreeSet::new();
        for input in &mut inputs {
            let (name, mut number) = (input.name.clone(), 2);
            while !taken.insert(input.name.clone()) {
                input.name = format!("{name}-{number}");
                number += 1;
            }
        }
        Ok(inputs)
    }

    fn of(path: PathBuf, map: Map) -> Result<Self> {
        let (names, keyframes) = keyframes(&map);
        if keyframes.is_empty() {
            bail!("{}: the map has no keyframes: there is nothing to merge", path.display());
        }
        let name = map.agents.values().next().map_or_else(String::new, |info| info.name.clone());
        let ready = RobotMap::new(&keyframes);
        Ok(Self { path, name, map, names, keyframes, ready })
    }
}

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
    pub fn holds(&self) -> bool {
        self.weight.is_some_and(|weight| weight >= OUTVOTED)
    }

    /// The line that decided, for people.
    pub fn reason(&self) -> String {
        match self.weight {
            Some(weight) if weight < OUTVOTED => "taken back: other merges contradict it".into(),
            _ => self.verdict.line.to_string(),
        }
    }
}

/// Maps that hang together.
pub struct Group {
    /// The inputs in it, ascending.
    pub members: Vec<usize>,
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
    pub fn anything_met(&self) -> bool {
        self.groups.iter().any(|group| group.members.len() > 1)
    }
}

/// Brings maps together: every pair is tried, the accepted merges are adjusted to each other, and those that hang together
/// become one map in the world of their first. `stage` is told what is being done; its error ends the merging.
///
/// # Errors
/// With fewer than two inputs, when `stage` fails, or when maps cannot be united.
pub fn merge(
    inputs: &[Input],
    method: MergeMethod,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<LidarMerging> {
    if inputs.len() < 2 {
        bail!("there is one map only; there is nothing to merge it with");
    }
    let begin = Instant::now();
    let mut pairs = Vec::new();
    for b in 1..inputs.len() {
        for a in 0..b {
            stage(&format!("comparing {} and {}", inputs[a].name, inputs[b].name))?;
            let begin = Instant::now();
            let verdict = merge_by(method, &inputs[a].ready, &inputs[b].ready);
            pairs.push(Pair { a, b, verdict, weight: None, seconds: begin.elapsed().as_secs_f64() });
        }
    }
    let joined = join(inputs.len(), &mut pairs);
    let groups = groups(inputs, &pairs, &joined)?;
    Ok(LidarMerging { method, pairs, groups, seconds: begin.elapsed().as_secs_f64() })
}

/// The pose of an accepted pair.
fn accepted(pair: &Pair) -> Option<&MergeEvidence> {
    pair.verdict.best.as_ref().filter(|_| pair.verdict.decision == Decision::Accepted)
}

/// Joins the accepted pairs; those that the others contradict are taken back, and the rest joined anew.
fn join(count: usize, pairs: &mut [Pair]) -> Joined {
    let merge = |pair: &Pair| {
        let best = accepted(pair)?;
        Some(Merge { from: pair.a, to: pair.b, from_from_to: best.a_from_b, trust: best.support })
    };
    let merges: Vec<(usize, Merge)> =
        pairs.iter().enumerate().filter_map(|(i, pair)| Some((i, merge(pair)?))).collect();
    let all = joined(count, &merges.iter().map(|(_, merge)| *merge).collect::<Vec<_>>());
    for ((i, _), weight) in merges.iter().zip(&all.weights) {
        pairs[*i].weight = Some(*weight);
    }
    let held: Vec<Merge> =
        merges.iter().filter(|(i, _)| pairs[*i].holds()).map(|(_, merge)| *merge).collect();
    if held.len() == merges.len() { all } else { joined(count, &held) }
}

/// The maps of each group, united.
fn groups(inputs: &[Input], pairs: &[Pair], joined: &Joined) -> Result<Vec<Group>> {
    let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (input, root) in joined.root.iter().enumerate() {
        members.entry(*root).or_default().push(input);
    }
    let group = |members: Vec<usize>| Ok(Group { map: united(inputs, pairs, joined, &members)?, members });
    members.into_values().map(group).collect()
}

/// The maps of some inputs in the world of the first; that of one alone is its own.
fn united(inputs: &[Input], pairs: &[Pair], joined: &Joined, members: &[usize]) -> Result<Map> {
    if let [alone] = members {
        return Ok(inputs[*alone].map.clone());
    }
    let maps = members.iter().map(|&input| inputs[input].map.clone()).collect();
    let mut map = Map::unite(maps)?;
    let place = |input: usize| members.iter().position(|member| *member == input);
    let poses: Vec<Sim3> = members.iter().map(|&input| Sim3::from(joined.root_from_map[input])).collect();
    for keyframe in map.keyframes.values_mut() {
        if let Some(root_from_map) = poses.get(usize::from(keyframe.agent.0)) {
            keyframe.world_from_keyframe = *root_from_map * keyframe.world_from_keyframe;
        }
    }
    let edges: Vec<Edge> = pairs
        .iter()
        .filter(|pair| pair.holds())
        .filter_map(|pair| {
            let (a, b) = (place(pair.a)?, place(pair.b)?);
            meeting(&map, inputs, pair, [a, b])
        })
        .collect();
    map.edges.extend(edges);
    Ok(map)
}

/// The edge of a merge, where the two ways come nearest: there its error is smallest.
fn meeting(map: &Map, inputs: &[Input], pair: &Pair, agents: [usize; 2]) -> Option<Edge> {
    let a_from_b = accepted(pair)?.a_from_b;
    let (a, b) = (&inputs[pair.a], &inputs[pair.b]);
    let (mut nearest, mut found) = (f64::INFINITY, None);
    for (j, other) in b.keyframes.iter().enumerate() {
        let a_from_other = a_from_b * other.world_from_sensor;
        for (i, own) in a.keyframes.iter().enumerate() {
            let apart = (own.world_from_sensor.translation - a_from_other.translation).norm();
            if apart < nearest {
                (nearest, found) = (apart, Some((i, j, own.world_from_sensor.inverse() * a_from_other)));
            }
        }
    }
    let (i, j, from_from_to): (usize, usize, Se3) = found?;
    let first = |agent: usize| {
        let info = map.agents.get(&AgentId(u16::try_from(agent).ok()?))?;
        Some(info.own.as_ref()?.first_keyframe)
    };
    let ends = [
        KeyframeId(a.names.get(i)?.0 + first(agents[0])?),
        KeyframeId(b.names.get(j)?.0 + first(agents[1])?),
    ];
    Some(edge(ends, &from_from_to, DEVIATION, EdgeKind::Merge))
}

/// The numbers of a merging: what `merge.json` holds.
#[derive(Clone, Debug, Serialize)]
pub struct LidarMergeRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The kind of the agents' sensors.
    pub sensor: map::SensorKind,
    /// How poses between maps were found.
    pub method: MergeMethod,
    /// The maps given.
    pub inputs: Vec<InputRecord>,
    /// Every two of them.
    pub encounters: Vec<EncounterRecord>,
    /// Names of the inputs that hang together.
    pub groups: Vec<Vec<String>>,
    /// Time and memory.
    pub cost: MergeCost,
    /// The files of results, by names relative to their folder.
    pub files: Vec<String>,
}

/// A map given.
#[derive(Clone, Debug, Serialize)]
pub struct InputRecord {
    /// Its path as given.
    pub path: String,
    /// What it is called.
    pub name: String,
    /// Its keyframes.
    pub keyframes: usize,
    /// Points of their scans.
    pub points: usize,
    /// `world_from_map` as `tx ty tz qx qy qz qw`: its place in the common map.
    pub world_from_map: [f64; 7],
}

/// What came of two maps.
#[derive(Clone, Debug, Serialize)]
pub struct EncounterRecord {
    /// Their names.
    pub maps: [String; 2],
    /// `accepted`, `undecided` or `refused`.
    pub decision: &'static str,
    /// The line that decided.
    pub reason: String,
    /// The pose that was judged, with its evidence.
    pub best: Option<EvidenceRecord>,
    /// Other poses that were followed.
    pub rivals: Vec<EvidenceRecord>,
    /// Seconds it took.
    pub seconds: f64,
}

/// What speaks for a pose between two maps.
#[derive(Clone, Debug, Serialize)]
pub struct EvidenceRecord {
    /// The second map in the frame of the first, `tx ty tz qx qy qz qw`.
    pub first_from_second: [f64; 7],
    /// Pieces of one of the maps that come back to this pose when displaced.
    pub pieces: usize,
    /// Of them, those that Scan Context brought here.
    pub finding: usize,
    /// Pieces that map has.
    pub of_pieces: usize,
    /// Share of points on surfaces that the other saw.
    pub overlap: f64,
    /// Share of the points that agree with them.
    pub agreeing: f64,
    /// Share of the points in space that the other saw free.
    pub violated: f64,
    /// Surface that both maps saw, square metres.
    pub shared_m2: f64,
    /// The largest thing that one map holds and the other looks through, square metres.
    pub absent_m2: f64,
    /// Root mean square distance from surfaces, metres.
    pub rmse_m: f64,
    /// Directions of the pose that are weak.
    pub weak: usize,
}

impl EvidenceRecord {
    fn of(evidence: &MergeEvidence) -> Self {
        Self {
            first_from_second: evidence.a_from_b.to_tum(),
            pieces: evidence.pieces,
            finding: evidence.finding,
            of_pieces: evidence.of_pieces,
            overlap: evidence.overlap,
            agreeing: evidence.agreeing,
            violated: evidence.violated,
            shared_m2: evidence.things.shared,
            absent_m2: evidence.things.absent,
            rmse_m: evidence.rmse,
            weak: evidence.conditioning.weak,
        }
    }
}

/// Time and memory of a merging.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MergeCost {
    /// Seconds for all pairs and the common map.
    pub merge_s: f64,
    /// CPU seconds of the process; who runs the program fills it in, as what follows.
    pub cpu_s: Option<f64>,
    /// Largest resident memory, bytes.
    pub peak_memory_bytes: Option<u64>,
}

impl LidarMergeRecord {
    /// The numbers of a merging of `inputs`.
    pub fn of(inputs: &[Input], merging: &LidarMerging) -> Self {
        let name = |input: usize| inputs[input].name.clone();
        let encounter = |pair: &Pair| EncounterRecord {
            maps: [name(pair.a), name(pair.b)],
            decision: decision(pair),
            reason: pair.reason(),
            best: pair.verdict.best.as_ref().map(EvidenceRecord::of),
            rivals: pair.verdict.rivals.iter().map(EvidenceRecord::of).collect(),
            seconds: pair.seconds,
        };
        let input = |(index, input): (usize, &Input)| InputRecord {
            path: input.path.display().to_string(),
            name: input.name.clone(),
            keyframes: input.keyframes.len(),
            points: input.keyframes.iter().map(|keyframe| keyframe.points.len()).sum(),
            world_from_map: place_of(merging, input, index).to_tum(),
        };
        Self {
            version: env!("CARGO_PKG_VERSION"),
            sensor: map::SensorKind::Lidar,
            method: merging.method,
            inputs: inputs.iter().enumerate().map(input).collect(),
            encounters: merging.pairs.iter().map(encounter).collect(),
            groups: merging.groups.iter().map(|g| g.members.iter().map(|&m| name(m)).collect()).collect(),
            cost: MergeCost { merge_s: merging.seconds, ..MergeCost::default() },
            files: Vec::new(),
        }
    }
}

/// `accepted`, `undecided` or `refused`.
pub fn decision(pair: &Pair) -> &'static str {
    match pair.verdict.decision {
        Decision::Accepted if pair.holds() => "accepted",
        Decision::Undecided => "undecided",
        Decision::Accepted | Decision::Refused => "refused",
    }
}

/// Where an input's map lies in its group's.
fn place_of(merging: &LidarMerging, input: &Input, index: usize) -> Se3 {
    let found = merging.groups.iter().find_map(|group| {
        let place = group.members.iter().position(|member| *member == index)?;
        let agent = AgentId(u16::try_from(place).ok()?);
        let moved = group.map.keyframes.values().find(|keyframe| keyframe.agent == agent)?;
        let own = input.keyframes.first()?;
        Some(moved.world_from_keyframe.rigid() * own.world_from_sensor.inverse())
    });
    found.unwrap_or_else(Se3::identity)
}
