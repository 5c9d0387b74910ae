//! The page to watch the agent from, and `/health` beside it, over all its sessions.

use super::config::PageConfig;
use super::vitals::Vitals;
use anyhow::Result;
use map::AgentInfo;
use std::sync::Arc;
use view::watch::Watch;

/// The page, or none.
#[cfg(feature = "view")]
pub struct Page(Option<view::watch::web::Server>);

#[cfg(feature = "view")]
impl Page {
    /// Begins to serve it, if it is wanted.
    ///
    /// # Errors
    /// When it cannot be served at the address.
    pub fn start(config: Option<&PageConfig>, vitals: &Arc<Vitals>) -> Result<Self> {
        use view::watch::web::{Address, Server};

        let Some(config) = config else { return Ok(Self(None)) };
        let address = Address::new(config.bind, Some(config.port), config.token.clone())?;
        let asked = Arc::clone(vitals);
        let health = move || {
            let beat = asked.heartbeat();
            (beat.healthy, beat.text().unwrap_or_default())
        };
        let server = Server::with_health(address, Box::new(health))?;
        vitals.report(crate::Level::Info, &format!("watch at {}", server.url()));
        Ok(Self(Some(server)))
    }

    /// Shows a session of this agent over so many frames.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn show(&self, agent: &AgentInfo, frames: Option<u64>) -> Result<Watch> {
        use view::watch::WatchOptions;

        let server = self.0.clone();
        Watch::start(agent, WatchOptions { server, frames, ..WatchOptions::default() })
    }
}

/// None: this program was built without it.
#[cfg(not(feature = "view"))]
pub struct Page;

#[cfg(not(feature = "view"))]
impl Page {
    /// Serves nothing.
    ///
    /// # Errors
    /// Never: what asks for a page is refused before.
    pub fn start(_config: Option<&PageConfig>, _vitals: &Arc<Vitals>) -> Result<Self> {
        Ok(Self)
    }

    /// Shows nothing.
    ///
    /// # Errors
    /// Never.
    pub fn show(&self, _agent: &AgentInfo, _frames: Option<u64>) -> Result<Watch> {
        Ok(Watch::none())
    }
}
