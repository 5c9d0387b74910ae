//! What a step of the collector works with.

use crate::fleet::agents::Place;
use crate::fleet::common_maps::Failed;
use anyhow::Result;
use fleet::merge_results::MergeResults;
use fleet::node::MapSnapshot;
use fleet::service::Service;
use fleet::store::{FolderStore, Objects, Pin};
use map::Identity;
use place_recog::Vocabulary;
use sources::Stop;
use std::path::Path;
use std::sync::Arc;

/// What is there of others, and who is told what is wrong with it.
pub(super) struct Step<'a> {
    /// All maps that are here, whole or in part.
    pub all: Vec<MapSnapshot>,
    /// The objects, of which none goes meanwhile.
    pub store: Arc<FolderStore>,
    _pin: Pin,
    /// The node.
    pub service: &'a Service,
    /// Is told what people should know.
    pub warn: &'a (dyn Fn(&str) + Sync),
    /// What others found.
    pub remote_results: &'a [Arc<MergeResults>],
    /// Ends what takes long.
    pub stop: &'a Stop,
}

impl<'a> Step<'a> {
    /// By what is here now.
    pub fn new(
        service: &'a Service,
        remote_results: &'a [Arc<MergeResults>],
        warn: &'a (dyn Fn(&str) + Sync),
        stop: &'a Stop,
    ) -> Self {
        let store = service.store();
        let pin = store.pin();
        let all = service.snapshots().into_iter().chain(service.own()).collect();
        Self { all, store, _pin: pin, service, warn, remote_results, stop }
    }

    /// The same by what is here by now.
    pub fn renewed(&self) -> Self {
        Self::new(self.service, self.remote_results, self.warn, self.stop)
    }

    /// Where maps are put together.
    pub fn place<'b>(&'b self, folder: &'b Path, vocabulary: &'b Vocabulary) -> Place<'b> {
        Place { store: &*self.store, folder, vocabulary }
    }

    /// Whether all runs are over and all of their maps is here.
    pub fn is_over(&self) -> bool {
        self.all.iter().all(|snapshot| snapshot.finished && snapshot.missing == 0)
    }

    /// Whether a merge has something to tell; says what went wrong with it.
    ///
    /// # Errors
    /// When the results cannot be written.
    pub fn merged(&self, result: Result<bool, Failed>) -> Result<bool> {
        match result {
            Ok(has_changed) => return Ok(has_changed),
            Err(Failed::Merge(_)) if self.stop.requested() => {}
            // What is wrong with these maps may be mended by more of them.
            Err(Failed::Merge(error)) => (self.warn)(&format!("the maps are not merged: {error:#}")),
            Err(Failed::Write(error)) => return Err(error),
        }
        Ok(false)
    }

    /// Has nothing more to do with whoever told a map that is none.
    pub fn leave_out(&self, agent: Identity, reason: String) {
        (self.warn)(&format!("the map of {agent} is left out: {reason}"));
        self.service.ban(agent, reason);
    }
}
