//! The files that merged maps are written into.

use super::{Input, Manifest, MergeRecord, Merging, Names, report};
use crate::results::Results;
use anyhow::{Context, Result};
use map::{CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE};
use merge::common_map::Fused;
use std::fs;
use std::path::PathBuf;

const REPORT: &str = "report.html";
const NUMBERS: &str = "merge.json";

/// The file of a group's map: the first group's is `map.mcap`.
pub fn map_file(group: usize, fused: &Fused, names: &Names) -> String {
    of_group("map", "mcap", group, fused, names)
}

fn of_group(stem: &str, extension: &str, group: usize, fused: &Fused, names: &Names) -> String {
    match group {
        0 => format!("{stem}.{extension}"),
        _ => format!("{stem}-{}.{extension}", names.of(fused.component.root)),
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
    let files = GroupFiles::of(output, &merging.fused, names)?;
    let page = output.file(REPORT)?;
    let (maps, report) = rayon::join(
        || write_groups(&files, &merging.fused, &provenance),
        || report::write(&page, inputs, merging),
    );
    maps?;
    report.with_context(|| format!("{}: cannot be written", page.display()))?;
    let path = output.file(NUMBERS)?;
    record.files = output.names();
    let text = serde_json::to_vec_pretty(record).context("the numbers cannot be written as JSON")?;
    fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))
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
    write_groups(&GroupFiles::of(output, groups, names)?, groups, provenance)
}

/// Where the files of a group go.
struct GroupFiles {
    map: PathBuf,
    cloud: PathBuf,
    /// In the order of its agents.
    trajectories: Vec<PathBuf>,
}

impl GroupFiles {
    fn of(output: &mut Results, groups: &[Fused], names: &Names) -> Result<Vec<Self>> {
        let of_group = |(index, fused): (usize, &Fused)| {
            let map = output.file(map_file(index, fused, names))?;
            let cloud = output.file(of_group("cloud", "ply", index, fused, names))?;
            let trajectory = |agent| output.file(format!("trajectory-{}.txt", names.of(agent)));
            let trajectories = fused.agents.iter().copied().map(trajectory).collect::<Result<_>>()?;
            Ok(Self { map, cloud, trajectories })
        };
        groups.iter().enumerate().map(of_group).collect()
    }
}

fn write_groups(files: &[GroupFiles], groups: &[Fused], provenance: &[(String, String)]) -> Result<()> {
    for (files, fused) in files.iter().zip(groups) {
        let map = || {
            // A map of one agent alone was not made here.
            if fused.agents.len() == 1 {
                return map::save_map(&files.map, &fused.map);
            }
            let merge_provenance = provenance.iter().cloned().collect();
            map::save_map(&files.map, &map::Map { merge_provenance, ..fused.map.clone() })
        };
        let cloud = || {
            map::save_ply(&files.cloud, &fused.map, CloudSelection::of_results(DEFAULT_MAX_RELATIVE_VARIANCE))
        };
        let (map, cloud) = rayon::join(map, cloud);
        map?;
        cloud?;
        for (path, united) in files.trajectories.iter().zip(fused.map.agents.keys()) {
            map::save_tum(path, &fused.map.trajectory_of(*united))?;
        }
    }
    Ok(())
}
