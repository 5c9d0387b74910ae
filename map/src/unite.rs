//! Several agents' maps in one, and each one's own map out of it again.

#[cfg(test)]
mod tests;

use crate::agent::{owner, unique};
use crate::{
    AgentId, AgentInfo, Edge, FramePose, Identity, Keyframe, KeyframeId, Map, MapError, OwnMap, Scan, check,
};
use geometry::GrayImage;
use std::collections::{BTreeMap, BTreeSet};

impl Map {
    /// The disjoint union of maps: all their agents, keyframes, edges and frames under new ids, with unique names. No
    /// edges connect the maps yet.
    ///
    /// Each agent's keyframes keep their poses, so the maps overlap in one world until they are moved. The poses of
    /// the agent's own map are stored, and [`split`](Self::split) restores it. Agents of a map that is itself united
    /// stay as they are, and lose only the map's provenance of its merge.
    ///
    /// # Errors
    /// [`MapError::SameMapTwice`] when two are of one run of one agent: they have one identity, or all keyframes of
    /// one are among the other's. [`MapError::Union`] without maps, with a map that contradicts itself, or with more
    /// agents or keyframes than ids.
    pub fn unite(maps: Vec<Map>) -> Result<Map, MapError> {
        Self::can_unite(&maps.iter().collect::<Vec<_>>())?;
        let mut union = Union { map: Map::without_agents(), names: BTreeSet::new(), next_keyframe: 0 };
        maps.into_iter().try_for_each(|map| union.add(map))?;
        Ok(union.map)
    }

    /// Whether maps may be united: each is whole, and no two are of one run.
    ///
    /// # Errors
    /// Those of [`unite`](Self::unite).
    pub fn can_unite(maps: &[&Map]) -> Result<(), MapError> {
        if maps.is_empty() {
            return Err(MapError::Union("there is no map to unite".into()));
        }
        for map in maps {
            check::agents(map).map_err(MapError::Union)?;
        }
        refuse_same(maps)
    }

    /// Every agent's own map, in order of the agents. Each is bit by bit the map that was united, if since then only
    /// poses of keyframes changed and only edges and observations between agents were added. The words of features,
    /// which only a common map needs, are left out.
    ///
    /// A map that is not united gives its agent's own map.
    pub fn split(&self) -> Vec<Map> {
        self.agents.iter().map(|(agent, info)| self.own_map(*agent, info)).collect()
    }

    /// An agent's own map.
    fn own_map(&self, agent: AgentId, info: &AgentInfo) -> Map {
        let own = info.own.as_ref();
        let is_own = |id: KeyframeId| owner(&self.agents, id) == Some(agent);
        let first = own.map_or(0, |own| own.first_keyframe);
        let mut map = self.renamed_part(is_own, first);
        for (id, keyframe) in &mut map.keyframes {
            keyframe.words = None;
            let pose = own.and_then(|own| own.world_from_keyframe.get(&KeyframeId(id.0 + first)));
            keyframe.world_from_keyframe = pose.copied().unwrap_or(keyframe.world_from_keyframe);
        }
        let name = own.map_or(&info.name, |own| &own.name).clone();
        map.agents.insert(AgentId::default(), AgentInfo { name, own: None, ..info.clone() });
        map
    }

    /// One more than the largest id that is a keyframe's or is referred to; not below where the last agent's
    /// range begins.
    fn id_end(&self) -> u64 {
        let observed = |keyframe: &Keyframe| {
            keyframe.points.iter().flat_map(|point| &point.observations).map(|o| o.keyframe).max()
        };
        let keyframes = self.keyframes.iter().flat_map(|(id, keyframe)| [Some(*id), observed(keyframe)]);
        let edges = self.edges.iter().map(|edge| Some(edge.from.max(edge.to)));
        let frames = self.frames.iter().map(|frame| Some(frame.reference));
        let ids = keyframes.chain(edges).chain(frames).flatten().map(|id| u64::from(id.0) + 1);
        let begun =
            self.agents.values().filter_map(|info| Some(u64::from(info.own.as_ref()?.first_keyframe)));
        ids.chain(begun).max().unwrap_or(0)
    }
}

/// A united map as it grows.
struct Union {
    map: Map,
    names: BTreeSet<String>,
    /// The first id that no keyframe has and nothing refers to.
    next_keyframe: u64,
}

impl Union {
    /// Adds a map under new ids.
    fn add(&mut self, map: Map) -> Result<(), MapError> {
        let end = self.next_keyframe + map.id_end();
        let too_many =
            |what: &str| MapError::Union(format!("together the maps have too many {what} for one"));
        // The range after the last one begins within the ids too.
        let offset =
            u32::try_from(end).map(|_| self.next_keyframe as u32).map_err(|_| too_many("keyframes"))?;
        self.next_keyframe = end;
        let mut agents = BTreeMap::new();
        for (old, info) in map.agents {
            let new = u16::try_from(self.map.agents.len()).map(AgentId).map_err(|_| too_many("agents"))?;
            agents.insert(old, new);
            let own = match info.own {
                Some(own) => own.moved(offset),
                None => OwnMap {
                    name: info.name.clone(),
                    first_keyframe: 0,
                    world_from_keyframe: poses(&map.keyframes),
                }
                .moved(offset),
            };
            let name = unique(&info.name, &mut self.names);
            self.map.agents.insert(new, AgentInfo { name, own: Some(own), ..info });
        }
        let rename = |id: KeyframeId| KeyframeId(id.0 + offset);
        for (id, keyframe) in map.keyframes {
            let agent = agents.get(&keyframe.agent).copied().unwrap_or_default();
            self.map.keyframes.insert(rename(id), renamed(keyframe, agent, rename));
        }
        self.map.edges.extend(map.edges.into_iter().map(|edge| renamed_edge(edge, rename)));
        self.map.frames.extend(map.frames.into_iter().map(|frame| renamed_frame(frame, rename)));
        Ok(())
    }
}

impl OwnMap {
    /// The same, where all ids of the united map have grown by `offset`.
    fn moved(self, offset: u32) -> Self {
        let poses = self.world_from_keyframe.into_iter();
        Self {
            name: self.name,
            first_keyframe: self.first_keyframe + offset,
            world_from_keyframe: poses.map(|(id, pose)| (KeyframeId(id.0 + offset), pose)).collect(),
        }
    }
}

/// The poses of all keyframes.
fn poses(keyframes: &BTreeMap<KeyframeId, Keyframe>) -> BTreeMap<KeyframeId, geometry::Sim3> {
    keyframes.iter().map(|(id, keyframe)| (*id, keyframe.world_from_keyframe)).collect()
}

/// A keyframe of another agent's and with other ids.
pub(crate) fn renamed(
    mut keyframe: Keyframe,
    agent: AgentId,
    rename: impl Fn(KeyframeId) -> KeyframeId,
) -> Keyframe {
    keyframe.id = rename(keyframe.id);
    keyframe.agent = agent;
    for observation in keyframe.points.iter_mut().flat_map(|point| &mut point.observations) {
        observation.keyframe = rename(observation.keyframe);
    }
    keyframe
}

/// An edge between the same keyframes under other ids.
pub(crate) fn renamed_edge(edge: Edge, rename: impl Fn(KeyframeId) -> KeyframeId) -> Edge {
    Edge { from: rename(edge.from), to: rename(edge.to), ..edge }
}

/// A frame relative to the same keyframe under another id.
pub(crate) fn renamed_frame(frame: FramePose, rename: impl Fn(KeyframeId) -> KeyframeId) -> FramePose {
    FramePose { reference: rename(frame.reference), ..frame }
}

/// The images or scans of an agent's keyframes by the bits of their time stamps: what tells agents apart that have no
/// identity, whatever became of poses, depths and names.
type Views<'a> = BTreeMap<u64, (&'a GrayImage, Option<&'a Scan>)>;

/// An agent of one of the maps to be united.
struct Given<'a> {
    map: usize,
    name: &'a str,
    identity: Option<Identity>,
    views: Views<'a>,
}

impl Given<'_> {
    /// Whether this is the same run: of one identity, or the agent with fewer keyframes has none that the other lacks,
    /// which tells copies apart that nobody named. An agent without keyframes holds those of no other.
    fn is_same(&self, other: &Self) -> bool {
        if self.identity.is_some() && self.identity == other.identity {
            return true;
        }
        let (few, many) = if self.views.len() <= other.views.len() { (self, other) } else { (other, self) };
        !few.views.is_empty() && few.views.iter().all(|(time, image)| many.views.get(time) == Some(image))
    }
}

/// Refuses the same run of an agent in two maps.
fn refuse_same(maps: &[&Map]) -> Result<(), MapError> {
    let mut agents: Vec<Given> = Vec::new();
    for (number, map) in maps.iter().enumerate() {
        for (agent, info) in &map.agents {
            let own = map.keyframes.values().filter(|keyframe| keyframe.agent == *agent);
            let views = own.map(|k| (k.timestamp.to_bits(), (&*k.image, k.scan.as_deref()))).collect();
            agents.push(Given { map: number, name: &info.name, identity: info.identity, views });
        }
    }
    for (i, later) in agents.iter().enumerate() {
        let earlier = agents[..i].iter().find(|earlier| earlier.map != later.map && later.is_same(earlier));
        if let Some(earlier) = earlier {
            return Err(MapError::SameMapTwice {
                maps: [earlier.map, later.map],
                agents: [earlier.name.to_owned(), later.name.to_owned()],
            });
        }
    }
    Ok(())
}
