//! The command line: one file per command.

mod cameras;
mod eval;
mod eval_agents;
mod eval_depth;
mod export;
#[cfg(feature = "opencv")]
pub(crate) mod features;
mod info;
mod info_map;
#[cfg(feature = "opencv")]
mod merge;
mod params;
#[cfg(feature = "opencv")]
mod places;
mod run;
#[cfg(feature = "opencv")]
mod unmerge;
#[cfg(feature = "opencv")]
mod vocab;

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

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Track and map a recording
    Run(run::RunArgs),
    /// List the cameras of this machine with their formats, sizes and rates
    Cameras(cameras::CamerasArgs),
    /// Describe a recording or a map
    Info(info::InfoArgs),
    Export(export::ExportArgs),
    Eval(eval::EvalArgs),
    #[cfg(feature = "opencv")]
    Merge(merge::MergeArgs),
    #[cfg(feature = "opencv")]
    Places(places::PlacesArgs),
    #[cfg(feature = "opencv")]
    Unmerge(unmerge::UnmergeArgs),
    #[cfg(feature = "opencv")]
    Vocab(vocab::VocabArgs),
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
            Command::Cameras(args) => cameras::run(&args),
            Command::Info(args) => info::execute(&args),
            Command::Export(args) => export::run(&args),
            Command::Eval(args) => eval::run(args),
            #[cfg(feature = "opencv")]
            Command::Merge(args) => merge::run(&args),
            #[cfg(feature = "opencv")]
            Command::Places(args) => places::run(&args),
            #[cfg(feature = "opencv")]
            Command::Unmerge(args) => unmerge::run(&args),
            #[cfg(feature = "opencv")]
            Command::Vocab(args) => vocab::run(&args),
            Command::Params(args) => params::execute(args),
        }
    }
}
