//! Commands that this program was built without.

use crate::console::usage;
use anyhow::{Result, anyhow};

/// Whatever the command would take.
#[derive(Debug, clap::Args)]
pub struct AbsentArgs {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    ignored: Vec<String>,
}

/// Says which feature brings the commands.
///
/// # Errors
/// Always.
pub fn refuse(args: &AbsentArgs, commands: &str, feature: &str) -> Result<()> {
    let _ = &args.ignored;
    usage(Err(anyhow!(
        "{commands}: this program was built without\nhint: cargo build --release -p loopbox --features {feature} builds it with"
    )))
}
