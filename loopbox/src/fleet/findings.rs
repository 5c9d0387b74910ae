//! What merging found out about where agents are.

use crate::merging::{Input, Merging, refusal_of};
use fleet::findings::{Found, FoundAgent, FoundMeeting, numbers};
use map::AgentId;

/// What a merging of maps found; `whole` says of each whether it is all of the agent's map.
pub(super) fn found(inputs: &[Input], merging: &Merging, whole: &[bool]) -> Found {
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
        Some(FoundAgent {
            agent: identity(id)?,
            name: input.name.clone(),
            keyframes: input.features.len(),
            whole: whole.get(number).copied().unwrap_or(false),
            root: identity(root)?,
            root_from_agent: numbers(&place),
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
    Found { agents: inputs.iter().enumerate().filter_map(agent).collect(), meetings: meetings.collect() }
}
