//! How long agents waited for their places.

use super::components::Components;
use map::Identity;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How long after something was heard of an agent the parts of its map may be on their way, over a link that is not slow.
const COMING: Duration = Duration::from_millis(400);

/// Since when agents wait, until when they did. It is looked now and then, so what is there at a look came after the look
/// before: from that on it is counted.
#[derive(Clone, Debug, Default)]
pub(super) struct Waits {
    agents: BTreeMap<Identity, Wait>,
    looked: Option<Instant>,
}

/// When something of an agent was there first.
#[derive(Clone, Copy, Debug)]
struct Wait {
    /// Anything.
    discovered: Instant,
    /// The parts of its map by which it is to be seen where it is.
    parts: Option<Instant>,
    /// Its place.
    placed: Option<Instant>,
}

/// Seconds until an agent was told its place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Waited {
    /// From hearing of it.
    pub since_discovery_s: Option<f64>,
    /// From having the parts of its map by which it is to be seen.
    pub parts_s: Option<f64>,
}

impl Waits {
    /// It is looked: something is `discovered` of these agents, and the parts of some are `ready`.
    pub fn look<'a>(
        &mut self,
        discovered: impl Iterator<Item = Identity>,
        ready: impl Iterator<Item = &'a Identity>,
        now: Instant,
    ) {
        let since = self.looked.replace(now).unwrap_or(now);
        for agent in discovered {
            self.agents.entry(agent).or_insert(Wait { discovered: since, parts: None, placed: None });
        }
        for agent in ready {
            if let Some(wait) = self.agents.get_mut(agent) {
                wait.parts.get_or_insert(since);
            }
        }
    }

    /// Whether the parts by which it is to be seen where an agent is are likely to be there in a moment.
    pub fn is_coming(&self, now: Instant) -> bool {
        let is_coming = |wait: &Wait| {
            let is_new = now.saturating_duration_since(wait.discovered) < COMING;
            is_new && wait.parts.is_none() && wait.placed.is_none()
        };
        self.agents.values().any(is_coming)
    }

    /// Who hangs together was told.
    pub fn mark_placed(&mut self, components: &Components, now: Instant) {
        for (_, wait) in self.agents.iter_mut().filter(|(agent, _)| components.is_joined(agent)) {
            wait.placed.get_or_insert(now);
        }
    }

    /// How long an agent waited that has its place.
    pub fn of(&self, agent: &Identity) -> Waited {
        let Some(wait) = self.agents.get(agent) else { return Waited::default() };
        let until = |since: Instant| Some(wait.placed?.saturating_duration_since(since).as_secs_f64());
        Waited { since_discovery_s: until(wait.discovered), parts_s: wait.parts.and_then(until) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::Uuid;

    #[test]
    fn parts_are_expected_for_a_moment_only() {
        let agent = Identity { uuid: Uuid::from_u128(1), epoch: 0 };
        let start = Instant::now();
        let at = |millis: u64| start + Duration::from_millis(millis);
        let mut waits = Waits::default();
        waits.look([agent].into_iter(), [].iter(), at(0));
        assert!(waits.is_coming(at(399)) && !waits.is_coming(at(400)));
        waits.look([agent].into_iter(), [agent].iter(), at(100));
        assert!(!waits.is_coming(at(100)));
    }

    #[test]
    fn an_agent_waits_from_the_look_before_its_discovery_until_its_first_place() {
        let agent = |number: u128| Identity { uuid: Uuid::from_u128(number), epoch: 0 };
        let all = [agent(1), agent(2)];
        let start = Instant::now();
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        let mut waits = Waits::default();
        waits.look(std::iter::empty(), [].iter(), at(0));
        waits.look(all.into_iter(), [].iter(), at(1));
        waits.look(all.into_iter(), all[..1].iter(), at(3));
        waits.look(all.into_iter(), all[..1].iter(), at(4));
        assert_eq!(waits.of(&agent(1)), Waited::default());
        waits.mark_placed(&Components::of_one(&all), at(6));
        waits.mark_placed(&Components::of_one(&all), at(9));
        assert_eq!(waits.of(&agent(1)), Waited { since_discovery_s: Some(6.0), parts_s: Some(5.0) });
        assert_eq!(waits.of(&agent(2)), Waited { since_discovery_s: Some(6.0), parts_s: None });
        assert_eq!(waits.of(&agent(3)), Waited::default());
    }
}
