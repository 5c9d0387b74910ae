//! `loopbox import`: a map of posed images with depth from elsewhere.

use crate::console::{say, warning};
use anyhow::{Result, bail};
use loopbox::importing::{ImportOptions, Imported, Layout, import};
use std::path::PathBuf;

/// Make a map of posed images with depth that come from elsewhere: RGB-D recordings and COLMAP models
#[derive(Clone, Debug, clap::Args)]
pub struct ImportArgs {
    /// Folder in the layout of TUM RGB-D or of 7-Scenes (image, depth image and pose a keyframe), or with a COLMAP model
    /// (text or binary, in it, in sparse/ or in sparse/0/) and its images in images/
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,
    /// The map to write, a map.mcap
    #[arg(short, long, value_name = "MAP")]
    pub out: PathBuf,
    /// Replace a map that is there
    #[arg(short, long)]
    pub force: bool,
    /// The layout, where what is there does not tell it
    #[arg(long, value_enum)]
    pub layout: Option<Layout>,
    /// Calibration of the camera, as `loopbox run` takes it; camera.yaml in FOLDER if not given. A COLMAP model brings its
    /// own
    #[arg(long, value_name = "FILE")]
    pub calib: Option<PathBuf>,
    /// Value of the depth images at 1 m, if it is not the layout's: 5000 for TUM RGB-D, 1000 for 7-Scenes
    #[arg(long, value_name = "N")]
    pub depth_scale: Option<f64>,
    /// Every so many images become a keyframe. Neighbouring keyframes should differ: at 30 images a second take 10 or so
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub every: usize,
    /// When features are found, by which maps are merged: now, which keeps them in the map, or later, by the merge
    #[arg(long, value_enum, default_value = "now")]
    pub features: super::run::FeatureTime,
}

/// Runs `loopbox import`.
///
/// # Errors
/// When the folder cannot be made a map, or the map not be written. Then a map that is there stays.
pub fn execute(args: &ImportArgs) -> Result<()> {
    if args.out.is_dir() {
        bail!(
            "{}: is a folder\nhint: give the file to write: --out {}",
            args.out.display(),
            args.out.join("map.mcap").display()
        );
    }
    if args.out.exists() && !args.force {
        bail!("{}: is there already\nhint: --force replaces it", args.out.display());
    }
    let options = ImportOptions {
        layout: args.layout,
        calibration: args.calib.clone(),
        depth_scale: args.depth_scale,
        every: args.every,
        features: args.features.is_now(),
    };
    let Imported { map, layout, warnings } = import(&args.folder, &options)?;
    warnings.iter().for_each(|warning| warning!("{warning}"));
    map::save_map(&args.out, &map)?;
    let unit = if map.is_metric() { ", in metres" } else { "" };
    say!("{}: {} keyframes of a {} folder{unit}", args.out.display(), map.keyframes.len(), layout.name());
    Ok(())
}
