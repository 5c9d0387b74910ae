//! What neighbours found out: the last of each, of as many nodes as a party may have.

use super::status::ToldFound;
use fleet::findings::Found;
use map::Uuid;
use std::sync::Arc;

/// Of how many nodes of one party it is kept, and where parties have no keys of how many in all.
const OF_PARTY: usize = 4;
const OF_ALL: usize = 64;

/// What neighbours found out, the last that was heard at the end.
#[derive(Default)]
pub(super) struct FoundOut(Vec<One>);

struct One {
    from: Uuid,
    party: Option<Uuid>,
    found: Arc<Found>,
}

impl FoundOut {
    /// A node found something out. How many pairs it had merged by what was known of it before.
    pub fn take(&mut self, from: Uuid, party: Option<Uuid>, found: Found) -> Option<usize> {
        let before = self.0.iter().position(|one| one.from == from).map(|at| self.0.remove(at));
        self.0.push(One { from, party, found: found.into() });
        let most = if party.is_some() { OF_PARTY } else { OF_ALL };
        let is_of_party = |one: &One| one.party == party;
        if self.0.iter().filter(|one| is_of_party(one)).count() > most
            && let Some(eldest) = self.0.iter().position(is_of_party)
        {
            self.0.remove(eldest);
        }
        before.map(|before| before.found.accepted())
    }

    /// All of it, by the names of the nodes.
    pub fn all(&self) -> Vec<(String, ToldFound)> {
        self.0.iter().map(|one| (one.from.to_string(), ToldFound(Arc::clone(&one.found)))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_party_that_says_it_is_many_takes_no_more_than_its_own_place() {
        let mut heard = FoundOut::default();
        let (honest, hostile) = (Uuid::from_u128(1), Uuid::from_u128(2));
        assert_eq!(heard.take(honest, Some(honest), Found::default()), None);
        for number in 0..1000 {
            heard.take(Uuid::from_u128(10 + number), Some(hostile), Found::default());
        }
        let named: Vec<String> = heard.all().into_iter().map(|(name, _)| name).collect();
        assert_eq!(named.len(), 1 + OF_PARTY);
        assert!(named.contains(&honest.to_string()));
        assert!(named.contains(&Uuid::from_u128(1009).to_string()));
        assert_eq!(heard.take(honest, Some(honest), Found::default()), Some(0));
    }
}
