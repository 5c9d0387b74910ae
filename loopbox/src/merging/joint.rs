//! The joint optimisation of common maps. Closures say of a few pairs of keyframes how two maps lie to each other; what the
//! agents see of each other's points says it all along the way that they share.

use merge::common_map::Fused;
use slam_direct::{AgentError, Params, optimise_jointly};

/// Optimises every common map of several agents and of `most` keyframes at the most jointly ([`optimise_jointly`]), until `stop`. A map
/// that cannot be, for its size, a LiDAR among its agents or different cameras, stays as it is; gives which and why.
pub(super) fn optimised<'a>(
    groups: &'a mut [Fused],
    most: usize,
    stop: &dyn Fn() -> bool,
) -> Vec<(&'a Fused, String)> {
    let params = Params::default();
    let several = groups.iter_mut().filter(|fused| fused.agents.len() > 1);
    several
        .filter_map(|fused| {
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
