//! `loopbox agent`: an agent that nobody looks after.

use super::threads::ThreadsArg;
use crate::console::tell;
use crate::interrupt::stop_on_ctrl_c;
use crate::logging::{self, LogArg};
use anyhow::{Context, Result};
use clap::Args;
use loopbox::unattended::{AgentConfig, Over, supervise};
use sources::Stop;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// What is not on the disk by then after a wish to stop stays unsaved: who is about to switch the machine off waits 5 s.
const LAST: Duration = Duration::from_millis(4700);
const LOOK: Duration = Duration::from_millis(50);

/// Run an agent as a service: it waits for its camera, goes on in its map and keeps within its limits
#[derive(Debug, Args)]
pub struct AgentArgs {
    /// The file that says all about it
    #[arg(value_name = "FILE", default_value = "agent.toml")]
    config: PathBuf,
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    log: LogArg,
}

/// Runs it.
///
/// # Errors
/// When what the file says cannot be used.
pub fn execute(args: &AgentArgs) -> Result<()> {
    args.log.start();
    args.threads.start()?;
    let config = AgentConfig::read(&args.config)?;
    let stop = stop_on_ctrl_c("stopping: the map is brought to the disk (again to abort)")?;
    end_in_time(&stop)?;
    let report = |level, text: &str| logging::write(level, "", format_args!("{text}"));
    match supervise(&config, &stop, Arc::new(report))? {
        Over::Memory if !stop.requested() => begin_anew(),
        _ => Ok(()),
    }
}

/// Ends the program if it has not ended in time after the wish to stop. What has settled is on the disk already.
fn end_in_time(stop: &Stop) -> Result<()> {
    let stop = stop.clone();
    let wait = move || {
        while !stop.requested() {
            std::thread::sleep(LOOK);
        }
        std::thread::sleep(LAST);
        tell!("there was no time to save all of it: the map is there as it was some seconds ago");
        std::process::exit(1);
    };
    std::thread::Builder::new().name("end".into()).spawn(wait).context("cannot start a thread")?;
    Ok(())
}

/// Runs the same program in the place of this one, with all memory given back.
#[cfg(unix)]
fn begin_anew() -> Result<()> {
    use std::os::unix::process::CommandExt;

    let program = std::env::current_exe().context("the program does not find itself")?;
    let failed = std::process::Command::new(program).args(std::env::args_os().skip(1)).exec();
    Err(failed).context("the program cannot begin anew")
}

/// Leaves beginning anew to whoever looks after the process.
#[cfg(not(unix))]
fn begin_anew() -> Result<()> {
    anyhow::bail!("memory has come to its limit; the map is saved\nhint: start the agent again")
}
