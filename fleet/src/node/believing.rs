//! Who may tell what, where parties have keys.
//!
//! A state is believed if the party at the other end of the link signed it, by the certificate that it showed there; so
//! nobody tells another's map, a station no more than an agent. An agent belongs to the party that told it first, with all
//! its epochs. What a party told once it cannot take back: an older version is
//! refused; it is no late one, as a link with TLS keeps the order. The signature holds for whoever gets the state by another way, too: who passes it on need not be believed.

#[cfg(test)]
mod tests;

use super::{Link, Neighbour, Node};
use crate::bytes::printable;
use crate::keys::{Party, Signature};
use crate::wire::Offer;
use map::Uuid;
use std::time::Duration;

/// Nodes of one party, or without keys of all, before those that are gone are forgotten.
const MOST_NODES: usize = 64;

impl Node {
    /// Under its party's name, if parties have keys.
    pub(super) fn signed(&self, offer: &Offer) -> Option<Signature> {
        self.config.signer.as_ref().map(|signer| signer.sign(offer))
    }

    /// Whom one knows as the node at the other end of a link that calls itself `node`. Of a party with keys it is made of
    /// both: so nobody takes another's name by saying it.
    ///
    /// # Errors
    /// When nothing is believed of it, with the reason.
    pub(super) fn known_as(&self, now: Duration, link: &Link, node: Uuid) -> Result<Uuid, String> {
        let party = link.party.as_ref().map(|party| party.id);
        if self.config.signer.is_some() && party.is_none() {
            return Err("it showed no certificate".into());
        }
        let node = party.map_or(node, |party| Uuid::new_v5(&party, node.as_bytes()));
        let distrusted = self.distrusted.get(&node).or(party.and_then(|party| self.distrusted.get(&party)));
        match distrusted {
            Some((reason, until)) if now < *until => Err(reason.clone()),
            _ => Ok(node),
        }
    }

    /// Forgets nodes that are gone and tell nothing, where a party has had many.
    pub(super) fn forget_gone(&mut self, party: Option<Uuid>) {
        let id = |neighbour: &Neighbour| neighbour.party.as_ref().map(|party| party.id);
        if self.neighbours.values().filter(|neighbour| id(neighbour) == party).count() < MOST_NODES {
            return;
        }
        let told = &self.told;
        self.neighbours.retain(|node, neighbour| {
            let is_gone = id(neighbour) == party && neighbour.link.is_none();
            !is_gone || told.values().any(|told| told.teller == *node)
        });
    }

    /// Whether the party at the other end of a link may tell a version of a map.
    ///
    /// # Errors
    /// With the reason why not.
    pub(super) fn may_tell(
        &self,
        link: &Link,
        offer: &Offer,
        signature: Option<&Signature>,
    ) -> Result<(), String> {
        let agent = offer.agent;
        let Some(signer) = &self.config.signer else { return Ok(()) };
        let party = link.party.as_ref().ok_or("it showed no certificate")?;
        let signature = signature.ok_or_else(|| format!("its map of agent {agent} is not signed"))?;
        if !party.has_signed(offer, signature) {
            return Err(format!(
                "the signature under its map of agent {agent} is not that of {}",
                party.name
            ));
        }
        let of_others = |owner: &str| {
            Err(format!("the map of agent {agent} is not {}'s to tell: that agent is {owner}", party.name))
        };
        let is_own = self.own.keys().any(|own| own.uuid == agent.uuid);
        if is_own && party.id != signer.party().id {
            return of_others("told here");
        }
        let mut of_agent = self.told.values().filter(|told| told.offer.agent.uuid == agent.uuid);
        if let Some(owner) = of_agent.find_map(|told| told.party.filter(|owner| *owner != party.id)) {
            return of_others(&self.named(owner));
        }
        match self.told.get(&agent) {
            Some(told) if offer.version() < told.offer.version() => Err(format!(
                "it tells an older version of the map of agent {agent} than was told before: an earlier run's, or a clock is \
                 wrong"
            )),
            _ => Ok(()),
        }
    }

    /// How a party is called, as far as it is known.
    fn named(&self, party: Uuid) -> String {
        let mut parties = self.neighbours.values().filter_map(|neighbour| neighbour.party.as_ref());
        let named = parties.find(|known| known.id == party);
        named.map_or_else(|| "another party's".to_owned(), |known| format!("{}'s", known.name))
    }
}

impl Neighbour {
    /// What people call a neighbour that calls itself `name`: its party is what is sure.
    pub(super) fn call(&mut self, name: &str, party: Option<&Party>) {
        let name = printable(name);
        self.party = party.cloned();
        self.name = match party {
            Some(party) if party.name != name => format!("{name} of {}", party.name),
            _ => name,
        };
    }
}
