//! What is said of neighbours as they come and go.

use crate::Level;
use fleet::node::Notice;
use std::collections::BTreeSet;

/// Whose acknowledgement was said: it comes with each version of a map, several times a minute.
#[derive(Debug, Default)]
pub struct Saying(BTreeSet<String>);

impl Saying {
    /// What to say of a notice, and how much it matters; nothing of one that is worked on elsewhere.
    pub fn text(&mut self, notice: &Notice) -> Option<(Level, String)> {
        Some(match notice {
            Notice::Connected { name, address } => {
                // Whether it holds what came meanwhile is news.
                self.0.remove(name);
                (Level::Info, format!("{name} is there, at {address}"))
            }
            Notice::Disconnected { name, reason } => {
                (Level::Warn, format!("{name} is not there any more: {reason}"))
            }
            Notice::Unanswered { address, reason } => {
                (Level::Warn, format!("{address} does not answer ({reason}); it is dialled again and again"))
            }
            Notice::Stored { by, .. } if self.0.insert(by.clone()) => {
                (Level::Info, format!("{by} holds all of the map told so far, and is told what is added"))
            }
            Notice::Stored { by, agent, version: (_, version) } => {
                (Level::Debug, format!("{by} holds version {version} of the map of {agent}"))
            }
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::Identity;

    #[test]
    fn that_a_neighbour_holds_the_map_is_reported_once_until_it_comes_again() {
        let stored = |by: &str, version| Notice::Stored {
            by: by.into(),
            agent: Identity::random([7; 16]),
            version: (1, version),
        };
        let mut saying = Saying::default();
        let said =
            |saying: &mut Saying, notice| saying.text(&notice).is_some_and(|(level, _)| level < Level::Debug);
        let found: Vec<bool> = (0..5).map(|version| said(&mut saying, stored("base", version))).collect();
        assert_eq!(found, [true, false, false, false, false]);
        assert!(said(&mut saying, stored("car-7", 1)), "another");
        let back = Notice::Connected { name: "base".into(), address: "10.0.0.1:7447".into() };
        assert!(said(&mut saying, back) && said(&mut saying, stored("base", 5)));
        assert!(!said(&mut saying, stored("base", 6)) && !said(&mut saying, stored("car-7", 2)));
    }
}
