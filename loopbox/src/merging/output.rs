//! The files that merged maps are written into.

use super::{Input, Manifest, MergeRecord, Merging, Names, report};
use crate::results::Results;
use anyhow::{Context, Result};
use map::{CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE, Map};
use merge::common_map::Fused;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

const REPORT: &str = "report.html";
const NUMBERS: &str = "merge.json";

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
    fn of(fused: &'a Fused, names: &'a Names) -> Self {
        Self { map: &fused.map, names: fused.agents.iter().map(|agent| names.of(*agent)).collect() }
    }
}

/// Writes the results of a merging into `output`, of which `manifest` is what they are made of; `record` learns their names and is
/// written last.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_results(
    output: &mut Results,
    inputs: &[Input],
    merging: &Merging,
    names: &Names,
    manifest: Option<&Manifest>,
    record: &mut MergeRecord,
) -> Result<()> {
    let provenance = merging.provenance(inputs, &record.params);
    manifest.map_or(Ok(()), |manifest| manifest.write(output))?;
    let groups: Vec<GroupMap> = merging.fused.iter().map(|fused| GroupMap::of(fused, names)).collect();
    let files = GroupFiles::of(output, &groups)?;
    let page = output.file(REPORT)?;
    let (maps, report) =
        rayon::join(|| fill(&files, &groups, &provenance), || report::write(&page, inputs, merging));
    maps?;
    report.with_context(|| format!("{}: cannot be written", page.display()))?;
    let path = output.file(NUMBERS)?;
    record.files = output.names();
    let context = || format!("{}: cannot be written", path.display());
    let mut file = BufWriter::new(File::create(&path).with_context(context)?);
    serde_json::to_writer_pretty(&mut file, record).with_context(context)?;
    file.flush().with_context(context)
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
struct GroupFiles {
    map: PathBuf,
    cloud: PathBuf,
    /// In the order of its agents.
    trajectories: Vec<PathBuf>,
}

impl GroupFiles {
    fn of(output: &mut Results, groups: &[GroupMap]) -> Result<Vec<Self>> {
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

fn fill(files: &[GroupFiles], groups: &[GroupMap], provenance: &[(String, String)]) -> Result<()> {
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
