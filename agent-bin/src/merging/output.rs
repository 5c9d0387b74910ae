//! The folder that merged maps are written into: all results or none.

use super::{Input, MergeRecord, Merging, Names, report};
use anyhow::{Context, Result, bail};
use map::DEFAULT_MAX_RELATIVE_VARIANCE;
use merge::common_map::Fused;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

const MAP: &str = "map.mcap";
const CLOUD: &str = "cloud.ply";
const REPORT: &str = "report.html";
const NUMBERS: &str = "merge.json";

/// Where results grow until all are whole.
const STAGING: &str = "partial.tmp";

/// The folder of the results of a merging. Files are written in a folder within it and moved to their names when all
/// are there; when the work fails before, nothing of it stays.
pub struct MergeOutput {
    folder: PathBuf,
    /// The outermost folder that was made for this; nothing where the folder was there before.
    made: Option<PathBuf>,
    /// What was written, by names relative to the folder.
    files: Vec<PathBuf>,
    committed: bool,
}

impl MergeOutput {
    /// Makes the folder and makes sure that it can be written to.
    ///
    /// # Errors
    /// When it cannot be made or written to.
    pub fn create(folder: &Path) -> Result<Self> {
        let hint = "hint: --out must name a folder that can be made and written to";
        let missing = folder.ancestors().filter(|part| !part.as_os_str().is_empty() && !part.exists());
        let output = Self {
            folder: folder.to_owned(),
            made: missing.last().map(Path::to_owned),
            files: Vec::new(),
            committed: false,
        };
        fs::create_dir_all(folder)
            .with_context(|| format!("{}: the folder cannot be made\n{hint}", folder.display()))?;
        let staging = output.staging();
        if staging.is_dir() {
            fs::remove_dir_all(&staging)
                .with_context(|| format!("{}: cannot be removed", staging.display()))?;
        }
        fs::create_dir(&staging)
            .with_context(|| format!("{}: the folder cannot be written to\n{hint}", folder.display()))?;
        Ok(output)
    }

    /// Refuses to write where a map to be read is: its file would be replaced.
    ///
    /// # Errors
    /// When the folder is that of one of `maps`, files or folders of runs.
    pub fn keep_from(folder: &Path, maps: &[PathBuf]) -> Result<()> {
        let Ok(out) = folder.canonicalize() else { return Ok(()) };
        for map in maps {
            let Ok(found) = map.canonicalize() else { continue };
            let home = if found.is_dir() { Some(found.as_path()) } else { found.parent() };
            if home == Some(&out) {
                bail!(
                    "{}: holds {}, which the results would replace\nhint: give --out another folder",
                    folder.display(),
                    map.display()
                );
            }
        }
        Ok(())
    }

    /// Removes the results of an earlier merging: those of two must not lie side by side.
    ///
    /// # Errors
    /// Names the file that cannot be removed.
    pub fn remove_earlier(&self) -> Result<()> {
        let mut names: BTreeSet<PathBuf> = [MAP, CLOUD, REPORT, NUMBERS].map(PathBuf::from).into();
        names.extend(self.listed());
        for path in names.iter().map(|name| self.folder.join(name)).filter(|path| path.is_file()) {
            fs::remove_file(&path)
                .with_context(|| format!("{}: the earlier result cannot be replaced", path.display()))?;
        }
        Ok(())
    }

    /// The files that an earlier merging says it wrote here.
    fn listed(&self) -> Vec<PathBuf> {
        let text = fs::read_to_string(self.folder.join(NUMBERS)).unwrap_or_default();
        let record: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        let names = record["files"].as_array().into_iter().flatten().filter_map(|name| name.as_str());
        // Plain names only: the file may say anything.
        let plain = |name: &&str| {
            let mut parts = Path::new(name).components();
            matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None))
        };
        names.filter(plain).map(PathBuf::from).collect()
    }

    /// Where to write the file `name`, relative to the folder; its own folder is made.
    ///
    /// # Errors
    /// When that cannot be made.
    pub fn file(&mut self, name: impl AsRef<Path>) -> Result<PathBuf> {
        let path = self.staging().join(&name);
        let parent = path.parent().unwrap_or(&path);
        fs::create_dir_all(parent).with_context(|| format!("{}: cannot be made", parent.display()))?;
        self.files.push(name.as_ref().to_owned());
        Ok(path)
    }

    /// The names of the files so far.
    pub fn names(&self) -> Vec<String> {
        self.files.iter().map(|name| name.display().to_string()).collect()
    }

    /// Gives all files their names.
    ///
    /// # Errors
    /// Names the file that cannot be moved; none stays then.
    pub fn commit(mut self) -> Result<()> {
        for (done, name) in self.files.iter().enumerate() {
            let (from, to) = (self.staging().join(name), self.folder.join(name));
            let moved = to.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::rename(&from, &to));
            if let Err(error) = moved {
                for name in &self.files[..done] {
                    // The first error is the one to report.
                    let _ = fs::remove_file(self.folder.join(name));
                }
                return Err(error).with_context(|| format!("{}: cannot be written", to.display()));
            }
        }
        self.committed = true;
        Ok(())
    }

    fn staging(&self) -> PathBuf {
        self.folder.join(STAGING)
    }
}

impl Drop for MergeOutput {
    fn drop(&mut self) {
        // What cannot be removed is named as what it is.
        let _ = fs::remove_dir_all(self.staging());
        if let (false, Some(made)) = (self.committed, &self.made) {
            let within = self.folder.ancestors().take_while(|part| part.starts_with(made));
            // Only what is empty goes: others may have come to use it.
            within.for_each(|part| drop(fs::remove_dir(part)));
        }
    }
}

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

/// Writes the results of a merging into `output`; `record` learns their names and is written last.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_results(
    output: &mut MergeOutput,
    inputs: &[Input],
    merging: &Merging,
    names: &Names,
    record: &mut MergeRecord,
) -> Result<()> {
    let provenance = merging.provenance(inputs, &record.params);
    write_maps(output, &merging.fused, names, &provenance)?;
    let page = output.file(REPORT)?;
    report::write(&page, inputs, merging)
        .with_context(|| format!("{}: cannot be written", page.display()))?;
    output.file(NUMBERS)?;
    record.files = output.names();
    let path = output.staging().join(NUMBERS);
    let text = serde_json::to_vec_pretty(record).context("the numbers cannot be written as JSON")?;
    fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))
}

/// Writes the map, the cloud and the trajectories of each group of agents.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_maps(
    output: &mut MergeOutput,
    groups: &[Fused],
    names: &Names,
    provenance: &[(String, String)],
) -> Result<()> {
    for (index, fused) in groups.iter().enumerate() {
        let path = output.file(map_file(index, fused, names))?;
        // A map of one agent alone was not made here.
        if fused.agents.len() == 1 {
            map::save_map(path, &fused.map)?;
        } else {
            let merge_provenance = provenance.iter().cloned().collect();
            map::save_map(path, &map::Map { merge_provenance, ..fused.map.clone() })?;
        }
        let cloud = output.file(of_group("cloud", "ply", index, fused, names))?;
        map::save_ply(cloud, &fused.map, DEFAULT_MAX_RELATIVE_VARIANCE)?;
        for (agent, united) in fused.agents.iter().zip(fused.map.agents.keys()) {
            let path = output.file(format!("trajectory-{}.txt", names.of(*agent)))?;
            map::save_tum(path, &fused.map.trajectory_of(*united))?;
        }
    }
    Ok(())
}
