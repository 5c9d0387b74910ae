//! Pairing with other agents, over all sessions of an agent.

use super::config::AgentConfig;
use super::vitals::Vitals;
use crate::run::PreparedRun;
use anyhow::Result;
use std::sync::Arc;
use view::watch::Watch;

/// Where what agents tell each other is kept, within the folder of sessions.
#[cfg(feature = "fleet")]
const FOLDER: &str = "pairing";

/// Who pairs, or nobody.
#[cfg(feature = "fleet")]
pub struct Pairing(Option<crate::fleet::Fleet>);

#[cfg(feature = "fleet")]
impl Pairing {
    /// Begins to pair, if that is wanted.
    ///
    /// # Errors
    /// When an address is none or cannot be listened at, or keys cannot be read.
    pub fn start(config: &AgentConfig, name: &str, vitals: &Arc<Vitals>) -> Result<Self> {
        use crate::fleet::{Endpoint, Fleet, FleetOptions};

        let Some(fleet) = &config.fleet else { return Ok(Self(None)) };
        let endpoint = |text: &String| {
            let parsed: Result<Endpoint, _> = text.parse();
            parsed.map_err(|error| anyhow::anyhow!("[fleet]: {text}: {error}"))
        };
        let options = FleetOptions {
            store: None,
            out: config.out.join(FOLDER),
            force: false,
            name: fleet.name.clone().unwrap_or_else(|| name.to_owned()),
            is_station: false,
            in_background: true,
            listen: fleet.listen.as_ref().map(endpoint).transpose()?,
            dial: fleet.connect.iter().map(endpoint).collect::<Result<_>>()?,
            keys: fleet.keys.clone(),
        };
        let reporter = Arc::clone(vitals);
        let fleet = Fleet::start(
            &options,
            None,
            move |level, text| reporter.report(level, &format!("fleet: {text}")),
            Vec::new(),
        )?;
        Ok(Self(Some(fleet)))
    }

    /// Has the maps of a run told to the others.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn publish_run(&self, run: PreparedRun) -> Result<PreparedRun> {
        Ok(match &self.0 {
            Some(fleet) => run.with_listener(fleet.publisher()?),
            None => run,
        })
    }

    /// Has shown on the page of a session whom it knows.
    pub fn show_on(&self, watch: &Watch) {
        if let Some(fleet) = &self.0 {
            fleet.report_to(watch.neighbourhood());
        }
    }

    /// Has all of a session's map told that is not told yet; it goes to the others while the next session runs.
    pub fn end_session(&self) {
        if let Some(fleet) = &self.0 {
            let at_once = sources::Stop::default();
            at_once.request();
            fleet.hand_over(std::time::Duration::ZERO, &at_once);
        }
    }

    /// Ends at once, as a process that is killed does: what is kept is whole at any time, and told at the next start.
    pub fn abandon(self) {
        std::mem::forget(self);
    }
}

/// Nobody: this program was built without it.
#[cfg(not(feature = "fleet"))]
pub struct Pairing;

#[cfg(not(feature = "fleet"))]
impl Pairing {
    /// Pairs with nobody.
    ///
    /// # Errors
    /// Never: what asks for it is refused before.
    pub fn start(_config: &AgentConfig, _name: &str, _vitals: &Arc<Vitals>) -> Result<Self> {
        Ok(Self)
    }

    /// Tells nobody.
    ///
    /// # Errors
    /// Never.
    pub fn publish_run(&self, run: PreparedRun) -> Result<PreparedRun> {
        Ok(run)
    }

    /// Knows nobody.
    pub fn show_on(&self, _watch: &Watch) {}

    /// Has nothing to tell.
    pub fn end_session(&self) {}

    /// Does nothing.
    pub fn abandon(self) {}
}
