//! Arguments of watching a run.

use anyhow::Result;
use map::AgentInfo;
use sources::recording::RecordButton;
use view::watch::Watch;

#[cfg(feature = "view")]
pub use with_view::{PageArgs, ViewArgs};
// Calibrations and stations are watched too.
#[cfg(feature = "view")]
pub use with_view::ServeArgs;

/// Nothing: this program was built without it.
#[cfg(not(feature = "view"))]
#[derive(clap::Args, Debug)]
pub struct ViewArgs {}

#[cfg(not(feature = "view"))]
impl ViewArgs {
    /// None was given.
    pub fn given(&self) -> Option<&'static str> {
        None
    }

    /// Nobody watches.
    pub fn start(&self, _agent: &AgentInfo, _frames: Option<u64>, _recording: RecordButton) -> Result<Watch> {
        Ok(Watch::none())
    }
}

#[cfg(feature = "view")]
mod with_view {
    use super::*;
    use crate::console::tell;
    use std::net::{IpAddr, Ipv4Addr};
    use view::watch::WatchOptions;
    use view::watch::web::Address;

    /// Arguments of the page.
    #[derive(Clone, clap::Args, Debug)]
    pub struct PageArgs {
        /// Serve the page at this address of the machine; others than 127.0.0.1 need a token, which is printed
        #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
        bind: IpAddr,
        /// The token of the page's address, instead of one made anew
        #[arg(long)]
        token: Option<String>,
    }

    impl PageArgs {
        /// Where to serve it.
        ///
        /// # Errors
        /// When the token is none.
        pub fn address(&self, port: Option<u16>) -> Result<Address> {
            Address::new(self.bind, port, self.token.clone())
        }
    }

    /// Arguments of a page for those who ask for it.
    #[derive(Clone, clap::Args, Debug)]
    pub struct ServeArgs {
        /// Serve a page to watch from, in any browser on this machine; prints its address
        #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true)]
        view: Option<Option<u16>>,
        /// With --view: serve the page at this address of the machine; others than 127.0.0.1 need a token, which is printed
        #[arg(long, value_name = "ADDRESS", requires = "view")]
        bind: Option<IpAddr>,
        /// With --view: the token of the page's address, instead of one made anew
        #[arg(long, requires = "view")]
        token: Option<String>,
    }

    impl ServeArgs {
        /// Where to serve it, if it was asked for.
        ///
        /// # Errors
        /// When the token is none.
        pub fn address(&self) -> Result<Option<Address>> {
            let page = PageArgs {
                bind: self.bind.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST)),
                token: self.token.clone(),
            };
            self.view.map(|port| page.address(port)).transpose()
        }
    }

    /// Arguments of watching a run.
    #[derive(clap::Args, Debug)]
    pub struct ViewArgs {
        #[command(flatten)]
        serve: ServeArgs,
        /// Serve the run to Foxglove
        #[cfg(feature = "foxglove-server")]
        #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8765")]
        foxglove: Option<u16>,
    }

    impl ViewArgs {
        /// The first that was given, by its name on the command line.
        pub fn given(&self) -> Option<&'static str> {
            let foxglove = self.foxglove().map(|_| "--foxglove");
            self.serve.view.map(|_| "--view").or(foxglove)
        }

        /// Starts what was asked for, for a run of this agent over so many frames, which `recording` records.
        ///
        /// # Errors
        /// When an address cannot be served at.
        pub fn start(
            &self,
            agent: &AgentInfo,
            frames: Option<u64>,
            recording: RecordButton,
        ) -> Result<Watch> {
            let page = self.serve.address()?;
            let (foxglove, recording) = (self.foxglove(), Some(recording));
            let options = WatchOptions { page, server: None, foxglove, recording, frames };
            let watch = Watch::start(agent, options)?;
            watch.places().iter().for_each(|place| tell!("{place}"));
            Ok(watch)
        }

        #[cfg(feature = "foxglove-server")]
        fn foxglove(&self) -> Option<u16> {
            self.foxglove
        }

        #[cfg(not(feature = "foxglove-server"))]
        fn foxglove(&self) -> Option<u16> {
            None
        }
    }
}
