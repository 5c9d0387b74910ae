//! `loopbox export`: a map in the formats of other tools.

use anyhow::ensure;
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Map};
use std::io::{Write, stdout};
use std::path::PathBuf;

/// Write a map's cloud or trajectory in the format of another tool
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// The map: `map.mcap` of a run
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
    /// Point cloud as binary PLY: x y z intensity confidence
    #[arg(long, value_name = "FILE")]
    pub ply: Option<PathBuf>,
    /// Point cloud as binary PCD: x y z intensity confidence
    #[arg(long, value_name = "FILE")]
    pub pcd: Option<PathBuf>,
    /// Trajectory as TUM text: timestamp tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE")]
    pub tum: Option<PathBuf>,
    /// Trajectory as KITTI text: the upper 3×4 of each pose, row by row
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
    let map = super::info_map::load(&args.map)?.map;
    write_clouds(&args.outputs, &map, args.max_variance)?;
    let trajectory = map.trajectory();
    let poses = trajectory.len();
    if let Some(path) = &args.outputs.tum {
        map::save_tum(path, &trajectory)?;
        writeln!(stdout(), "{}: {poses} poses", path.display())?;
    }
    if let Some(path) = &args.outputs.kitti {
        map::save_kitti(path, &trajectory)?;
        writeln!(stdout(), "{}: {poses} poses", path.display())?;
    }
    if let Some(path) = &args.outputs.mcap {
        map::save_map(path, &map)?;
        writeln!(stdout(), "{}: {} keyframes", path.display(), map.keyframes.len())?;
    }
    Ok(())
}

/// Writes the clouds that are asked for.
fn write_clouds(outputs: &Outputs, map: &Map, max_variance: f32) -> anyhow::Result<()> {
    if let Some(path) = &outputs.ply {
        let points = map::save_ply(path, map, max_variance)?;
        writeln!(stdout(), "{}: {points} points", path.display())?;
    }
    if let Some(path) = &outputs.pcd {
        let points = map::save_pcd(path, map, max_variance)?;
        writeln!(stdout(), "{}: {points} points", path.display())?;
    }
    Ok(())
}
