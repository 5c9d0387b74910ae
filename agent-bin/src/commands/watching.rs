//! Arguments of watching a run.

use crate::console::tell;
use crate::progress::Console;
use anyhow::Result;
use loopbox::run::Progress;
use map::AgentInfo;
use slam_direct::Frame;
use sources::Stop;
use sources::recording::RecordButton;
use view::watch::Watch;

#[cfg(feature = "view")]
pub use with_view::{PageArgs, RunPage, ViewArgs};
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

    /// No page.
    pub fn page(&self, _title: &str, _frames: Option<u64>) -> Result<RunPage> {
        Ok(RunPage)
    }

    /// Nobody watches.
    pub fn start(
        &self,
        _page: &RunPage,
        _agent: &AgentInfo,
        _frames: Option<u64>,
        _recording: RecordButton,
    ) -> Result<Watch> {
        Ok(Watch::none())
    }
}

/// No page.
#[cfg(not(feature = "view"))]
pub struct RunPage;

#[cfg(not(feature = "view"))]
impl RunPage {
    fn tell(&self, _text: &str) {}

    fn show(&self, _frame: &Frame) {}

    /// Does nothing.
    pub fn end(&self, _result: &Result<()>, _stop: &Stop) {}
}

/// Tells the console and the page what is done before a run.
pub struct Preparing<'a> {
    /// The terminal.
    pub console: &'a Console,
    /// The page, if there is one.
    pub page: &'a RunPage,
}

impl Progress for Preparing<'_> {
    fn looked_at(&self, frame: &Frame) {
        self.console.looked_at(frame);
        self.page.show(frame);
    }

    fn warn(&self, text: &str) {
        self.console.warn(text);
        self.page.tell(text);
    }

    fn note(&self, text: &str) {
        self.console.note(text);
        self.page.tell(text);
    }

    fn stage(&self, text: &str) {
        self.console.stage(text);
        // Minutes may pass, of which nothing else is said.
        if self.console.is_unseen() {
            tell!("{text}");
        }
        self.page.tell(text);
    }
}

#[cfg(feature = "view")]
mod with_view {
    use super::*;
    use crate::interrupt::only_a_page_is_left;
    use std::net::{IpAddr, Ipv4Addr};
    use std::time::Duration;
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
        /// Serve a page to watch from, in any browser on this machine; prints its address. It stays until Ctrl-C
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

    /// The page of a run, or none.
    pub struct RunPage(Option<view::watch::RunPage>);

    impl RunPage {
        /// Says what is done before the run.
        pub fn tell(&self, text: &str) {
            self.0.iter().for_each(|page| page.tell(text));
        }

        /// Shows a frame that is looked at before the run.
        pub fn show(&self, frame: &Frame) {
            self.0.iter().for_each(|page| page.show(frame));
        }

        /// Leaves the page until the user stops it, so that the result can be looked at; without one, says why there is none.
        pub fn end(&self, result: &Result<()>, stop: &Stop) {
            let Some(page) = &self.0 else { return };
            if result.is_ok() && !stop.requested() {
                only_a_page_is_left();
                tell!("the page stays at {}  (Ctrl-C ends)", page.url());
                while !stop.requested() {
                    std::thread::sleep(Duration::from_millis(100));
                }
            }
            page.end(result.as_ref().err().map(|error| format!("{error:#}")).as_deref());
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

        /// The page, if it was asked for, of a run over so many frames that is still to be prepared.
        ///
        /// # Errors
        /// When the address cannot be served at.
        pub fn page(&self, title: &str, frames: Option<u64>) -> Result<RunPage> {
            let Some(address) = self.serve.address()? else { return Ok(RunPage(None)) };
            let page = view::watch::RunPage::start(address, title, frames)?;
            tell!("watch at {}", page.url());
            Ok(RunPage(Some(page)))
        }

        /// Starts what else was asked for, for a run of this agent over so many frames, which `recording` records, and shows it on its page.
        ///
        /// # Errors
        /// When an address cannot be served at.
        pub fn start(
            &self,
            page: &RunPage,
            agent: &AgentInfo,
            frames: Option<u64>,
            recording: RecordButton,
        ) -> Result<Watch> {
            let page = page.0.clone();
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
