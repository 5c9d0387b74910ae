//! `loopbox station`: collects the maps of agents and merges them as they come.

use super::keys::KeysArg;
use super::publishing::Ros2Args;
use super::threads::ThreadsArg;
#[cfg(feature = "view")]
use super::watching::ServeArgs;
use crate::console::{self, tell};
use crate::interrupt::stop_on_ctrl_c;
use crate::logging::{self, LogArg};
use anyhow::Result;
use clap::Args;
use loopbox::fleet::{CommonListener, Endpoint, Fleet, FleetOptions};
use std::path::PathBuf;

/// Collect the maps of agents that run with --fleet, and merge them as they come
#[derive(Debug, Args)]
pub struct StationArgs {
    /// Where agents reach it: with --keys tls/0.0.0.0:PORT, from any machine; without, tcp/127.0.0.1:PORT, within this one
    /// alone. Port 0 takes a free one
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<Endpoint>,
    /// An agent to dial, which listens itself; may be given again
    #[arg(long, value_name = "ADDRESS")]
    connect: Vec<Endpoint>,
    #[command(flatten)]
    keys: KeysArg,
    /// Folder for the common map and all that was collected; made if it is not there. A station started again goes on
    /// with what it holds
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// What agents are told that it is called
    #[arg(long, default_value = "station")]
    name: String,
    /// Replace results of a run in that folder
    #[arg(short, long)]
    force: bool,
    /// Put the maps of runs that have ended and the verdicts on their pairs into this store, and take verdicts there that `loopbox worker`
    /// found: a folder, or in a bucket s3://BUCKET/PREFIX, gs://… or az://…, with STORE/maps and STORE/verdicts. The station judges on
    /// meanwhile, and its common map is the same as without. Of LiDARs the maps alone
    #[arg(long, value_name = "STORE")]
    store: Option<PathBuf>,
    /// End once the maps of so many agents are whole, their runs over and all is merged
    #[arg(long, value_name = "COUNT")]
    agents: Option<usize>,
    /// Say nothing of what happens
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    log: LogArg,
    #[command(flatten)]
    publishing: Ros2Args,
    #[cfg(feature = "view")]
    #[command(flatten)]
    page: ServeArgs,
}

/// Runs `loopbox station`.
///
/// # Errors
/// When nobody could reach it or be reached, an address cannot be listened at, or the results cannot be written.
pub fn run(args: &StationArgs) -> Result<()> {
    args.log.start();
    if args.listen.is_none() && args.connect.is_empty() {
        anyhow::bail!(
            "nobody could reach the station\nhint: --listen tcp/127.0.0.1:7447 lets agents dial it"
        );
    }
    args.publishing.check()?;
    args.threads.start()?;
    let options = FleetOptions {
        out: args.out.clone(),
        force: args.force,
        name: args.name.clone(),
        is_station: true,
        in_background: false,
        listen: args.listen.clone(),
        dial: args.connect.clone(),
        store: args.store.clone(),
        keys: args.keys.folder(),
    };
    let stop = stop_on_ctrl_c("stopping: writing what was merged so far (Ctrl-C again to abort)")?;
    let quiet = args.quiet;
    let common = args.publishing.common()?;
    let mut listeners: Vec<Box<dyn CommonListener>> = Vec::new();
    listeners.extend(common.map(|common| Box::new(common) as Box<dyn CommonListener>));
    #[cfg(feature = "view")]
    let watch = args.watch()?;
    #[cfg(feature = "view")]
    listeners.extend(watch.iter().map(|watch| Box::new(watch.map()) as Box<dyn CommonListener>));
    let fleet = Fleet::start(
        &options,
        args.agents,
        move |level, text| {
            if !quiet {
                logging::write(level, "", format_args!("{text}"));
            }
        },
        listeners,
    )?;
    #[cfg(feature = "view")]
    watch.iter().for_each(|watch| fleet.report_to(watch.neighbourhood()));
    if let Some(at) = fleet.listening().filter(|_| !quiet) {
        tell!("agents reach this station by: loopbox run … --fleet --connect {}", at.for_others());
    }
    let status = fleet.wait(&stop)?;
    #[cfg(feature = "view")]
    if let Some(watch) = watch {
        watch.end(&format!("the station has ended: what it merged is in {}", args.out.display()));
    }
    console::print(&super::fleet::described(&status))
}

#[cfg(feature = "view")]
impl StationArgs {
    /// Begins to serve the page, if it was asked for.
    fn watch(&self) -> Result<Option<view::watch::StationWatch>> {
        let Some(address) = self.page.address()? else { return Ok(None) };
        let watch = view::watch::StationWatch::start(address, &self.name, &self.out)?;
        tell!("watch at {}", watch.url());
        Ok(Some(watch))
    }
}
