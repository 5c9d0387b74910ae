//! `loopbox cameras`: the cameras there are and what they can do.

#[cfg(all(feature = "camera", target_os = "linux"))]
use crate::console;
use anyhow::Result;
use clap::Args;

/// Arguments of `loopbox cameras`.
#[derive(Args, Debug)]
pub struct CamerasArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs it.
///
/// # Errors
/// When this program was built without cameras.
#[cfg(not(all(feature = "camera", target_os = "linux")))]
pub fn run(_args: &CamerasArgs) -> Result<()> {
    Err(sources::camera::not_built())
}

/// Runs it.
///
/// # Errors
/// When the list cannot be printed.
#[cfg(all(feature = "camera", target_os = "linux"))]
pub fn run(args: &CamerasArgs) -> Result<()> {
    let cameras = sources::camera::list::cameras(std::path::Path::new("/dev"));
    let text = if args.json {
        serde_json::to_string_pretty(&listing::as_json(&cameras))?
    } else {
        listing::as_text(&cameras)
    };
    console::print(&(text + "\n"))
}

#[cfg(all(feature = "camera", target_os = "linux"))]
#[path = "cameras_listing.rs"]
mod listing;
