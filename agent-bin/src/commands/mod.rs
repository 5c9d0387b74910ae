//! The command line: one file per command.

#[cfg(feature = "opencv")]
mod calib;
#[cfg(feature = "opencv")]
mod calib_check;
#[cfg(feature = "opencv")]
mod calib_photometric;
mod cameras;
mod convert;
mod eval;
mod eval_agents;
mod eval_depth;
mod export;
#[cfg(feature = "opencv")]
pub(crate) mod features;
mod info;
pub(crate) mod info_map;
mod info_scans;
#[cfg(feature = "opencv")]
mod merge;
#[cfg(feature = "opencv")]
mod merge_progress;
mod merge_scans;
#[cfg(feature = "opencv")]
mod method;
mod params;
#[cfg(feature = "opencv")]
mod places;
mod record;
mod run;
mod run_scans;
#[cfg(feature = "opencv")]
mod unmerge;
#[cfg(feature = "view")]
mod view;
#[cfg(feature = "opencv")]
mod vocab;
mod watching;

use anyhow::Result;
use clap::{Parser, Subcommand};

/// Direct monocular SLAM: one camera's recording in, trajectory and semi-dense map out.
#[derive(Debug, Parser)]
#[command(name = "loopbox", version, about)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands; what each does stands at its arguments.
#[derive(Debug, Subcommand)]
#[expect(missing_docs, reason = "a text here would take the place of that at the arguments")]
pub enum Command {
    /// Track and map a recording
    Run(run::RunArgs),
    /// Record a camera or any recording into an MCAP file
    Record(record::RecordArgs),
    /// Turn a recording into an MCAP file, a ROS 1 bag, a video or a folder of images
    Convert(convert::ConvertArgs),
    /// List the cameras of this machine with their formats, sizes and rates
    Cameras(cameras::CamerasArgs),
    /// Describe a recording or a map
    Info(info::InfoArgs),
    Export(export::ExportArgs),
    Eval(eval::EvalArgs),
    #[cfg(feature = "opencv")]
    Calib(calib::CalibArgs),
    #[cfg(feature = "opencv")]
    Merge(merge::MergeArgs),
    /// Merge the LiDAR maps of several agents into one common map
    #[cfg(not(feature = "opencv"))]
    Merge(merge_scans::MergeScansArgs),
    #[cfg(feature = "opencv")]
    Places(places::PlacesArgs),
    #[cfg(feature = "opencv")]
    Unmerge(unmerge::UnmergeArgs),
    #[cfg(feature = "opencv")]
    Vocab(vocab::VocabArgs),
    #[cfg(feature = "view")]
    View(view::ViewArgs),
    Params(params::ParamsArgs),
}

impl Command {
    /// Does it.
    ///
    /// # Errors
    /// Whatever kept it from being done, for people.
    pub fn execute(self) -> Result<()> {
        match self {
            Command::Run(args) => run::execute(&args),
            Command::Record(args) => record::execute(&args),
            Command::Convert(args) => convert::execute(&args),
            Command::Cameras(args) => cameras::run(&args),
            Command::Info(args) => info::execute(&args),
            Command::Export(args) => export::run(&args),
            Command::Eval(args) => eval::run(args),
            #[cfg(feature = "opencv")]
            Command::Calib(args) => calib::run(&args),
            #[cfg(feature = "opencv")]
            Command::Merge(args) => merge::run(&args),
            #[cfg(not(feature = "opencv"))]
            Command::Merge(args) => merge_scans::run(&args),
            #[cfg(feature = "opencv")]
            Command::Places(args) => places::run(&args),
            #[cfg(feature = "opencv")]
            Command::Unmerge(args) => unmerge::run(&args),
            #[cfg(feature = "opencv")]
            Command::Vocab(args) => vocab::run(&args),
            #[cfg(feature = "view")]
            Command::View(args) => view::execute(&args),
            Command::Params(args) => params::execute(args),
        }
    }
}
