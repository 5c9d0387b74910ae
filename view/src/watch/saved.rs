//! Maps that are saved, as a scene.

use super::chunk::Chunk;
use super::feed::loops_of;
use super::scene::{Agent, Placed, Scene};
use super::station::steps;
use super::status::Status;
use map::{AgentId, Map, MapError};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Everything of a map, of one agent or several.
///
/// # Errors
/// When an agent has no camera.
pub fn scene(map: &Map) -> Result<Scene, MapError> {
    map.of_cameras()?;
    let index: BTreeMap<AgentId, u16> = map.agents.keys().copied().zip(0..).collect();
    let agents = map.agents.values().filter_map(|info| {
        Some(Agent { name: info.name.clone(), camera: *info.camera()?, metric: info.is_metric() })
    });
    let mut scene = Scene::of(agents.collect());
    scene.place(map.keyframes.values().map(|keyframe| Placed {
        id: keyframe.id.0,
        agent: index.get(&keyframe.agent).copied().unwrap_or_default(),
        frame_index: keyframe.frame_index,
        world_from_keyframe: keyframe.world_from_keyframe,
    }));
    let keyframes: Vec<_> =
        map.keyframes.values().filter(|keyframe| !keyframe.semi_dense.is_empty()).collect();
    let chunks: Vec<_> = keyframes
        .into_par_iter()
        .map(|k| (k.id.0, Chunk::new(map.camera(k), &k.image, k.color.as_ref(), &k.semi_dense)))
        .collect();
    chunks.into_iter().for_each(|(id, chunk)| scene.set_chunk(id, chunk));
    scene.set_trajectory(0, steps(map, &index));
    scene.set_edges(loops_of(&map.edges));
    let (keyframes, points) = (scene.keyframes().count(), scene.points());
    scene.set_status(Status { state: "saved", keyframes, points, ..Status::default() });
    Ok(scene)
}
