//! What to call the agents of a common map, in messages and in file names.

use anyhow::{Context, Result, bail};
use map::{AgentId, Map};
use merge::common_map::CommonMap;
use std::collections::BTreeMap;

/// A name for every agent of a common map, unique and safe in file names.
#[derive(Clone, Debug)]
pub struct Names(BTreeMap<AgentId, String>);

impl Names {
    /// The agents' own names, those that occur twice numbered.
    pub fn new(common: &CommonMap) -> Self {
        Self::of_agents(common.agents().iter().map(|(id, own)| (*id, own)))
    }

    /// The same of agents by their own maps.
    pub(crate) fn of_agents<'a>(own: impl Iterator<Item = (AgentId, &'a Map)>) -> Self {
        let infos = own.filter_map(|(id, own)| Some((id, own.agents.values().next()?)));
        let agents: BTreeMap<AgentId, map::AgentInfo> =
            infos.map(|(id, info)| (id, map::AgentInfo::new(&info.name, info.sensor))).collect();
        // Only a map knows how to make labels of names, and this one holds nothing else.
        let Some(first) = agents.values().next().cloned() else { return Self(BTreeMap::new()) };
        let labelled = Map { agents, ..Map::of(first) };
        Self(labelled.agent_labels())
    }

    /// The name of an agent; nobody's is empty.
    pub fn of(&self, agent: AgentId) -> &str {
        self.0.get(&agent).map_or("", |name| name)
    }

    /// The names of some agents as people list them: `a`, `a and b`, `a, b and c`.
    pub fn list(&self, agents: &[AgentId]) -> String {
        listed(&agents.iter().map(|agent| self.of(*agent)).collect::<Vec<_>>())
    }
}

/// What to call a map: its agents' names.
pub(crate) fn name_of(map: &Map) -> String {
    map.agents.values().map(|agent| &*agent.name).collect::<Vec<_>>().join("+")
}

/// A name with the least number that makes it one that is not taken; the name itself where it is not.
pub(crate) fn untaken(name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    // Names do not end.
    names.find(|name| !is_taken(name)).unwrap_or_default()
}

/// Words as people list them: `a`, `a and b`, `a, b and c`.
pub fn listed(words: &[&str]) -> String {
    match words {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

/// The two inputs that `text` names as `A+B`; names may hold a `+` themselves.
///
/// # Errors
/// When it names no two of the inputs, or one twice.
pub(crate) fn named_pair(text: &str, names: &[&str]) -> Result<[usize; 2]> {
    let place = |name: &str| names.iter().position(|other| *other == name);
    let split = |(at, _)| Some([place(&text[..at])?, place(&text[at + 1..])?]);
    let found = text.match_indices('+').find_map(split);
    let [a, b] = found.with_context(|| {
        format!(
            "--confirm {text}: names no two of the maps\nhint: they are called {}; write --confirm A+B",
            names.join(", ")
        )
    })?;
    if a == b {
        bail!("--confirm {text}: names one map twice");
    }
    Ok([a.min(b), a.max(b)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pinhole;
    use map::AgentInfo;

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };

    #[test]
    fn lists_read_as_people_write_them() {
        assert_eq!(listed(&["a"]), "a");
        assert_eq!(listed(&["a", "b"]), "a and b");
        assert_eq!(listed(&["a", "b", "c"]), "a, b and c");
    }

    #[test]
    fn agents_of_one_name_are_distinguished() {
        let maps: Vec<Map> = ["yard", "yard"].map(|name| Map::of(AgentInfo::new(name, CAMERA))).into();
        let (common, _) = CommonMap::from_maps(&maps.iter().collect::<Vec<_>>()).unwrap();
        let names = Names::new(&common);
        assert_eq!([0, 1].map(|id| names.of(AgentId(id))), ["yard", "yard-2"]);
        assert_eq!(names.list(&[AgentId(0), AgentId(1)]), "yard and yard-2");
    }

    #[test]
    fn pairs_are_called_by_both_names() {
        let names = ["a", "b", "a+b"];
        assert_eq!(named_pair("b+a", &names).unwrap(), [0, 1]);
        assert_eq!(named_pair("a+b+b", &names).unwrap(), [1, 2]);
        for (text, why) in [("a", "no two"), ("a+c", "called a, b, a+b"), ("a+a", "twice")] {
            let error = named_pair(text, &names).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}
