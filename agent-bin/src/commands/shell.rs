//! `loopbox completions` and `loopbox man`: what shells and `man` want to know of the commands.

use super::Cli;
use crate::console;
use anyhow::{Context, Result};
use clap::CommandFactory;
use clap_complete::Shell;
use std::path::PathBuf;

/// Print the completions of a shell, such as `loopbox completions bash > ~/.local/share/bash-completion/completions/loopbox`
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

/// Write the manual pages, one for each command
#[derive(Clone, Debug, clap::Args)]
pub struct ManArgs {
    /// The folder that gets them, such as ~/.local/share/man/man1; made if it is not there
    #[arg(value_name = "DIR")]
    dir: PathBuf,
}

/// Prints the completions.
///
/// # Errors
/// When they cannot be printed.
pub fn completions(args: CompletionsArgs) -> Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "loopbox", &mut text);
    console::print(&String::from_utf8(text)?)
}

/// Writes the manual pages.
///
/// # Errors
/// When the folder or a page cannot be written.
pub fn man(args: &ManArgs) -> Result<()> {
    let dir = args.dir.display();
    std::fs::create_dir_all(&args.dir).with_context(|| format!("{dir}: the folder cannot be made"))?;
    clap_mangen::generate_to(Cli::command(), &args.dir)
        .with_context(|| format!("{dir}: the manual pages cannot be written"))
}
