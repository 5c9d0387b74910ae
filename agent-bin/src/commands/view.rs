//! `loopbox view`: saved or merged maps on the page on which runs are watched.

use super::info_map::load_at;
use super::watching::PageArgs;
use crate::console::{self, tell};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::{Result, bail};
use map::Map;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use view::watch::{Shared, saved, web::Server};

/// Show maps in the browser
#[derive(Clone, Debug, clap::Args)]
pub struct ViewArgs {
    /// Maps: `map.mcap` files, or folders that `loopbox run` or `loopbox merge` wrote
    #[arg(value_name = "MAP", required = true)]
    maps: Vec<PathBuf>,
    /// Port of the page; default: a usual one, or any that is free
    #[arg(long)]
    port: Option<u16>,
    /// Show the page in the browser
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    page: PageArgs,
}

/// Serves them until Ctrl-C.
///
/// # Errors
/// When a map cannot be read, or the address cannot be served at.
pub fn execute(args: &ViewArgs) -> Result<()> {
    let address = args.page.address(args.port)?;
    let mut maps: Vec<Map> = args.maps.iter().map(|path| load_at(path)).collect::<Result<_>>()?;
    // One map is shown as it is; those of several keep their own worlds, one in another.
    let map = if maps.len() == 1 { maps.remove(0) } else { Map::unite(maps)? };
    if map.keyframes.is_empty() {
        bail!("the map has no keyframes: there is nothing to show");
    }
    let stop = stop_on_ctrl_c("stopping")?;
    let names: Vec<&str> = map.agents.values().map(|agent| &*agent.name).collect();
    let shared = Arc::new(Shared::new(saved::scene(&map)?, None));
    let server = Server::start(&shared, address, &names.join(" · "))?;
    tell!("view at {}  (Ctrl-C ends)", server.url());
    if args.open {
        console::show(Path::new(server.url()));
    }
    while !stop.requested() {
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok(())
}
