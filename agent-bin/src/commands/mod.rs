//! The command line: one file per command.

#[cfg(not(all(feature = "fleet", feature = "view")))]
mod absent;
mod agent;
mod calib;
mod calib_check;
mod calib_photometric;
mod cameras;
mod convert;
mod doctor;
mod eval;
mod eval_agents;
mod eval_depth;
mod eval_table;
mod export;
pub(crate) mod features;
#[cfg(feature = "fleet")]
mod fleet;
mod import;
mod info;
pub(crate) mod info_map;
mod judging;
#[cfg(feature = "fleet")]
mod keys;
mod merge;
mod merge_args;
mod merge_progress;
mod merge_scans;
mod method;
mod params;
mod places;
mod publishing;
mod record;
mod run;
mod run_scans;
mod shell;
#[cfg(feature = "fleet")]
mod station;
mod status;
mod survey;
mod threads;
mod unmerge;
mod verdict;
#[cfg(feature = "view")]
mod view;
mod vocab;
mod watching;
mod worker;

use crate::progress::REPORT;
use crate::{console, version};
use anyhow::Result;
use clap::{Parser, Subcommand};
use std::path::Path;

/// SLAM for one robot or for several: each maps with its camera or LiDAR, and maps that show one place become one.
#[derive(Debug, Parser)]
#[command(name = "loopbox", version = version::short(), long_version = version::long(), about, max_term_width = 100)]
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
    Run(Box<run::RunArgs>),
    Agent(agent::AgentArgs),
    Status(status::StatusArgs),
    /// Record a camera or any recording into an MCAP file
    Record(record::RecordArgs),
    /// Turn a recording into an MCAP file, a ROS 1 bag, a video or a folder of images
    Convert(convert::ConvertArgs),
    /// List the cameras of this machine with their formats, sizes and rates
    Cameras(cameras::CamerasArgs),
    /// Describe a recording or a map
    Info(info::InfoArgs),
    /// Write a map's cloud, trajectory or posed images in the format of another tool; in metres and upright where asked
    Export(Box<export::ExportArgs>),
    Import(import::ImportArgs),
    Eval(eval::EvalArgs),
    Calib(calib::CalibArgs),
    Merge(merge_args::MergeArgs),
    Propose(verdict::ProposeArgs),
    Verdict(verdict::VerdictArgs),
    Worker(worker::WorkerArgs),
    Places(places::PlacesArgs),
    Unmerge(unmerge::UnmergeArgs),
    #[cfg(feature = "fleet")]
    Station(station::StationArgs),
    #[cfg(feature = "fleet")]
    Fleet(fleet::FleetCommand),
    #[cfg(feature = "fleet")]
    Keys(keys::KeysCommand),
    #[cfg(not(feature = "fleet"))]
    #[command(hide = true, aliases = ["fleet", "keys"])]
    Station(absent::AbsentArgs),
    Vocab(vocab::VocabArgs),
    #[cfg(feature = "view")]
    View(view::ViewArgs),
    #[cfg(not(feature = "view"))]
    #[command(hide = true)]
    View(absent::AbsentArgs),
    Params(params::ParamsArgs),
    Doctor(doctor::DoctorArgs),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

/// Shows the report of a folder of results where that is wished.
fn listed(is_wished: bool, folder: &Path) {
    if is_wished {
        console::show(&folder.join(REPORT));
    }
}

impl Command {
    /// Does it.
    ///
    /// # Errors
    /// Whatever kept it from being done, for people.
    pub fn execute(self) -> Result<()> {
        match self {
            Command::Run(args) => {
                let args = args.with_out();
                let (is_open, out) = (args.open, args.out().to_owned());
                #[cfg(feature = "fleet")]
                let store = args.pairing.store()?;
                run::execute(args)?;
                #[cfg(feature = "fleet")]
                if let Some(store) = store {
                    fleet::put(&store, &out)?;
                }
                listed(is_open, &out);
                Ok(())
            }
            Command::Agent(args) => agent::execute(&args),
            Command::Status(args) => status::execute(&args),
            Command::Record(args) => record::execute(&args),
            Command::Convert(args) => convert::execute(&args),
            Command::Cameras(args) => cameras::run(&args),
            Command::Info(args) => info::execute(&args),
            Command::Export(args) => export::run(&args),
            Command::Import(args) => import::execute(&args),
            Command::Eval(args) => eval::run(args),
            Command::Calib(args) => calib::run(&args),
            Command::Merge(mut args) => {
                merge::run(&mut args)?;
                listed(args.open, &args.out);
                Ok(())
            }
            Command::Propose(args) => verdict::propose(&args),
            Command::Verdict(args) => verdict::run(&args),
            Command::Worker(args) => worker::run(&args),
            Command::Places(args) => places::run(&args),
            Command::Unmerge(args) => unmerge::run(&args),
            #[cfg(feature = "fleet")]
            Command::Station(args) => station::run(&args),
            #[cfg(feature = "fleet")]
            Command::Fleet(args) => fleet::run(&args),
            #[cfg(feature = "fleet")]
            Command::Keys(args) => keys::run(&args),
            #[cfg(not(feature = "fleet"))]
            Command::Station(args) => absent::refuse(&args, "station, fleet and keys", "fleet"),
            Command::Vocab(args) => vocab::run(&args),
            #[cfg(feature = "view")]
            Command::View(args) => view::execute(&args),
            #[cfg(not(feature = "view"))]
            Command::View(args) => absent::refuse(&args, "view", "view"),
            Command::Params(args) => params::execute(args),
            Command::Doctor(args) => doctor::execute(args),
            Command::Completions(args) => shell::completions(args),
            Command::Man(args) => shell::man(&args),
        }
    }
}
