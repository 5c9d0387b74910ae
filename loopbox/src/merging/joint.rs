//! The joint optimisation of common maps. Closures say of a few pairs of keyframes how two maps lie to each other; what the
//! agents see of each other's points says it all along the way that they share.

use merge::common_map::Fused;
use slam_direct::{AgentError, Params, optimise_jointly};
use std::collections::BTreeSet;

/// Optimises every common map of several agents and of `most` keyframes at the most jointly ([`optimise_jointly`]), until `stop`, besides
/// those that are `settled`, by their numbers. A map that cannot be, for its size, a LiDAR among its agents or different cameras, stays as it is; gives which and why.
pub(super) fn optimised<'a>(
    groups: &'a mut [Fused],
    settled: &BTreeSet<usize>,
    most: usize,
    stop: &dyn Fn() -> bool,
) -> Vec<(&'a Fused, String)> {
    let params = Params::default();
    let open = groups.iter_mut().enumerate().filter(|(number, _)| !settled.contains(number));
    open.filter(|(_, fused)| fused.agents.len() > 1)
        .filter_map(|(_, fused)| {
            let count = fused.map.keyframes.len();
            if count > most {
                let why = format!(
                    "{count} keyframes are more than {most}; --optimise does it however long it takes"
                );
                return Some((&*fused, why));
            }
            let why = match optimise_jointly(&mut fused.map, &params, stop).err()? {
                AgentError::Map(why) => why,
                other => other.to_string(),
            };
            Some((&*fused, why))
        })
        .collect()
}
