//! `loopbox keys`: certificates for agents that pair from machine to machine.

use crate::console;
use anyhow::Result;
use clap::{Args, Subcommand};
use loopbox::fleet::{Authority, DAYS, Validity};
use std::path::PathBuf;

/// Make the keys with which agents pair from machine to machine
#[derive(Debug, Args)]
pub struct KeysCommand {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Make a fleet's authority: whoever has it lets agents take part. It needs to be on none of their machines
    Init {
        /// Folder for it; made if it is not there
        #[arg(value_name = "DIR")]
        folder: PathBuf,
    },
    /// Make a machine's keys, for its agents and its station
    Agent {
        /// What others see that it is called; with the same name its keys can be made anew
        name: String,
        /// Folder of the authority
        #[arg(long, value_name = "DIR")]
        authority: PathBuf,
        /// Folder for the keys, to be brought to that machine and given to --keys; made if it is not there
        #[arg(short, long, value_name = "DIR")]
        out: PathBuf,
        /// For how many days they are valid
        #[arg(long, value_name = "DAYS", default_value_t = DAYS)]
        days: u32,
    },
}

/// Whose keys a node has.
#[derive(Debug, Args)]
pub struct KeysArg {
    /// The keys of this machine, for addresses that are tls/HOST:PORT: a folder that `loopbox keys agent` made
    #[arg(long, value_name = "DIR")]
    keys: Option<PathBuf>,
}

impl KeysArg {
    /// The folder that was given.
    pub fn folder(&self) -> Option<PathBuf> {
        self.keys.clone()
    }
}

/// Runs `loopbox keys`.
///
/// # Errors
/// When there are keys already, no authority, or a folder cannot be written to.
pub fn run(args: &KeysCommand) -> Result<()> {
    match &args.what {
        What::Init { folder } => {
            Authority::init(folder)?;
            let folder = folder.display();
            console::print(&format!(
                "{folder} is an authority: `loopbox keys agent NAME --authority {folder} --out DIR` makes a machine's keys\n"
            ))
        }
        What::Agent { name, authority, out, days } => {
            Authority::open(authority)?.issue(name, Validity::days(*days)?, out)?;
            let out = out.display();
            console::print(&format!(
                "{out} holds the keys of {name}, for {days} days: bring it to its machine, and give it --keys {out}\n"
            ))
        }
    }
}
