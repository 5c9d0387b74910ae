//! Maps of LiDARs to be merged, each agent's own, and the files that they came from.

use crate::common_map::manifest::ManifestMap;
use crate::common_map::names::{name_of, untaken};
use crate::lidar::convert::keyframes;
use crate::results::digest::MapDigest;
use anyhow::{Context, Result, bail};
use map::{Keyframe, KeyframeId, Map};
use slam_lidar::keyframe;
use slam_lidar::merging::robot_map::RobotMap;
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Keyframes lie no farther than this from their map's origin, metres: single precision tells 8 mm apart there, and grids
/// of 0.15 m reach 157 km.
const FARTHEST: f64 = 1e5;

/// A map to be merged.
pub struct Input {
    /// The file or folder it was given as.
    pub path: PathBuf,
    /// What to call it, unique among the inputs: its agent's name.
    pub name: String,
    /// The agent's own map.
    pub map: Map,
    /// The ids of its keyframes that have scans.
    pub(super) names: Vec<KeyframeId>,
    /// These keyframes.
    pub(super) keyframes: Vec<keyframe::Keyframe>,
    /// What it is compared by.
    pub(super) ready: RobotMap,
}

impl Input {
    /// The agents of the maps in `given`, each with its own map: what was merged before is taken apart.
    ///
    /// # Errors
    /// Names the map that is not of LiDARs, or that has no keyframes or some too far away; and those of [`Map::can_unite`].
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
        Self::name_apart(&mut inputs);
        Ok(inputs)
    }

    /// Gives inputs the names of their agents, those that occur again with a number.
    pub(crate) fn name_apart(inputs: &mut [Self]) {
        let mut taken = BTreeSet::new();
        for input in inputs {
            input.name = untaken(&name_of(&input.map), |name| taken.contains(name));
            taken.insert(input.name.clone());
        }
    }

    /// The own map of an agent; `path` says where it came from.
    ///
    /// # Errors
    /// When it has no keyframes, or one that lies too far away.
    pub(crate) fn of(path: PathBuf, map: Map) -> Result<Self> {
        let is_far = |keyframe: &&Keyframe| keyframe.world_from_keyframe.translation.norm() > FARTHEST;
        if let Some(far) = map.keyframes.values().find(is_far) {
            let (distance, id) = (far.world_from_keyframe.translation.norm(), far.id.0);
            bail!(
                "{}: keyframe {id} lies {distance:.1e} m from the map's origin, farther than the {FARTHEST:.0} m that maps may reach",
                path.display()
            );
        }
        let (names, keyframes) = keyframes(&map);
        if keyframes.is_empty() {
            bail!("{}: the map has no keyframes: there is nothing to merge", path.display());
        }
        let ready = RobotMap::new(&keyframes);
        Ok(Self { path, name: name_of(&map), map, names, keyframes, ready })
    }

    /// How many keyframes it is merged by.
    pub fn keyframe_count(&self) -> usize {
        self.keyframes.len()
    }
}

/// The files that inputs came from.
pub(crate) struct Files<'a> {
    /// Their paths, in the order of the inputs.
    pub paths: Vec<&'a PathBuf>,
    /// Of each input the number of its file, and its own among that file's agents.
    pub agents: Vec<(usize, usize)>,
    /// What the inputs of each are called, as `a+b`.
    names: Vec<String>,
}

impl<'a> Files<'a> {
    /// Those of these inputs.
    pub fn of(inputs: &'a [Input]) -> Self {
        let (mut paths, mut agents, mut names) =
            (Vec::<&PathBuf>::new(), Vec::<(usize, usize)>::new(), Vec::new());
        for Input { path, name, .. } in inputs {
            let file = paths.iter().position(|known| *known == path).unwrap_or(paths.len());
            if file == paths.len() {
                paths.push(path);
                names.push(name.clone());
            } else {
                names[file] += &format!("+{name}");
            }
            agents.push((file, agents.iter().filter(|(other, _)| *other == file).count()));
        }
        Self { paths, agents, names }
    }

    /// The files as a manifest names them, which have these digests.
    pub fn listed(&self, digests: &[MapDigest]) -> Vec<ManifestMap> {
        let all = self.paths.iter().zip(&self.names).zip(digests);
        let map = |((path, name), sha256): ((&&PathBuf, &String), &MapDigest)| ManifestMap {
            name: name.clone(),
            path: (*path).clone(),
            sha256: sha256.clone(),
        };
        all.map(map).collect()
    }
}
