//! The arguments of `loopbox merge`.

use super::judging::JudgingArgs;
use super::threads::ThreadsArg;
use anyhow::{Result, bail};
use clap::Args;
use geometry::Se3;
use loopbox::merging::MixedOptions;
use loopbox::placing::rig::extrinsic;
use std::path::PathBuf;

/// Merge the maps of several agents into one common map
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// The maps: each a map.mcap, the folder of a run, or such by its URI (s3://BUCKET/FOLDER; s3://BUCKET/FOLDER/* are all there). Those
    /// that met join the world of the first. The manifest of a merge stands for all of its maps: give it with new ones, and it grows
    #[arg(required = true, value_name = "MAP")]
    pub(super) maps: Vec<PathBuf>,
    /// Folder for the results; made if it is not there
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Replace results of a run in that folder, once the new ones are complete
    #[arg(short, long)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) judging: JudgingArgs,
    /// Optimise all that the agents observe, of each other's points too, jointly in the end, however many keyframes there are; without
    /// it, common maps of up to 1000 are. Of agents with one camera
    #[arg(long, conflicts_with_all = ["extrinsic", "no_optimise"])]
    pub(super) optimise: bool,
    /// Optimise nothing jointly: the closures alone say how the maps lie to each other. Quicker, and mostly less exact
    #[arg(long, conflicts_with = "extrinsic")]
    pub(super) no_optimise: bool,
    /// Of two maps, a camera's and that of a LiDAR on the same robot at the same time: where the camera is on the LiDAR,
    /// lidar_from_camera, as tx,ty,tz,qx,qy,qz,qw in metres, or a file of these or of the upper 3×4 of the matrix. The
    /// camera's map gets place and metres of the LiDAR's
    #[arg(long, value_name = "POSE", value_parser = extrinsic, allow_hyphen_values = true,
        conflicts_with_all = ["method", "params", "set", "days_apart", "confirm", "verdicts"])]
    pub(super) extrinsic: Option<Se3>,
    /// Leave out these maps of a manifest, by their names: as if they had never been merged
    #[arg(long, value_name = "NAME")]
    pub(super) without: Vec<String>,
    /// Write the manifest alone, of which maps, clouds, trajectories and the report are made when they are asked for
    #[arg(long, conflicts_with_all = ["extrinsic", "open"])]
    pub(super) no_map: bool,
    /// Print all numbers as JSON, as they are in merge.json, instead of the verdicts
    #[arg(long)]
    pub(super) json: bool,
    /// Show the report in the browser once it is written
    #[arg(long)]
    pub(super) open: bool,
    /// Show no progress
    #[arg(short, long)]
    pub(super) quiet: bool,
    #[command(flatten)]
    pub(super) threads: ThreadsArg,
}

impl MergeArgs {
    /// How maps of cameras and LiDARs are merged.
    pub(super) fn mixed(&self) -> Result<MixedOptions> {
        self.check_lidar_options()?;
        let (lidars, cameras) = self.judging.of_both()?;
        if cameras.method.baseline().is_some() {
            bail!("maps with a LiDAR's among them are merged with `method = \"direct\"`");
        }
        Ok(MixedOptions {
            out: self.out.clone(),
            force: self.force,
            lidars,
            cameras,
            verdicts: self.judging.verdicts.clone(),
            without: self.without.clone(),
            map: !self.no_map,
        })
    }

    /// Refuses what is for cameras alone.
    pub(super) fn check_lidar_options(&self) -> Result<()> {
        if self.optimise || self.no_optimise {
            bail!("--optimise and --no-optimise are for maps of cameras, and there is a LiDAR's among these");
        }
        Ok(())
    }
}
