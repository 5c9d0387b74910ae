//! Who may tell what, where peers have keys.
//!
//! A state is believed if the peer at the other end of the link signed it, by the certificate that it showed there; so
//! nobody tells another's map, a station no more than an agent. An agent belongs to the peer that told it first, with all
//! its epochs. What a peer told once it cannot take back: an older version is
//! refused; it is no late one, as a link with TLS keeps the order. The signature holds for whoever gets the state by another way, too: who passes it on need not be believed.

#[cfg(test)]
mod tests;

use super::{Link, Neighbour, Node};
use crate::bytes::printable;
use crate::keys::Peer;
use crate::wire::{MapVersion, Signature};
use map::Uuid;
use std::time::Duration;

/// Nodes of one peer, or without keys of all, before those that are gone are forgotten.
const MOST_NODES: usize = 64;

impl Node {
    /// Under its peer's name, if peers have keys.
    pub(super) fn signed(&self, version: &MapVersion) -> Option<Signature> {
        self.config.signer.as_ref().map(|signer| signer.sign(version))
    }

    /// Whom one knows as the node at the other end of a link that calls itself `node`. Of a peer with keys it is made of
    /// both: so nobody takes another's name by saying it.
    ///
    /// # Errors
    /// When nothing is believed of it, with the reason.
    pub(super) fn known_as(&self, now: Duration, link: &Link, node: Uuid) -> Result<Uuid, String> {
        let peer = link.peer.as_ref().map(|peer| peer.id);
        if self.config.signer.is_some() && peer.is_none() {
            return Err("it showed no certificate".into());
        }
        let node = peer.map_or(node, |peer| Uuid::new_v5(&peer, node.as_bytes()));
        let banned = self.banned.get(&node).or(peer.and_then(|peer| self.banned.get(&peer)));
        match banned {
            Some((reason, until)) if now < *until => Err(reason.clone()),
            _ => Ok(node),
        }
    }

    /// Forgets nodes that are gone and tell nothing, where a peer has had many.
    pub(super) fn forget_gone(&mut self, peer: Option<Uuid>) {
        let id = |neighbour: &Neighbour| neighbour.peer.as_ref().map(|peer| peer.id);
        if self.neighbours.values().filter(|neighbour| id(neighbour) == peer).count() < MOST_NODES {
            return;
        }
        let maps = &self.remote_maps;
        self.neighbours.retain(|node, neighbour| {
            let is_gone = id(neighbour) == peer && neighbour.link.is_none();
            !is_gone || maps.values().any(|remote| remote.publisher == *node)
        });
    }

    /// Whether the peer at the other end of a link may tell a version of a map.
    ///
    /// # Errors
    /// With the reason why not.
    pub(super) fn authorise(
        &self,
        link: &Link,
        version: &MapVersion,
        signature: Option<&Signature>,
    ) -> Result<(), String> {
        let agent = version.agent;
        let Some(signer) = &self.config.signer else { return Ok(()) };
        let peer = link.peer.as_ref().ok_or("it showed no certificate")?;
        let signature = signature.ok_or_else(|| format!("its map of agent {agent} is not signed"))?;
        if !peer.has_signed(version, signature) {
            return Err(format!("the signature under its map of agent {agent} is not that of {}", peer.name));
        }
        let of_others = |owner: &str| {
            Err(format!("the map of agent {agent} is not {}'s to tell: that agent is {owner}", peer.name))
        };
        let is_own = self.own.keys().any(|own| own.uuid == agent.uuid);
        if is_own && peer.id != signer.peer().id {
            return of_others("told here");
        }
        let mut of_agent = self.remote_maps.values().filter(|remote| remote.version.agent.uuid == agent.uuid);
        if let Some(owner) = of_agent.find_map(|remote| remote.peer.filter(|owner| *owner != peer.id)) {
            return of_others(&self.named(owner));
        }
        match self.remote_maps.get(&agent) {
            Some(remote) if version.order() < remote.version.order() => Err(format!(
                "it tells an older version of the map of agent {agent} than was told before: an earlier run's, or a clock is \
                 wrong"
            )),
            _ => Ok(()),
        }
    }

    /// How a peer is called, as far as it is known.
    fn named(&self, peer: Uuid) -> String {
        let mut peers = self.neighbours.values().filter_map(|neighbour| neighbour.peer.as_ref());
        let named = peers.find(|known| known.id == peer);
        named.map_or_else(|| "another party's".to_owned(), |known| format!("{}'s", known.name))
    }
}

impl Neighbour {
    /// What people call a neighbour that calls itself `name`: its peer is what is sure.
    pub(super) fn call(&mut self, name: &str, peer: Option<&Peer>) {
        let name = printable(name);
        self.peer = peer.cloned();
        self.name = match peer {
            Some(peer) if peer.name != name => format!("{name} of {}", peer.name),
            _ => name,
        };
    }
}
