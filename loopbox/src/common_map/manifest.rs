//! A common map as a manifest: the maps that it is made of, unchanged, and how they lie to each other. `map.mcap`, clouds and reports
//! are made of it when they are asked for; it grows by maps that are new, and leaving maps out undoes their merges.

use super::opened::OpenedMap;
use crate::blobs::FolderBlobs;
use crate::describing::described::describe;
use crate::results::digest::MapDigest;
use crate::results::{MANIFEST, Owner, Results, keep_from, map_file_at};
use crate::verdicts::Verdicts;
use anyhow::{Context, Result, bail, ensure};
use geometry::Swap;
use merge::common_map::{Addresses, Arrangement, Fused, Numbers, Placed};
use place_recog::Vocabulary;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sources::Stop;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// Goes up when older programs would misread it.
const FORMAT: u32 = 1;
/// Where verdicts are kept beside a manifest.
const VERDICTS: &str = "verdicts";

/// A common map, or several of maps that do not hang together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// The version of this format: what makes a JSON file a manifest.
    pub loopbox_manifest: u32,
    /// Version of the program.
    pub version: String,
    /// The maps, in the order in which they were merged.
    pub maps: Vec<ManifestMap>,
    /// Where the verdicts on their pairs are kept: a folder, or the URI of a bucket. Manifests of earlier versions may not say it.
    pub verdicts: Option<PathBuf>,
    /// A common map for each group of agents that hang together; the first is `map.mcap`.
    pub groups: Vec<Arrangement>,
}

/// A map that the common map is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestMap {
    /// What it is called: its agents' names.
    pub name: String,
    /// The file or folder, relative to the manifest's.
    pub path: PathBuf,
    /// The SHA-256 of its file.
    pub sha256: MapDigest,
}

/// The first line of a manifest.
#[derive(Deserialize)]
struct Head {
    loopbox_manifest: u32,
}

/// Whether a file is a manifest.
pub fn is_manifest(path: &Path) -> bool {
    let is_json = path.extension().is_some_and(|extension| extension == "json");
    is_json && fs::read(path).is_ok_and(|text| serde_json::from_slice::<Head>(&text).is_ok())
}

impl Manifest {
    /// That of groups of these maps, which will lie in `folder`; `verdicts` on their pairs are kept there.
    pub(crate) fn new(
        maps: Vec<ManifestMap>,
        verdicts: &Path,
        groups: Vec<Arrangement>,
        folder: &Path,
    ) -> Self {
        let map = |map: ManifestMap| ManifestMap { path: relative(&map.path, folder), ..map };
        Self {
            loopbox_manifest: FORMAT,
            version: env!("CARGO_PKG_VERSION").into(),
            maps: maps.into_iter().map(map).collect(),
            verdicts: Some(relative(verdicts, folder)),
            groups,
        }
    }

    /// Reads the manifest at `file`; its paths are from then on those of the caller.
    ///
    /// # Errors
    /// When it cannot be read, or is of a later format.
    pub fn read(file: &Path) -> Result<Self> {
        let name = || file.display().to_string();
        let text = fs::read(file).with_context(|| format!("{}: cannot be read", name()))?;
        let head: Head =
            serde_json::from_slice(&text).with_context(|| format!("{}: is no manifest", name()))?;
        ensure!(
            head.loopbox_manifest == FORMAT,
            "{}: is a manifest of format {}, and this is of {FORMAT}\nhint: use the loopbox version that wrote it",
            name(),
            head.loopbox_manifest
        );
        let mut manifest: Self =
            serde_json::from_slice(&text).with_context(|| format!("{}: is a damaged manifest", name()))?;
        let folder = file.parent().unwrap_or(Path::new(""));
        manifest.maps.iter_mut().for_each(|map| map.path = resolved(&map.path, folder));
        manifest.verdicts = manifest.verdicts.map(|verdicts| resolved(&verdicts, folder));
        Ok(manifest)
    }

    /// Writes it among results.
    pub(crate) fn write(&self, output: &mut Results) -> Result<()> {
        let path = output.file(MANIFEST)?;
        let text = serde_json::to_vec_pretty(self).context("the manifest cannot be written as JSON")?;
        fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))
    }
}

impl ManifestMap {
    /// Makes sure that the map is there, and the one that the manifest at `file` was made of.
    ///
    /// # Errors
    /// Says which is not.
    pub(crate) fn check(&self, file: &Path) -> Result<()> {
        let Self { name, path, sha256 } = self;
        let (path, file) = (path.display(), file.display());
        let hint =
            format!("hint: put it back, or leave it out: loopbox merge {file} --without {name} --out DIR");
        let Ok(found) = MapDigest::of(&self.path) else {
            bail!("{path}: is missing, and {file} is made of it\n{hint}");
        };
        if found != *sha256 {
            let [found, expected] = [&found, sha256].map(MapDigest::as_str);
            bail!(
                "{path}: is not the map that {file} is made of: its SHA-256 is {found}, not {expected}\n{hint}"
            );
        }
        Ok(())
    }
}

/// The common map of the manifest at `file`, the first where it is several, made of its maps, which `open` opens; `swap` keeps
/// features and words that these lack, as far as it has room.
///
/// # Errors
/// When the manifest or a map cannot be read, or a map is missing or another.
pub(crate) fn assembled(
    file: &Path,
    open: &dyn Fn(&Path) -> Result<OpenedMap>,
    swap: Option<&dyn Swap>,
) -> Result<OpenedMap> {
    let manifest = Manifest::read(file)?;
    let context = || format!("{}: is a damaged manifest", file.display());
    let first = manifest.groups.first().with_context(context)?;
    let numbers: BTreeSet<usize> = first.agents.iter().map(|agent| agent.map).collect();
    let of_number =
        |number: &usize| manifest.maps.get(*number).map(|map| (*number, map)).with_context(context);
    let lines = numbers.iter().map(of_number).collect::<Result<Vec<_>>>()?;
    lines.par_iter().try_for_each(|(_, line)| line.check(file))?;
    let (mut maps, mut warnings) = (BTreeMap::new(), Vec::new());
    let vocabulary = Vocabulary::shipped();
    for (number, line) in lines {
        let mut opened = open(&line.path)?;
        warnings.append(&mut opened.warnings);
        describe(&mut opened.map, &vocabulary, swap);
        maps.insert(number, opened.map);
    }
    let map = first.assemble(&maps).with_context(context)?;
    Ok(OpenedMap { file: file.to_owned(), map, warnings })
}

/// A merge as it begins: the maps that are to be merged, and the folder for its results.
///
/// # Errors
/// As [`Given::at`], of one map alone, and when the folder cannot be written to, or holds results of something else and `force` is not
/// given.
pub(crate) fn begin(
    paths: &[PathBuf],
    without: &[String],
    (folder, force): (&Path, bool),
) -> Result<(Given, Results)> {
    let given = Given::at(paths, without)?;
    refuse_one(&given.maps)?;
    keep_from(folder, &given.maps)?;
    Ok((given, Results::create(folder, &Owner::Merge, force)?))
}

/// # Errors
/// When `stop` was wished.
pub(crate) fn go_on(stop: &Stop) -> Result<()> {
    ensure!(!stop.requested(), "interrupted: no map was written; the verdicts so far are kept");
    Ok(())
}

/// Refuses one map alone.
pub(crate) fn refuse_one(paths: &[PathBuf]) -> Result<()> {
    let [map] = paths else { return Ok(()) };
    bail!(
        "{}: is one map; there is nothing to merge it with\nhint: give two or more: loopbox merge A B --out DIR",
        map.display()
    )
}

/// Maps as they were given to a merge, manifests among them taken apart.
#[derive(Default)]
pub(crate) struct Given {
    /// The maps, those of manifests once.
    pub maps: Vec<PathBuf>,
    /// The files of those that manifests name, which are as they were.
    known: BTreeMap<PathBuf, MapDigest>,
    /// The groups of manifests with their agents' maps and numbers in these.
    groups: Vec<(Agents, Arrangement)>,
    /// Where a manifest says that verdicts on them are kept.
    verdicts: Option<PathBuf>,
}

impl Given {
    /// Those at `paths`, `without` the maps of these names in manifests.
    ///
    /// # Errors
    /// When a manifest cannot be read, one of its maps is missing or another, or none has a name in `without`.
    pub fn at(paths: &[PathBuf], without: &[String]) -> Result<Self> {
        let mut given = Self::default();
        let mut unknown: BTreeSet<&String> = without.iter().collect();
        for path in paths {
            let Some(file) = manifest_at(path) else {
                given.maps.push(path.clone());
                continue;
            };
            let mut manifest = Manifest::read(&file)?;
            let digests: Vec<MapDigest> = manifest.maps.iter().map(|map| map.sha256.clone()).collect();
            given.groups.extend(manifest.groups.drain(..).map(|group| (agents_of(&group, &digests), group)));
            manifest.maps.retain(|map| {
                unknown.remove(&map.name);
                !without.contains(&map.name)
            });
            manifest.maps.par_iter().try_for_each(|map| map.check(&file))?;
            for ManifestMap { path, sha256, .. } in manifest.maps {
                if !given.known.values().any(|known| *known == sha256) {
                    given.maps.push(path.clone());
                    given.known.insert(path, sha256);
                }
            }
            given.verdicts = given.verdicts.or(manifest.verdicts);
        }
        match unknown.first() {
            None => Ok(given),
            Some(name) => bail!("--without {name}: no map of a manifest among the given is called so"),
        }
    }

    /// Where verdicts are kept, and those that are: where it is `named`, else where a manifest says, else beside the manifest that is
    /// written to `folder`.
    ///
    /// # Errors
    /// When a place that is named cannot be used.
    pub fn verdicts(&self, named: Option<&Path>, folder: &Path) -> Result<(PathBuf, Verdicts)> {
        if let Some(place) = named.or(self.verdicts.as_deref()) {
            return Ok((place.to_owned(), Verdicts::at(place)?));
        }
        let place = folder.join(VERDICTS);
        let verdicts = Verdicts::among(Arc::new(FolderBlobs::not_yet_at(&place)));
        Ok((place, verdicts))
    }

    /// Puts the keyframes of groups that a manifest has where it has them: the same agents with the same closures, of the same
    /// program with the same parameters. Says which these are.
    pub fn restore(
        &self,
        (fused, addresses): (&mut [Fused], &[Addresses]),
        digests: &[MapDigest],
        provenance: &[(String, String)],
    ) -> BTreeSet<usize> {
        let placed: Vec<Vec<Placed>> = fused.iter().map(|fused| placed(fused, addresses)).collect();
        let provenance: BTreeMap<String, String> = provenance.iter().cloned().collect();
        let is_settled = |(number, (fused, placed)): (usize, (&mut Fused, Vec<Placed>))| {
            let fresh = Arrangement::of(&fused.map, placed, provenance.clone());
            let agents = agents_of(&fresh, digests);
            let is_same = |(known, group): &&(Agents, Arrangement)| {
                let says = |key: &str| group.provenance.get(key) == fresh.provenance.get(key);
                *known == agents && group.closures == fresh.closures && says("program") && says("parameters")
            };
            let known = self.groups.iter().find(is_same).filter(|_| fused.agents.len() > 1);
            known.filter(|(_, group)| group.put(&mut fused.map).is_ok()).map(|_| number)
        };
        fused.iter_mut().zip(placed).enumerate().filter_map(is_settled).collect()
    }

    /// The files of maps, of which only those that no manifest names are read.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn digests<P: AsRef<Path> + Sync>(&self, paths: &[P]) -> Result<Vec<MapDigest>> {
        let digest = |path: &P| {
            let known = self.known.get(path.as_ref());
            known.map_or_else(|| MapDigest::of(path.as_ref()), |known| Ok(known.clone()))
        };
        paths.par_iter().map(digest).collect()
    }
}

/// The maps of a manifest at this path; the path itself where there is none, or none that can be read.
pub(crate) fn maps_of(path: &Path) -> Vec<PathBuf> {
    let manifest = manifest_at(path).and_then(|file| Manifest::read(&file).ok());
    manifest.map_or(vec![path.to_owned()], |manifest| manifest.maps.into_iter().map(|map| map.path).collect())
}

/// The manifest at a path: itself, or that of a folder in which is no map.
fn manifest_at(path: &Path) -> Option<PathBuf> {
    let (file, _) = map_file_at(path).ok()?;
    is_manifest(&file).then_some(file)
}

/// Agents by their maps' files and their numbers in these.
type Agents = Vec<(Option<MapDigest>, usize)>;

/// The agents of a group of maps that have these files.
fn agents_of(group: &Arrangement, digests: &[MapDigest]) -> Agents {
    group.agents.iter().map(|agent| (digests.get(agent.map).cloned(), agent.agent)).collect()
}

/// How the agents of common maps lie, whose maps have these addresses.
pub(crate) fn arrangements(
    fused: &[Fused],
    addresses: &[Addresses],
    provenance: &[(String, String)],
) -> Vec<Arrangement> {
    let group = |fused: &Fused| {
        let several = fused.agents.len() > 1;
        let provenance = provenance.iter().filter(|_| several).cloned().collect();
        Arrangement::of(&fused.map, placed(fused, addresses), provenance)
    };
    fused.iter().map(group).collect()
}

/// Which maps and agents of them a group holds, and where they lie.
fn placed(fused: &Fused, addresses: &[Addresses]) -> Vec<Placed> {
    let place = |agent: &map::AgentId| {
        let of_map = |(map, addresses): (usize, &Addresses)| {
            addresses.agents().position(|own| own == *agent).map(|agent| (map, agent))
        };
        let (map, number) = addresses.iter().enumerate().find_map(of_map)?;
        let root_from_agent = Numbers::of(&fused.component.agents.get(agent)?.root_from_agent);
        Some(Placed { map, agent: number, root_from_agent })
    };
    fused.agents.iter().filter_map(place).collect()
}

/// A path as seen from a folder; the URI of a bucket as it is.
fn relative(path: &Path, folder: &Path) -> PathBuf {
    if path.to_string_lossy().contains("://") {
        return path.to_owned();
    }
    let [path, folder] =
        [path, folder].map(|path| plain(&std::path::absolute(path).unwrap_or(path.to_owned())));
    let common = path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    up.chain(path.components().skip(common)).collect()
}

/// A path that was relative to a folder.
fn resolved(path: &Path, folder: &Path) -> PathBuf {
    if path.to_string_lossy().contains("://") { path.to_owned() } else { plain(&folder.join(path)) }
}

/// A path without `.` and, where something is before it, `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if matches!(plain.components().next_back(), Some(Component::Normal(_))) => {
                plain.pop();
            }
            other => plain.push(other),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_go_from_a_folder_and_back() {
        for (path, folder) in
            [("out/a", "out/ab"), ("a/map.mcap", "ab"), ("x/../out/a", "out/b/c"), ("a", ".")]
        {
            let stored = relative(Path::new(path), Path::new(folder));
            assert!(stored.is_relative(), "{stored:?}");
            assert_eq!(resolved(&stored, Path::new(folder)), plain(Path::new(path)));
        }
        let uri = Path::new("s3://bucket/verdicts");
        assert_eq!(resolved(&relative(uri, Path::new("out")), Path::new("out")), uri);
    }
}
