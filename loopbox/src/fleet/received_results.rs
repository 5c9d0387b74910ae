//! What neighbours found out: the last of each, of as many nodes as a peer may have.

use super::status::RemoteResults;
use fleet::merge_results::MergeResults;
use map::Uuid;
use std::sync::Arc;

/// Of how many nodes of one peer it is kept, and where peers have no keys of how many in all.
const PER_PEER: usize = 4;
const OF_ALL: usize = 64;

/// What neighbours found out, the last that was heard at the end.
#[derive(Default)]
pub(super) struct ReceivedResults(Vec<One>);

struct One {
    from: Uuid,
    peer: Option<Uuid>,
    found: Arc<MergeResults>,
}

impl ReceivedResults {
    /// A node found something out. How many pairs it had merged by what was known of it before.
    pub fn insert(&mut self, from: Uuid, peer: Option<Uuid>, found: MergeResults) -> Option<usize> {
        let before = self.0.iter().position(|one| one.from == from).map(|at| self.0.remove(at));
        self.0.push(One { from, peer, found: found.into() });
        let most = if peer.is_some() { PER_PEER } else { OF_ALL };
        let is_of_peer = |one: &One| one.peer == peer;
        if self.0.iter().filter(|one| is_of_peer(one)).count() > most
            && let Some(eldest) = self.0.iter().position(is_of_peer)
        {
            self.0.remove(eldest);
        }
        before.map(|before| before.found.accepted())
    }

    /// All of it, by the names of the nodes.
    pub fn all(&self) -> Vec<(String, RemoteResults)> {
        self.0.iter().map(|one| (one.from.to_string(), RemoteResults(Arc::clone(&one.found)))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_that_claims_to_be_many_takes_no_more_than_its_own_place() {
        let mut received = ReceivedResults::default();
        let (honest, hostile) = (Uuid::from_u128(1), Uuid::from_u128(2));
        assert_eq!(received.insert(honest, Some(honest), MergeResults::default()), None);
        for number in 0..1000 {
            received.insert(Uuid::from_u128(10 + number), Some(hostile), MergeResults::default());
        }
        let named: Vec<String> = received.all().into_iter().map(|(name, _)| name).collect();
        assert_eq!(named.len(), 1 + PER_PEER);
        assert!(named.contains(&honest.to_string()));
        assert!(named.contains(&Uuid::from_u128(1009).to_string()));
        assert_eq!(received.insert(honest, Some(honest), MergeResults::default()), Some(0));
    }
}
