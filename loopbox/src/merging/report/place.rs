//! Where the inputs' keyframes are on the page.

use crate::merging::Merging;
use map::{AgentId, Keyframe, KeyframeId};
use merge::common_map::{Addresses, Fused};
use std::collections::BTreeMap;

/// Finds the keyframes of the inputs among those of the map that is shown.
pub struct Places<'a> {
    addresses: &'a [Addresses],
    /// Of each agent shown, by its id in the common map: the first id of its keyframes in the map shown.
    first_ids: BTreeMap<AgentId, u32>,
    /// Index in the scene by id in the map shown.
    indices: BTreeMap<KeyframeId, usize>,
}

impl<'a> Places<'a> {
    /// For the scene of `keyframes` of the map `displayed`.
    pub fn new(merging: &'a Merging, displayed: &Fused, keyframes: &[&Keyframe]) -> Self {
        let first_id = |info: &map::AgentInfo| info.own.as_ref().map_or(0, |own| own.first_keyframe);
        let first_ids =
            displayed.agents.iter().copied().zip(displayed.map.agents.values().map(first_id)).collect();
        let indices = keyframes.iter().zip(0..).map(|(keyframe, index)| (keyframe.id, index)).collect();
        Self { addresses: &merging.addresses, first_ids, indices }
    }

    /// The index in the scene of a keyframe of an input; nothing where it is not shown.
    pub fn of(&self, input: usize, keyframe: &Keyframe) -> Option<usize> {
        let address = self.addresses.get(input)?.of(keyframe.agent, keyframe.id)?;
        let id = self.first_ids.get(&address.agent)?.checked_add(address.keyframe.0)?;
        self.indices.get(&KeyframeId(id)).copied()
    }
}
