//! Agents of a common map see each other's points.
//!
//! A merge gives the relative poses of keyframes of two agents, but each keyframe observes its own agent's points
//! only. Without observations across agents, the joint optimisation would move each agent's keyframes as if the
//! other's showed nothing of where they are.

use crate::closing::match_side;
use crate::local_map::{LocalMap, Matched};
use crate::mapping;
use crate::params::Params;
use map::{AgentId, Map};
use rayon::prelude::*;

/// Lets the keyframes of each agent of a `common` map observe the points of the others' where they look at the same. A
/// keyframe does where as many of the points are found in it, and as large a share, as closes a loop.
pub(super) fn observe_others(local: &mut LocalMap, common: &Map, params: &Params) {
    let whose: Vec<AgentId> = common.keyframes.values().map(|keyframe| keyframe.agent).collect();
    let map = &*local;
    let seen = |keyframe| Some((keyframe, seen_across(map, &whose, keyframe, params)?));
    let found: Vec<(usize, Vec<Matched>)> =
        (0..map.keyframes.len()).into_par_iter().filter_map(seen).collect();
    for (keyframe, matched) in &found {
        mapping::add_observations(local, *keyframe, matched);
    }
}

/// Others' points that a keyframe sees, sought in as many of their keyframes as a loop's two sides have.
fn seen_across(
    local: &LocalMap,
    whose: &[AgentId],
    keyframe: usize,
    params: &Params,
) -> Option<Vec<Matched>> {
    let p = &params.closing;
    let depth = local.median_depth(keyframe)?;
    let hosts = local.around_among(keyframe, depth, 2 * p.side, |other| whose[other] != whose[keyframe]);
    let pose = local.keyframes[keyframe].camera_from_world;
    let side = match_side(local, &hosts, keyframe, pose, &params.track);
    side.is_good(p.min_matched, p.min_share).then_some(side.matched)
}
