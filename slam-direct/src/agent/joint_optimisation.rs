//! The keyframes and points of several agents with one camera, optimised jointly.

use super::AgentError;
use super::across::observe_others;
use super::resume::{sensor_of, working_map};
use crate::mapping;
use crate::params::Params;
use geometry::Sim3;
use geometry::pose_alignment::{PosePair, align_poses};
use map::{AgentId, KeyframeId, Map};
use std::collections::BTreeMap;

/// Optimises a `common` map jointly: the bundle adjustment that ends a run, over the keyframes and observations of
/// all agents, of each other's points too. The world keeps the place and unit of the first agent's keyframes as a
/// whole. `stop` ends the optimisation early. A map of one agent is optimised in the same way.
///
/// # Errors
/// When the agents have different cameras, a keyframe is missing, or the first agent has too few keyframes to fix the
/// world. The map is unchanged then.
pub fn optimise_jointly(
    common: &mut Map,
    params: &Params,
    stop: &dyn Fn() -> bool,
) -> Result<(), AgentError> {
    params.validate()?;
    let sensor = sensor_of(common)?;
    let mut local = working_map(common, sensor, params.align.pyramid_levels)?;
    observe_others(&mut local, common, params);
    mapping::optimise_all(&mut local, params.mapping.final_iterations, &params.mapping, stop);
    let poses: BTreeMap<KeyframeId, Sim3> =
        common.keyframes.keys().copied().zip((0..).map(|k| local.world_from_keyframe(k))).collect();
    let world_from_local = anchored(common, &poses)?;
    for (id, keyframe) in &mut common.keyframes {
        keyframe.world_from_keyframe = world_from_local * poses[id];
    }
    Ok(())
}

/// What brings `poses` of the keyframes to the world of the `common` map: where most of the first agent's stay as they were.
fn anchored(common: &Map, poses: &BTreeMap<KeyframeId, Sim3>) -> Result<Sim3, AgentError> {
    let first: Option<AgentId> = common.agents.keys().next().copied();
    let of_first = common.keyframes.iter().filter(|(_, keyframe)| Some(keyframe.agent) == first);
    let pairs: Vec<PosePair> = of_first
        .map(|(id, keyframe)| PosePair {
            target_from_body: keyframe.world_from_keyframe.rigid(),
            source_from_body: poses[id].rigid(),
        })
        .collect();
    let aligned =
        align_poses(&pairs).map_err(|error| AgentError::Map(format!("its first agent: {error}")))?;
    Ok(aligned.target_from_source)
}
