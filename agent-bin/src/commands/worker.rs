//! `loopbox worker`: asks the pairs of a store's maps.

use super::judging::MethodArgs;
use super::threads::ThreadsArg;
use crate::console::{self, debug, tell, warning};
use crate::interrupt::stop_on_ctrl_c;
use crate::logging::LogArg;
use anyhow::{Result, bail};
use clap::Args;
use loopbox::counted;
use loopbox::merging::MergeWatcher;
use loopbox::store::{WorkOptions, work};
use std::path::PathBuf;

/// Judge the pairs of maps in a store, and go on as maps come
///
/// Start as many on one store as you like, on any machines: they share the pairs, and a kill loses the pair that was judged just then,
/// which another one takes. `loopbox merge STORE/maps/* --verdicts STORE/verdicts`, with the same --method, --days-apart, --params and --set,
/// joins what they found.
#[derive(Debug, Args)]
pub struct WorkerArgs {
    /// The store: a folder, or in a bucket s3://BUCKET/PREFIX, gs://… or az://…, with the maps in STORE/maps (each a map.mcap in a folder,
    /// or a file NAME.mcap). Verdicts are put into STORE/verdicts, as `merge --verdicts STORE/verdicts` keeps them
    #[arg(long, value_name = "STORE")]
    store: PathBuf,
    /// End once every pair of the maps that are there has its verdict, in place of waiting for more
    #[arg(long)]
    once: bool,
    #[command(flatten)]
    how: MethodArgs,
    /// Say nothing of what happens
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    log: LogArg,
}

/// Runs `loopbox worker`.
///
/// # Errors
/// When the store cannot be used, or with `--once` a map or pair was left out.
pub fn run(args: &WorkerArgs) -> Result<()> {
    args.log.start();
    args.threads.start()?;
    let (cameras, lidars) = args.how.of_store()?;
    let options = WorkOptions { store: args.store.clone(), cameras, lidars, once: args.once };
    let stop = stop_on_ctrl_c(
        "stopping: the pair that is judged just now is left to others (Ctrl-C again to abort)",
    )?;
    let quiet = args.quiet;
    if !quiet && !args.once {
        tell!("judging the pairs of the maps in {}/maps, as they come", args.store.display());
    }
    let done = work(&options, &stop, &WorkerOutput { quiet })?;
    if !quiet {
        tell!("{} judged here", counted(done.asked, "pair of maps", "pairs of maps"));
    }
    if args.once && !done.left_out.is_empty() {
        bail!("not all pairs could be judged: {}", done.left_out.join("\n"));
    }
    Ok(())
}

/// Says what happens, a line each.
struct WorkerOutput {
    quiet: bool,
}

impl MergeWatcher for WorkerOutput {
    fn detail(&self, text: &str) {
        debug!("{text}");
    }

    fn stage(&self, text: &str) {
        console::step(self.quiet, text);
    }

    fn warn(&self, text: &str) {
        warning!("{text}");
    }
}
