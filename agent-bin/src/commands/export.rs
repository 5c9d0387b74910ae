//! `loopbox export`: a map in the formats of other tools.

use super::info_map::load_at;
use crate::console::{say, tell};
use anyhow::ensure;
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Map, MapError, StampedPose};
use std::path::{Path, PathBuf};

/// Write a map's cloud or trajectory in the format of another tool
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// The map: a map.mcap, or the folder that `loopbox run` or `loopbox merge` wrote
    #[arg(value_name = "MAP")]
    pub map: PathBuf,
    /// Which files to write.
    #[command(flatten)]
    pub outputs: Outputs,
    /// Leave out points whose variance of inverse depth over its square is larger: 0.01 keeps depths
    /// known to 10 %, 0.0001 those known to 1 %
    #[arg(long, value_name = "V", default_value_t = DEFAULT_MAX_RELATIVE_VARIANCE)]
    pub max_variance: f32,
}

/// The files to write; one at least.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = true)]
pub struct Outputs {
    /// Point cloud as binary PLY: x y z intensity confidence, and of several agents red green blue agent
    #[arg(long, value_name = "FILE")]
    pub ply: Option<PathBuf>,
    /// Point cloud as binary PCD: x y z intensity confidence, and of several agents rgb label
    #[arg(long, value_name = "FILE")]
    pub pcd: Option<PathBuf>,
    /// Trajectory as TUM text: timestamp tx ty tz qx qy qz qw; of several agents a file each, FILE with the
    /// agent's name at the end of its own
    #[arg(long, value_name = "FILE")]
    pub tum: Option<PathBuf>,
    /// Trajectory as KITTI text: the upper 3×4 of each pose, row by row; of several agents as --tum
    #[arg(long, value_name = "FILE")]
    pub kitti: Option<PathBuf>,
    /// The map itself as a whole file, with everything viewers show: mends the file of a killed run
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
}

/// Runs `loopbox export`.
///
/// # Errors
/// When the map cannot be loaded, a file cannot be written or the bound is not a positive number.
pub fn run(args: &ExportArgs) -> anyhow::Result<()> {
    ensure!(args.max_variance > 0.0, "--max-variance is {}; give a number above 0", args.max_variance);
    let map = load_at(&args.map)?;
    if map.keyframes.values().all(|keyframe| keyframe.semi_dense.is_empty() && keyframe.scan.is_none()) {
        tell!("warning: {}: no keyframe has depth: clouds of it are empty", args.map.display());
    }
    write_clouds(&args.outputs, &map, args.max_variance)?;
    if let Some(path) = &args.outputs.tum {
        write_trajectories(path, &map, |path, trajectory| map::save_tum(path, trajectory))?;
    }
    if let Some(path) = &args.outputs.kitti {
        write_trajectories(path, &map, |path, trajectory| map::save_kitti(path, trajectory))?;
    }
    if let Some(path) = &args.outputs.mcap {
        map::save_map(path, &map)?;
        say!("{}: {} keyframes", path.display(), map.keyframes.len());
    }
    Ok(())
}

/// Writes the trajectory of each agent with `save`: of one into `path`, of several into files beside it that
/// have their agents' names at the end of theirs.
fn write_trajectories(
    path: &Path,
    map: &Map,
    save: impl Fn(&Path, &[StampedPose]) -> Result<(), MapError>,
) -> anyhow::Result<()> {
    for (agent, label) in map.agent_labels() {
        let path = if map.agents.len() > 1 { with_label(path, &label) } else { path.to_owned() };
        let trajectory = map.trajectory_of(agent);
        save(&path, &trajectory)?;
        say!("{}: {} poses", path.display(), trajectory.len());
    }
    Ok(())
}

/// `folder/name-label.ext` for `folder/name.ext`.
fn with_label(path: &Path, label: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{label}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// Writes the clouds that are asked for.
fn write_clouds(outputs: &Outputs, map: &Map, max_variance: f32) -> anyhow::Result<()> {
    if let Some(path) = &outputs.ply {
        let points = map::save_ply(path, map, max_variance)?;
        say!("{}: {points} points", path.display());
    }
    if let Some(path) = &outputs.pcd {
        let points = map::save_pcd(path, map, max_variance)?;
        say!("{}: {points} points", path.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_agents_name_ends_that_of_its_file() {
        for (path, expected) in
            [("out/path.txt", "out/path-yard.txt"), ("path", "path-yard"), ("a.b/c.d.e", "a.b/c.d-yard.e")]
        {
            assert_eq!(with_label(Path::new(path), "yard"), Path::new(expected));
        }
    }
}
