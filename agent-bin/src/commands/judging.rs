//! How pairs of maps are judged, on the command line of `merge` and `verdict`.

use super::method::{AnyMethod, method_parser};
use super::params::ParameterArgs;
use anyhow::{Result, bail};
use clap::Args;
use loopbox::lidar::merging::LidarMergeParams;
use loopbox::merging::MergingParams;
use loopbox::pairs::VerdictOptions;
use std::path::PathBuf;

/// By which method and parameters pairs of maps are judged.
#[derive(Debug, Args)]
pub struct MethodArgs {
    /// How maps are joined where they met, in place of the parameter file's: direct, loopbox's own, aligns the images
    /// of all pairs that agree; the others, loop-box of the paper among them, are there to compare it with. Of LiDARs:
    /// pieces, loopbox's own, or emr, the paper's
    #[arg(long, value_name = "METHOD", value_parser = method_parser())]
    method: Option<AnyMethod>,
    /// Days between the maps: how much may have moved, or been put in place of something else, at one place. 0, the default, is one
    /// day
    #[arg(long, value_name = "DAYS", value_parser = days)]
    days_apart: Option<f64>,
    #[command(flatten)]
    parameters: ParameterArgs,
}

/// How pairs of maps are judged, and what is known of them.
#[derive(Debug, Args)]
pub struct JudgingArgs {
    #[command(flatten)]
    pub how: MethodArgs,
    /// Join these two agents, by their names in the verdict: you know that both maps show one place, whatever looks otherwise. That the
    /// pose between them is right is still tested. It is kept where verdicts are; may be given again
    #[arg(long, value_name = "A+B")]
    pub confirm: Vec<String>,
    /// Where verdicts are kept: a folder, or in a bucket s3://BUCKET/PREFIX, gs://… or az://…. Pairs that have one there are not looked at
    /// again, and those of others are kept there. Several processes may share it. Without it `loopbox merge` keeps them where a manifest
    /// among the maps says, else in the folder `verdicts` in OUT, and `loopbox verdict` keeps none
    #[arg(long, value_name = "DIR")]
    pub verdicts: Option<PathBuf>,
}

/// A number of days.
fn days(text: &str) -> Result<f64, String> {
    let days: f64 = text.parse().map_err(|_| format!("{text} is no number of days"))?;
    if days.is_finite() && days >= 0.0 { Ok(days) } else { Err("days are 0 or more".to_owned()) }
}

impl MethodArgs {
    /// The parameters of maps of cameras.
    ///
    /// # Errors
    /// When the parameter file cannot be read, or the method is one of LiDARs.
    pub fn of_cameras(&self) -> Result<MergingParams> {
        if let Some(AnyMethod::Lidar(method)) = self.method {
            bail!("--method {} is for maps of LiDARs, and these are of cameras", method.name());
        }
        self.camera_params()
    }

    /// Those of maps of LiDARs.
    ///
    /// # Errors
    /// When the method is one of cameras, or there is a parameter file.
    pub fn of_lidars(&self) -> Result<LidarMergeParams> {
        if self.parameters.are_given() {
            bail!("--params and --set are for maps of cameras, and these are of LiDARs");
        }
        self.refuse_camera_method()?;
        Ok(self.lidar_params())
    }

    /// The parameters of maps of cameras and of those of LiDARs, where both are in a store and not compared with each other.
    ///
    /// # Errors
    /// When the parameter file cannot be read.
    pub fn of_store(&self) -> Result<(MergingParams, LidarMergeParams)> {
        Ok((self.camera_params()?, self.lidar_params()))
    }

    /// Those of cameras, whatever a method of LiDARs says.
    fn camera_params(&self) -> Result<MergingParams> {
        let mut params = self.parameters.of_merging()?;
        let prior = &mut params.further.place.prior;
        prior.days_apart = self.days_apart.unwrap_or(prior.days_apart);
        if let Some(AnyMethod::Camera(method)) = self.method {
            params.method = method;
        }
        Ok(params)
    }

    /// Those of LiDARs, whatever a method of cameras says.
    fn lidar_params(&self) -> LidarMergeParams {
        let mut params = LidarMergeParams::default();
        params.prior.days_apart = self.days_apart.unwrap_or(params.prior.days_apart);
        if let Some(AnyMethod::Lidar(method)) = self.method {
            params.method = method;
        }
        params
    }

    /// Refuses a method of cameras, where a LiDAR's map is among those that are merged.
    fn refuse_camera_method(&self) -> Result<()> {
        let Some(AnyMethod::Camera(method)) = self.method else { return Ok(()) };
        bail!("--method {} is for maps of cameras, and there is a LiDAR's among these", method.name())
    }
}

impl JudgingArgs {
    /// Those of LiDARs and of cameras, where both are among the maps.
    ///
    /// # Errors
    /// When the parameter file cannot be read, the method is one of cameras, or a pair is confirmed.
    pub fn of_both(&self) -> Result<(LidarMergeParams, MergingParams)> {
        if !self.confirm.is_empty() {
            bail!("--confirm is for maps of cameras alone or of LiDARs alone, and among these are both");
        }
        self.how.refuse_camera_method()?;
        let (cameras, lidars) = self.how.of_store()?;
        Ok((lidars, cameras))
    }

    /// How a verdict on maps of cameras alone or LiDARs alone is found.
    ///
    /// # Errors
    /// As [`MethodArgs::of_cameras`] and [`MethodArgs::of_lidars`].
    pub fn of_either(&self, are_lidars: bool) -> Result<VerdictOptions> {
        let (verdicts, confirm) = (self.verdicts.clone(), self.confirm.clone());
        let options = VerdictOptions { verdicts, confirm, ..VerdictOptions::default() };
        Ok(match are_lidars {
            true => VerdictOptions { lidars: self.how.of_lidars()?, ..options },
            false => VerdictOptions { cameras: self.how.of_cameras()?, ..options },
        })
    }
}
