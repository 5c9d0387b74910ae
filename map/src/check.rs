//! Checks that a map's parts make sense, the same for a map to write and for one just read.

use crate::agent::owner;
use crate::{AgentInfo, Edge, EdgeKind, FramePose, Keyframe, Map, Point, Sensor};
use geometry::limits::check_image_size;
use geometry::{Pinhole, Se3, Sim3};
use std::collections::BTreeSet;

/// How far a rotation's quaternion may be from unit length; more is not a rotation but a mistake.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Whether a map makes sense in all its parts.
pub(crate) fn map(map: &Map) -> Result<(), String> {
    agents(map)?;
    for (id, keyframe) in &map.keyframes {
        self::keyframe(keyframe, &map.agents[&keyframe.agent].sensor)?;
        keyframe.rest();
        if *id != keyframe.id {
            return Err(format!("keyframe {} is filed under {}", keyframe.id.0, id.0));
        }
    }
    map.edges.iter().try_for_each(edge)?;
    map.frames.iter().try_for_each(frame)
}

/// Whether a map's agents make sense, and every keyframe has one.
pub(crate) fn agents(map: &Map) -> Result<(), String> {
    if map.agents.is_empty() {
        return Err("there is no agent".into());
    }
    let (mut names, mut identities) = (BTreeSet::new(), BTreeSet::new());
    for info in map.agents.values() {
        agent(info)?;
        if !names.insert(&info.name) {
            return Err(format!("two agents have the name \"{}\"", info.name));
        }
        if let Some(identity) = info.identity.filter(|identity| !identities.insert(*identity)) {
            return Err(format!("agent \"{}\" is another one's: both are {identity}", info.name));
        }
        if info.own.is_none() && map.agents.len() > 1 {
            return Err(format!("agent \"{}\" does not know its own map", info.name));
        }
    }
    for keyframe in map.keyframes.values() {
        if let Some(what) = membership_problem(map, keyframe) {
            return Err(format!("keyframe {}: {what}", keyframe.id.0));
        }
    }
    for (agent, info) in &map.agents {
        let has = |id| map.keyframes.get(id).is_some_and(|keyframe| keyframe.agent == *agent);
        let mut own = info.own.iter().flat_map(|own| own.world_from_keyframe.keys());
        if let Some(id) = own.find(|id| !has(id)) {
            let name = &info.name;
            return Err(format!("the own map of agent \"{name}\" has a keyframe {}, which is missing", id.0));
        }
    }
    map.edges.iter().try_for_each(|edge| across(map, edge))
}

/// Whether what is said of one agent makes sense.
pub(crate) fn agent(info: &AgentInfo) -> Result<(), String> {
    if info.name.is_empty() {
        return Err("an agent has no name".into());
    }
    info.camera().map_or(Ok(()), camera)
}

/// What is wrong with a keyframe's place among the agents.
fn membership_problem(map: &Map, keyframe: &Keyframe) -> Option<String> {
    let number = keyframe.agent.0;
    let Some(info) = map.agents.get(&keyframe.agent) else {
        return Some(format!("its agent {number} is not in the map"));
    };
    let own = info.own.as_ref()?;
    if owner(&map.agents, keyframe.id) != Some(keyframe.agent) {
        return Some(format!("its id is not one of agent {number}"));
    }
    match own.world_from_keyframe.get(&keyframe.id) {
        Some(pose) => sim3_problem(pose).map(|what| format!("its pose in the agent's own map {what}")),
        None => Some("it has no pose in the agent's own map".into()),
    }
}

/// Whether an edge that joins two agents says so.
fn across(map: &Map, edge: &Edge) -> Result<(), String> {
    let agent = |id| map.keyframes.get(id).map(|keyframe| keyframe.agent);
    let joins = agent(&edge.from).zip(agent(&edge.to)).is_some_and(|(a, b)| a != b);
    if joins && edge.kind != EdgeKind::Merge {
        let (from, to, kind) = (edge.from.0, edge.to.0, edge.kind);
        return Err(format!(
            "the edge from keyframe {from} to {to} joins two agents, but is of kind {kind:?}"
        ));
    }
    Ok(())
}

/// Whether the camera can have taken an image.
fn camera(camera: &Pinhole) -> Result<(), String> {
    let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
    if let Err(what) = check_image_size(camera.width, camera.height) {
        return Err(format!("the camera's {what}"));
    }
    if !numbers.iter().all(|v| v.is_finite()) || camera.fx <= 0.0 || camera.fy <= 0.0 {
        return Err(format!("the camera {camera:?} is no pinhole camera"));
    }
    Ok(())
}

/// Whether a keyframe fits the sensor and all its numbers are usable.
pub(crate) fn keyframe(keyframe: &Keyframe, sensor: &Sensor) -> Result<(), String> {
    let problem = keyframe_problem(keyframe, sensor);
    problem.map_or(Ok(()), |what| Err(format!("keyframe {}: {what}", keyframe.id.0)))
}

/// What is wrong with a keyframe.
fn keyframe_problem(keyframe: &Keyframe, sensor: &Sensor) -> Option<String> {
    if !keyframe.timestamp.is_finite() {
        return Some(format!("its time stamp is {}", keyframe.timestamp));
    }
    if let Some(what) = sim3_problem(&keyframe.world_from_keyframe) {
        return Some(format!("its pose {what}"));
    }
    match sensor {
        Sensor::Camera(camera) => image_problem(keyframe, camera),
        Sensor::Lidar => scan_problem(keyframe),
    }
}

/// What is wrong with a keyframe that is to have a scan and nothing else.
fn scan_problem(keyframe: &Keyframe) -> Option<String> {
    let Keyframe { scan, image, semi_dense, points, .. } = keyframe;
    if scan.is_none() {
        return Some("it is a LiDAR's and has no scan".into());
    }
    let other = !image.data().is_empty() || !semi_dense.is_empty() || !points.is_empty();
    other.then(|| "it is a LiDAR's and has an image, depth or points of images".into())
}

/// What is wrong with a keyframe's image and depths.
fn image_problem(keyframe: &Keyframe, camera: &Pinhole) -> Option<String> {
    if keyframe.scan.is_some() {
        return Some("it is a camera's and has a scan".into());
    }
    let size = (keyframe.image.width(), keyframe.image.height());
    if size != (camera.width, camera.height) {
        return Some(format!(
            "its image has {}×{} pixels, the camera {}×{}",
            size.0, size.1, camera.width, camera.height
        ));
    }
    semi_dense_problem(keyframe, camera)
        .or_else(|| keyframe.points.iter().enumerate().find_map(|(i, point)| point_problem(i, point)))
}

/// What is wrong with a keyframe's inverse depths.
fn semi_dense_problem(keyframe: &Keyframe, camera: &Pinhole) -> Option<String> {
    let depth = &keyframe.semi_dense;
    let (pixels, depths, variances) = (depth.pixel.len(), depth.inverse_depth.len(), depth.variance.len());
    if pixels != depths || pixels != variances {
        return Some(format!("{pixels} pixels have {depths} inverse depths and {variances} variances"));
    }
    if depth.pixel.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Some("the pixels of its depth map are not in ascending order".into());
    }
    let last = depth.pixel.last().copied().unwrap_or(0) as usize;
    if last >= camera.width * camera.height {
        return Some(format!("pixel {last} of its depth map lies outside of the image"));
    }
    let bad = depth.iter().find(|&(_, d, v)| !(d > 0.0 && d.is_finite() && v >= 0.0 && v.is_finite()));
    bad.map(|(pixel, d, v)| format!("pixel {pixel} has inverse depth {d} with variance {v}"))
}

/// What is wrong with a sparse point.
fn point_problem(index: usize, point: &Point) -> Option<String> {
    let own = [point.pixel[0], point.pixel[1], point.inverse_depth, point.variance];
    let seen = point.observations.iter().flat_map(|o| o.pixel.into_iter().chain(o.information));
    let finite = own.into_iter().chain(seen).all(f32::is_finite);
    (!finite).then(|| format!("point {index} holds a number that is not finite"))
}

/// Whether an edge's numbers are usable.
pub(crate) fn edge(edge: &Edge) -> Result<(), String> {
    let name = || format!("the edge from keyframe {} to {}", edge.from.0, edge.to.0);
    if let Some(what) = sim3_problem(&edge.from_from_to) {
        return Err(format!("{}: its pose {what}", name()));
    }
    if !edge.information.iter().all(|v| v.is_finite()) {
        return Err(format!("{}: its information is not finite", name()));
    }
    Ok(())
}

/// Whether a frame's numbers are usable.
pub(crate) fn frame(frame: &FramePose) -> Result<(), String> {
    if !frame.timestamp.is_finite() {
        return Err(format!("frame {}: its time stamp is {}", frame.frame_index, frame.timestamp));
    }
    match se3_problem(&frame.keyframe_from_frame) {
        Some(what) => Err(format!("frame {}: its pose {what}", frame.frame_index)),
        None => Ok(()),
    }
}

/// What is wrong with a similarity.
pub(crate) fn sim3_problem(pose: &Sim3) -> Option<String> {
    if !(pose.scale.is_finite() && pose.scale > 0.0) {
        return Some(format!("has scale {}", pose.scale));
    }
    se3_problem(&pose.rigid())
}

/// What is wrong with a rigid motion.
fn se3_problem(pose: &Se3) -> Option<String> {
    if !pose.is_finite() {
        return Some("is not finite".into());
    }
    let length = pose.rotation.quaternion().norm();
    ((length - 1.0).abs() > UNIT_TOLERANCE).then(|| format!("has a quaternion of length {length}"))
}
