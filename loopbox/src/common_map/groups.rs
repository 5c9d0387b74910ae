//! The map, the cloud and the trajectories of each group of agents that hang together.

use super::names::Names;
use crate::results::Results;
use anyhow::Result;
use map::{CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE, Map};
use merge::common_map::Fused;
use std::path::PathBuf;

/// The file of a group's map: the first group's is `map.mcap`.
pub fn map_file(group: usize, fused: &Fused, names: &Names) -> String {
    of_group("map", "mcap", group, names.of(fused.component.root))
}

fn of_group(stem: &str, extension: &str, group: usize, root: &str) -> String {
    match group {
        0 => format!("{stem}.{extension}"),
        _ => format!("{stem}-{root}.{extension}"),
    }
}

/// The map of agents that hang together, as it is written.
pub(crate) struct GroupMap<'a> {
    /// The map; that of one agent alone is its own.
    pub map: &'a Map,
    /// What its agents are called in names of files, in the order of their ids; the group is called by the first.
    pub names: Vec<&'a str>,
}

impl<'a> GroupMap<'a> {
    pub fn of(fused: &'a Fused, names: &'a Names) -> Self {
        Self { map: &fused.map, names: fused.agents.iter().map(|agent| names.of(*agent)).collect() }
    }
}

/// Writes the map, the cloud and the trajectories of each group of agents.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_maps(
    output: &mut Results,
    groups: &[Fused],
    names: &Names,
    provenance: &[(String, String)],
) -> Result<()> {
    let groups: Vec<GroupMap> = groups.iter().map(|fused| GroupMap::of(fused, names)).collect();
    write_groups(output, &groups, provenance)
}

/// [`write_maps`] of any groups.
pub(crate) fn write_groups(
    output: &mut Results,
    groups: &[GroupMap],
    provenance: &[(String, String)],
) -> Result<()> {
    fill(&GroupFiles::of(output, groups)?, groups, provenance)
}

/// Where the files of a group go.
pub(crate) struct GroupFiles {
    map: PathBuf,
    cloud: PathBuf,
    /// In the order of its agents.
    trajectories: Vec<PathBuf>,
}

impl GroupFiles {
    /// The files of groups, among results.
    ///
    /// # Errors
    /// When one of them cannot be made.
    pub fn of(output: &mut Results, groups: &[GroupMap]) -> Result<Vec<Self>> {
        let of_group = |(index, group): (usize, &GroupMap)| {
            let root = group.names.first().copied().unwrap_or_default();
            let map = output.file(of_group("map", "mcap", index, root))?;
            let cloud = output.file(of_group("cloud", "ply", index, root))?;
            let trajectory = |name| output.file(format!("trajectory-{name}.txt"));
            let trajectories = group.names.iter().map(trajectory).collect::<Result<_>>()?;
            Ok(Self { map, cloud, trajectories })
        };
        groups.iter().enumerate().map(of_group).collect()
    }
}

/// Writes groups into their files.
///
/// # Errors
/// Names the file that cannot be written.
pub(crate) fn fill(files: &[GroupFiles], groups: &[GroupMap], provenance: &[(String, String)]) -> Result<()> {
    for (files, group) in files.iter().zip(groups) {
        let map = || {
            // A map of one agent alone was not made here.
            if group.names.len() == 1 {
                return map::save_map(&files.map, group.map);
            }
            let merge_provenance = provenance.iter().cloned().collect();
            map::save_map(&files.map, &Map { merge_provenance, ..group.map.clone() })
        };
        let selection = CloudSelection::of_results(DEFAULT_MAX_RELATIVE_VARIANCE);
        let (map, cloud) = rayon::join(map, || map::save_ply(&files.cloud, group.map, selection));
        map?;
        cloud?;
        for (path, agent) in files.trajectories.iter().zip(group.map.agents.keys()) {
            map::save_tum(path, &group.map.trajectory_of(*agent))?;
        }
    }
    Ok(())
}
