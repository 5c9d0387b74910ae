//! A common map without its agents' own maps: where they lie in it, which keyframes were moved besides, and the closures.
//! [`assemble`](Arrangement::assemble) makes the map of it and of the own maps, bit by bit.

use super::CommonMap;
use super::fuse::{alone, united};
use geometry::Sim3;
use map::{AgentId, Edge, EdgeKind, KeyframeId, Map, MapError};
use nalgebra::{Quaternion, SMatrix, UnitQuaternion, Vector3};
use serde::de::{Deserializer, Error};
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::str::FromStr;

/// How the agents of one common map lie to each other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arrangement {
    /// The agents in the order of their ids in the map.
    pub agents: Vec<Placed>,
    /// The keyframes that are elsewhere than their agent's similarity puts them: those that the pose graph or the joint
    /// optimisation moved.
    pub moved: Vec<MovedKeyframe>,
    /// The closures between agents that are believed.
    pub closures: Vec<Closure>,
    /// How the map came to be, as its file says it.
    pub provenance: BTreeMap<String, String>,
}

/// Where an agent's own map lies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placed {
    /// Which of the maps is or holds its own, from 0.
    pub map: usize,
    /// Which of that map's agents it is, from 0.
    pub agent: usize,
    /// Maps the world of its own map into the common one, as `tx ty tz qx qy qz qw scale`.
    pub root_from_agent: Numbers<8>,
}

/// A keyframe that was moved by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MovedKeyframe {
    /// Its id in the common map.
    pub keyframe: u32,
    /// Its pose in the common world, as `tx ty tz qx qy qz qw scale`.
    pub pose: Numbers<8>,
}

/// A closure between two agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Closure {
    /// A keyframe, by its id in the common map.
    pub from: u32,
    /// Another agent's keyframe.
    pub to: u32,
    /// Maps points of `to`'s camera frame and unit into `from`'s.
    pub from_from_to: Numbers<8>,
    /// Its information matrix, column by column, as an edge of the map has it.
    pub information: Numbers<49>,
}

/// Numbers in a line of text with as many digits as it takes to read them back, bit by bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers<const N: usize>(pub [f64; N]);

/// Why maps do not make the common map.
#[derive(Debug, thiserror::Error)]
pub enum AssemblyError {
    /// The maps cannot be in one.
    #[error("{0}")]
    Map(#[from] MapError),
    /// An agent is in none of the maps.
    #[error("map {} has no agent {}", .0, .1)]
    NoAgent(usize, usize),
    /// A keyframe is in none of the maps.
    #[error("none of the maps has keyframe {0}")]
    NoKeyframe(u32),
}

impl Arrangement {
    /// How the agents of a common map lie, each of which is `placed` there, in the order of their ids.
    pub fn of(common: &Map, placed: Vec<Placed>, provenance: BTreeMap<String, String>) -> Self {
        if placed.len() < 2 {
            return Self { agents: placed, moved: Vec::new(), closures: Vec::new(), provenance };
        }
        let places: BTreeMap<AgentId, Sim3> = common
            .agents
            .keys()
            .copied()
            .zip(placed.iter().map(|placed| placed.root_from_agent.sim3()))
            .collect();
        let is_moved = |keyframe: &&map::Keyframe| {
            let own = common.agents.get(&keyframe.agent).and_then(|info| info.own.as_ref());
            let own = own.and_then(|own| own.world_from_keyframe.get(&keyframe.id));
            let place =
                own.zip(places.get(&keyframe.agent)).map(|(own, place)| Numbers::of(&(*place * *own)));
            place.is_none_or(|place| place.bits() != Numbers::of(&keyframe.world_from_keyframe).bits())
        };
        let moved = common.keyframes.values().filter(is_moved).map(|keyframe| MovedKeyframe {
            keyframe: keyframe.id.0,
            pose: Numbers::of(&keyframe.world_from_keyframe),
        });
        let closures = common.edges.iter().filter(|edge| edge.kind == EdgeKind::Merge).map(Closure::of);
        Self { agents: placed, moved: moved.collect(), closures: closures.collect(), provenance }
    }

    /// The common map that `maps` make, by their numbers in [`Placed`]: those that [`CommonMap`] was made of, with all that they had.
    ///
    /// # Errors
    /// When they are others.
    pub fn assemble(&self, maps: &BTreeMap<usize, Map>) -> Result<Map, AssemblyError> {
        let split: BTreeMap<usize, Vec<Map>> = maps
            .iter()
            .map(|(number, map)| (*number, CommonMap::own_maps(map).map(|(_, own)| own).collect()))
            .collect();
        let own = |placed: &Placed| {
            let own = split.get(&placed.map).and_then(|agents| agents.get(placed.agent));
            own.cloned().ok_or(AssemblyError::NoAgent(placed.map, placed.agent))
        };
        let mut own = self.agents.iter().map(own).collect::<Result<Vec<Map>, _>>()?;
        if own.len() == 1 {
            return Ok(alone(own.remove(0)));
        }
        let mut map = united(own)?;
        self.put(&mut map)?;
        for closure in &self.closures {
            let is_missing = |id: &u32| !map.keyframes.contains_key(&KeyframeId(*id));
            if let Some(missing) = [closure.from, closure.to].into_iter().find(is_missing) {
                return Err(AssemblyError::NoKeyframe(missing));
            }
            map.edges.push(closure.edge());
        }
        map.merge_provenance.clone_from(&self.provenance);
        Ok(map)
    }
}

impl Arrangement {
    /// Puts the keyframes of the agents' united map where they are.
    ///
    /// # Errors
    /// When one of them is not there.
    pub fn put(&self, united: &mut Map) -> Result<(), AssemblyError> {
        for (info, placed) in united.agents.values().zip(&self.agents) {
            let place = placed.root_from_agent.sim3();
            for (id, own) in info.own.iter().flat_map(|own| &own.world_from_keyframe) {
                if let Some(keyframe) = united.keyframes.get_mut(id) {
                    keyframe.world_from_keyframe = place * *own;
                }
            }
        }
        for moved in &self.moved {
            let keyframe = united.keyframes.get_mut(&KeyframeId(moved.keyframe));
            keyframe.ok_or(AssemblyError::NoKeyframe(moved.keyframe))?.world_from_keyframe =
                moved.pose.sim3();
        }
        Ok(())
    }
}

impl Closure {
    fn of(edge: &Edge) -> Self {
        let mut information = [0.0; 49];
        information.copy_from_slice(edge.information.as_slice());
        let (from, to) = (edge.from.0, edge.to.0);
        Self { from, to, from_from_to: Numbers::of(&edge.from_from_to), information: Numbers(information) }
    }

    fn edge(&self) -> Edge {
        Edge {
            from: KeyframeId(self.from),
            to: KeyframeId(self.to),
            from_from_to: self.from_from_to.sim3(),
            information: SMatrix::from_column_slice(&self.information.0),
            kind: EdgeKind::Merge,
        }
    }
}

impl Numbers<8> {
    /// Those of a similarity.
    pub fn of(pose: &Sim3) -> Self {
        let [tx, ty, tz, qx, qy, qz, qw] = pose.rigid().to_tum();
        Self([tx, ty, tz, qx, qy, qz, qw, pose.scale])
    }

    /// The similarity, with the rotation as it is: normalising would change its last bits.
    pub fn sim3(&self) -> Sim3 {
        let [tx, ty, tz, qx, qy, qz, qw, scale] = self.0;
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz));
        Sim3::new(rotation, Vector3::new(tx, ty, tz), scale)
    }

    fn bits(&self) -> [u64; 8] {
        self.0.map(f64::to_bits)
    }
}

impl<const N: usize> Serialize for Numbers<N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut text = String::new();
        for (index, number) in self.0.iter().enumerate() {
            // Writing to a String cannot fail.
            let _ = write!(text, "{}{number:?}", if index == 0 { "" } else { " " });
        }
        serializer.serialize_str(&text)
    }
}

impl<'de, const N: usize> Deserialize<'de> for Numbers<N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let numbers: Result<Vec<f64>, _> = text.split(' ').map(f64::from_str).collect();
        let numbers = numbers.ok().filter(|numbers| numbers.iter().all(|number| number.is_finite()));
        let numbers = numbers.and_then(|numbers| <[f64; N]>::try_from(numbers).ok());
        numbers.map(Self).ok_or_else(|| D::Error::custom(format!("\"{text}\" is not {N} numbers")))
    }
}
