//! Maps as people name them: a file, or the folder of results that holds one. A manifest is as good as the map that it makes.

pub use crate::common_map::opened::OpenedMap;
pub use crate::results::map_file_at;

use crate::common_map::manifest::{assembled, is_manifest, maps_of};
use crate::results::map_in;
use anyhow::Result;
use geometry::Swap;
use map::{Map, SensorKind, is_map_file, load_map, load_map_swapped};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Whether there is a map at `path`: a map file or a manifest, or a folder of results that holds one.
pub fn is_map(path: &Path) -> bool {
    if path.is_dir() { map_in(path).is_some() } else { is_map_file(path) || is_manifest(path) }
}

/// What maps hold, by the first lines of their files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensors {
    /// Maps of cameras, or none that can be read.
    Cameras,
    /// A LiDAR's among them.
    Lidars,
    /// One that holds agents of both kinds.
    Mixed,
}

/// What the maps at these paths hold.
pub fn sensors_at(maps: &[PathBuf]) -> Sensors {
    let kinds = |path: PathBuf| map::sensors_of(map_file_at(&path).ok()?.0).ok();
    let of_maps: Vec<_> = maps.iter().flat_map(|path| maps_of(path)).filter_map(kinds).collect();
    let has_lidar = |kinds: &BTreeSet<SensorKind>| kinds.contains(&SensorKind::Lidar);
    match of_maps.iter().any(has_lidar) {
        true if of_maps.iter().any(|kinds| kinds.len() > 1) => Sensors::Mixed,
        true => Sensors::Lidars,
        false => Sensors::Cameras,
    }
}

/// Reads the map at `path`, a map file or the folder of results that holds one.
///
/// # Errors
/// When there is none, or it cannot be read.
pub fn open_map(path: &Path) -> Result<OpenedMap> {
    opened(path, None)
}

/// [`open_map`] of a map whose images, depths, features and words `swap` keeps, as far as it has room, from when they are read.
///
/// # Errors
/// As [`open_map`].
pub(crate) fn open_map_swapped(path: &Path, swap: &dyn Swap) -> Result<OpenedMap> {
    opened(path, Some(swap))
}

fn opened(path: &Path, swap: Option<&dyn Swap>) -> Result<OpenedMap> {
    let (file, note) = map_file_at(path)?;
    if is_manifest(&file) {
        return assembled(&file, &|map| of_file(map_file_at(map)?, swap), swap);
    }
    of_file((file, note), swap)
}

fn of_file((file, note): (PathBuf, Option<String>), swap: Option<&dyn Swap>) -> Result<OpenedMap> {
    let loaded = swap.map_or_else(|| load_map(&file), |swap| load_map_swapped(&file, swap))?;
    let of_file = loaded.warnings.iter().map(|warning| format!("{}: {warning}", file.display()));
    let warnings = note.into_iter().chain(of_file).collect();
    Ok(OpenedMap { file, map: with_edges(loaded.map), warnings })
}

/// A map with edges: an agent says them when it ends, and the map of a run that was killed has those that its points make.
fn with_edges(mut map: Map) -> Map {
    if map.edges.is_empty() && map.keyframes.len() > 1 {
        // A map that lacks more than edges says so where more is asked of it.
        map.edges = slam_direct::edges_of(&map).unwrap_or_default();
    }
    map
}

/// What people call a recording: the last part of its path, of a file without the extension.
pub fn recording_name(path: &Path) -> String {
    // A path such as `.` names nothing before it is made whole.
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = if whole.is_dir() { whole.file_name() } else { whole.file_stem() };
    name.map_or_else(|| "recording".into(), |name| name.to_string_lossy().into_owned())
}
