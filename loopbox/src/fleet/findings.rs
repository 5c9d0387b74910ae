//! What was found out about where agents are, as it is told to all of them.

use crate::merging::{Input, Merging, refusal_of};
use map::AgentId;
use serde::{Deserialize, Serialize};

/// Where agents are, and who met whom.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Every agent whose map could be looked at.
    pub agents: Vec<FoundAgent>,
    /// Every two of them.
    pub meetings: Vec<FoundMeeting>,
}

/// An agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundAgent {
    /// Its identity, `UUID/EPOCH`.
    pub agent: String,
    /// What people call it.
    pub name: String,
    /// Keyframes of its map that were looked at.
    pub keyframes: usize,
    /// Whether that was all of its map.
    pub whole: bool,
    /// The eldest of the agents it hangs together with: the common frame is its world.
    pub root: String,
    /// Maps points of the agent's world to the common frame, `tx ty tz qx qy qz qw scale`.
    pub root_from_agent: [f64; 8],
}

/// Two agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundMeeting {
    /// Their names.
    pub names: [String; 2],
    /// Their identities, `UUID/EPOCH`.
    #[serde(default)]
    pub agents: [String; 2],
    /// `accepted`, `undecided` or `refused`.
    pub verdict: String,
    /// Why not, where they were not merged.
    pub why: Option<String>,
    /// Whether more of their maps is being looked at before anything is said: they are undecided so far.
    #[serde(default)]
    pub pending: bool,
}

impl Found {
    /// What a merging of maps found; `whole` says of each whether it is all of the agent's map.
    pub(super) fn of(inputs: &[Input], merging: &Merging, whole: &[bool]) -> Self {
        let identity = |agent: AgentId| {
            let own = merging.common.agents().get(&agent)?;
            own.agents.values().next()?.identity.map(|identity| identity.to_string())
        };
        let agent = |(number, input): (usize, &Input)| {
            let id = merging.addresses.get(number)?.agents().next()?;
            let component = merging.fused.iter().map(|fused| &fused.component);
            let (root, place) = component
                .into_iter()
                .find_map(|component| Some((component.root, component.agents.get(&id)?.root_from_agent)))?;
            let [tx, ty, tz, qx, qy, qz, qw] = place.rigid().to_tum();
            Some(FoundAgent {
                agent: identity(id)?,
                name: input.name.clone(),
                keyframes: input.features.len(),
                whole: whole.get(number).copied().unwrap_or(false),
                root: identity(root)?,
                root_from_agent: [tx, ty, tz, qx, qy, qz, qw, place.scale],
            })
        };
        let meetings = merging.encounters.iter().map(|encounter| FoundMeeting {
            names: encounter.as_given().map(|input| inputs[input].name.clone()),
            agents: encounter.as_given().map(|input| {
                let agent = merging.addresses.get(input).and_then(|addresses| addresses.agents().next());
                agent.and_then(identity).unwrap_or_default()
            }),
            verdict: encounter.verdict().to_owned(),
            why: refusal_of(merging, encounter),
            pending: false,
        });
        Self { agents: inputs.iter().enumerate().filter_map(agent).collect(), meetings: meetings.collect() }
    }

    /// What `other` found, and this of what that says nothing of.
    pub(super) fn beside(self, other: &Self) -> Self {
        let mut all = other.clone();
        let agents =
            self.agents.into_iter().filter(|new| other.agents.iter().all(|old| old.agent != new.agent));
        all.agents.extend(agents);
        let is_known = |new: &FoundMeeting| {
            let of_both = |old: &FoundMeeting| new.agents.iter().all(|agent| old.agents.contains(agent));
            other.meetings.iter().any(of_both)
        };
        all.meetings.extend(self.meetings.into_iter().filter(|new| !is_known(new)));
        all
    }

    /// Says of pairs that no more is known of them than that more is looked at.
    pub(super) fn postpone(&mut self, is_pending: impl Fn(&[String; 2]) -> bool) {
        for meeting in self.meetings.iter_mut().filter(|meeting| is_pending(&meeting.agents)) {
            (meeting.pending, meeting.verdict) = (true, "undecided".into());
            meeting.why = Some("more of both maps is being looked at".into());
        }
    }

    /// Whether something was decided about two agents.
    pub(super) fn has_decided(&self, agents: &[String; 2]) -> bool {
        let of_both = |meeting: &&FoundMeeting| agents.iter().all(|agent| meeting.agents.contains(agent));
        self.meetings.iter().filter(of_both).any(|meeting| !meeting.pending)
    }

    /// As it is told.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Numbers and texts can always be written.
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// What others told; `None` when it is not to be understood.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        serde_json::from_slice(bytes).ok()
    }

    /// How many pairs were merged.
    pub fn accepted(&self) -> usize {
        self.meetings.iter().filter(|meeting| meeting.verdict == "accepted").count()
    }
}
