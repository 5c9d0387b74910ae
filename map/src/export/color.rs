//! A colour for each agent.

use crate::AgentId;

/// The colours of Okabe and Ito ("Color universal design", 2008) that stand out from both black and white:
/// people with any kind of colour vision tell them apart. Blue and orange come first, which differ most.
const PALETTE: [[u8; 3]; 7] = [
    [0, 114, 178],
    [230, 159, 0],
    [0, 158, 115],
    [213, 94, 0],
    [86, 180, 233],
    [204, 121, 167],
    [240, 228, 66],
];

/// The colour of an agent wherever several agents are shown: red, green, blue in sRGB. Seven agents have colours that
/// everyone can distinguish; after them the colours repeat, darker each time.
pub fn agent_color(agent: AgentId) -> [u8; 3] {
    let (round, index) = (usize::from(agent.0) / PALETTE.len(), usize::from(agent.0) % PALETTE.len());
    // It is asked for every point of a cloud.
    let per_mille = [1000, 600, 360, 216][round.min(3)];
    PALETTE[index].map(|level| ((u32::from(level) * per_mille + 500) / 1000) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn many_agents_have_colours_of_their_own() {
        let colors: BTreeSet<[u8; 3]> = (0..28).map(|i| agent_color(AgentId(i))).collect();
        assert_eq!(colors.len(), 28);
        assert_eq!(agent_color(AgentId(u16::MAX)).len(), 3);
    }
}
