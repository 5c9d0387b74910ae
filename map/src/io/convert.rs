//! From the map's types to loopbox's messages and back, bit by bit.

use super::messages::{GraphMessage, INFORMATION_LEN, KeyframeMessage, SE3_LEN, SIM3_LEN};
use crate::{AgentId, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Observation, Point, Scan, SemiDense};
use geometry::{GrayImage, Se3, Sim3};
use nalgebra::{Quaternion, SMatrix, UnitQuaternion, Vector3};
use std::sync::Arc;

/// The message of a keyframe; `own_pose` is its pose in its agent's own map, where that is another one.
pub(super) fn keyframe_to_message(keyframe: &Keyframe, own_pose: Option<&Sim3>) -> KeyframeMessage {
    let depth = &keyframe.semi_dense;
    let mut previous = 0;
    let pixel_step =
        depth.pixel.iter().map(|&pixel| pixel - std::mem::replace(&mut previous, pixel)).collect();
    let mut message = KeyframeMessage {
        id: keyframe.id.0,
        timestamp: keyframe.timestamp,
        frame_index: keyframe.frame_index,
        world_from_keyframe: sim3_to_numbers(&keyframe.world_from_keyframe).to_vec(),
        pixel_step,
        inverse_depth: depth.inverse_depth.to_vec(),
        variance: depth.variance.to_vec(),
        agent: keyframe.agent.0.into(),
        own_world_from_keyframe: own_pose.map_or(Vec::new(), |pose| sim3_to_numbers(pose).to_vec()),
        ..Default::default()
    };
    for point in &keyframe.points {
        message.point_pixel.extend(point.pixel);
        message.point_inverse_depth.push(point.inverse_depth);
        message.point_variance.push(point.variance);
        message.point_observation_count.push(point.observations.len() as u32);
        for observation in &point.observations {
            message.observation_keyframe.push(observation.keyframe.0);
            message.observation_pixel.extend(observation.pixel);
            message.observation_information.extend(observation.information);
        }
    }
    message
}

/// The keyframe of a message with its image or scan, and its pose in its agent's own map if there is one; says what
/// is inconsistent.
pub(super) fn keyframe_from_message(
    message: KeyframeMessage,
    image: Arc<GrayImage>,
    scan: Option<Arc<Scan>>,
) -> Result<(Keyframe, Option<Sim3>), String> {
    let name = message.id;
    let unequal = |what: &str| format!("keyframe {name}: the lists of its {what} differ in length");
    let mut pixel = message.pixel_step;
    let mut previous = 0u32;
    for step in &mut pixel {
        previous = previous
            .checked_add(*step)
            .ok_or_else(|| format!("keyframe {name}: a pixel of its depth map lies outside of the image"))?;
        *step = previous;
    }
    let semi_dense = SemiDense {
        pixel: pixel.into(),
        inverse_depth: message.inverse_depth.into(),
        variance: message.variance.into(),
    };
    let observations = observations(
        &message.observation_keyframe,
        &message.observation_pixel,
        &message.observation_information,
    )
    .ok_or_else(|| unequal("observations"))?;
    let points = points(
        [&message.point_pixel, &message.point_inverse_depth, &message.point_variance],
        &message.point_observation_count,
        &observations,
    )
    .ok_or_else(|| unequal("points"))?;
    let no_pose = || format!("keyframe {name} has no pose of {SIM3_LEN} numbers");
    let pose = one_sim3(&message.world_from_keyframe).ok_or_else(no_pose)?;
    let own_pose = match &*message.own_world_from_keyframe {
        [] => None,
        numbers => Some(one_sim3(numbers).ok_or_else(no_pose)?),
    };
    let agent = u16::try_from(message.agent)
        .map_err(|_| format!("keyframe {name}: its agent {} is out of range", message.agent))?;
    let keyframe = Keyframe {
        id: KeyframeId(message.id),
        agent: AgentId(agent),
        timestamp: message.timestamp,
        frame_index: message.frame_index,
        world_from_keyframe: pose,
        image,
        color: None,
        scan,
        semi_dense: semi_dense.into(),
        points,
        features: None,
        words: None,
    };
    Ok((keyframe, own_pose))
}

/// Observations from their lists; `None` when the lengths do not fit.
fn observations(keyframe: &[u32], pixel: &[f32], information: &[f32]) -> Option<Vec<Observation>> {
    let (pixel, pixel_rest) = pixel.as_chunks::<2>();
    let (information, information_rest) = information.as_chunks::<3>();
    let whole = pixel_rest.is_empty() && information_rest.is_empty();
    if !whole || pixel.len() != keyframe.len() || information.len() != keyframe.len() {
        return None;
    }
    let values = pixel.iter().zip(information);
    let observation =
        |(&id, (&pixel, &information))| Observation { keyframe: KeyframeId(id), pixel, information };
    Some(keyframe.iter().zip(values).map(observation).collect())
}

/// Points from their lists (pixel, inverse depth, variance); `None` when the lengths do not fit.
fn points(
    [pixel, inverse_depth, variance]: [&[f32]; 3],
    count: &[u32],
    mut observations: &[Observation],
) -> Option<Vec<Point>> {
    let (pixel, rest) = pixel.as_chunks::<2>();
    let lengths = [pixel.len(), inverse_depth.len(), variance.len()];
    if !rest.is_empty() || lengths.iter().any(|&length| length != count.len()) {
        return None;
    }
    let mut points = Vec::with_capacity(count.len());
    for (i, &own) in count.iter().enumerate() {
        let (own, others) = observations.split_at_checked(own as usize)?;
        observations = others;
        points.push(Point {
            pixel: pixel[i],
            inverse_depth: inverse_depth[i],
            variance: variance[i],
            observations: own.to_vec(),
        });
    }
    observations.is_empty().then_some(points)
}

/// Appends an edge to a message.
pub(super) fn push_edge(message: &mut GraphMessage, edge: &Edge) {
    message.edge_from.push(edge.from.0);
    message.edge_to.push(edge.to.0);
    message.edge_kind.push(edge_kind_to_number(edge.kind));
    message.edge_from_from_to.extend(sim3_to_numbers(&edge.from_from_to));
    message.edge_information.extend(edge.information.iter());
}

/// Appends a frame to a message.
pub(super) fn push_frame(message: &mut GraphMessage, frame: &FramePose) {
    message.frame_timestamp.push(frame.timestamp);
    message.frame_index.push(frame.frame_index);
    message.frame_reference.push(frame.reference.0);
    message.keyframe_from_frame.extend(se3_to_numbers(&frame.keyframe_from_frame));
}

/// The keyframe poses of a message.
pub(super) fn poses_from_message(message: &GraphMessage) -> Result<Vec<(KeyframeId, Sim3)>, String> {
    let poses = sim3s(&message.world_from_keyframe)
        .filter(|poses| poses.len() == message.keyframe_id.len())
        .ok_or("the lists of keyframe poses differ in length")?;
    Ok(message.keyframe_id.iter().map(|&id| KeyframeId(id)).zip(poses).collect())
}

/// The edges of a message.
pub(super) fn edges_from_message(message: &GraphMessage) -> Result<Vec<Edge>, String> {
    let (information, rest) = message.edge_information.as_chunks::<INFORMATION_LEN>();
    let poses = sim3s(&message.edge_from_from_to).unwrap_or_default();
    let lengths =
        [message.edge_from.len(), message.edge_to.len(), message.edge_kind.len(), information.len()];
    if !rest.is_empty() || lengths.iter().any(|&length| length != poses.len()) {
        return Err("the lists of edges differ in length".into());
    }
    let edge = |(i, pose): (usize, Sim3)| {
        Ok(Edge {
            from: KeyframeId(message.edge_from[i]),
            to: KeyframeId(message.edge_to[i]),
            from_from_to: pose,
            information: SMatrix::from_column_slice(&information[i]),
            kind: edge_kind_from_number(message.edge_kind[i])?,
        })
    };
    poses.into_iter().enumerate().map(edge).collect()
}

/// The frames of a message.
pub(super) fn frames_from_message(message: &GraphMessage) -> Result<Vec<FramePose>, String> {
    let (poses, rest) = message.keyframe_from_frame.as_chunks::<SE3_LEN>();
    let lengths = [message.frame_timestamp.len(), message.frame_index.len(), message.frame_reference.len()];
    if !rest.is_empty() || lengths.iter().any(|&length| length != poses.len()) {
        return Err("the lists of frames differ in length".into());
    }
    let frame = |(i, pose): (usize, &[f64; SE3_LEN])| FramePose {
        timestamp: message.frame_timestamp[i],
        frame_index: message.frame_index[i],
        reference: KeyframeId(message.frame_reference[i]),
        keyframe_from_frame: se3_from_numbers(pose),
    };
    Ok(poses.iter().enumerate().map(frame).collect())
}

/// The number that stands for a kind in the file.
fn edge_kind_to_number(kind: EdgeKind) -> u32 {
    match kind {
        EdgeKind::Odometry => 0,
        EdgeKind::Covisibility => 1,
        EdgeKind::Loop => 2,
        EdgeKind::Merge => 3,
    }
}

/// The kind a number stands for.
fn edge_kind_from_number(number: u32) -> Result<EdgeKind, String> {
    match number {
        0 => Ok(EdgeKind::Odometry),
        1 => Ok(EdgeKind::Covisibility),
        2 => Ok(EdgeKind::Loop),
        3 => Ok(EdgeKind::Merge),
        other => Err(format!("an edge has the unknown kind {other}")),
    }
}

/// `tx ty tz qx qy qz qw scale`.
pub(super) fn sim3_to_numbers(pose: &Sim3) -> [f64; SIM3_LEN] {
    let [tx, ty, tz, qx, qy, qz, qw] = se3_to_numbers(&pose.rigid());
    [tx, ty, tz, qx, qy, qz, qw, pose.scale]
}

/// `tx ty tz qx qy qz qw`.
fn se3_to_numbers(pose: &Se3) -> [f64; SE3_LEN] {
    pose.to_tum()
}

/// Similarities from a list of numbers; `None` when the last one is not whole.
fn sim3s(numbers: &[f64]) -> Option<Vec<Sim3>> {
    let (poses, rest) = numbers.as_chunks::<SIM3_LEN>();
    rest.is_empty().then(|| poses.iter().map(sim3_from_numbers).collect())
}

/// The similarity of a list of numbers that holds just one.
fn one_sim3(numbers: &[f64]) -> Option<Sim3> {
    numbers.try_into().ok().map(sim3_from_numbers)
}

/// The inverse of [`sim3_to_numbers`].
fn sim3_from_numbers(&[tx, ty, tz, qx, qy, qz, qw, scale]: &[f64; SIM3_LEN]) -> Sim3 {
    let rigid = se3_from_numbers(&[tx, ty, tz, qx, qy, qz, qw]);
    Sim3::new(rigid.rotation, rigid.translation, scale)
}

/// The inverse of [`se3_to_numbers`]. The quaternion is taken as it is, since normalising would
/// change its last bits; the length is checked by whoever reads.
fn se3_from_numbers(&[tx, ty, tz, qx, qy, qz, qw]: &[f64; SE3_LEN]) -> Se3 {
    Se3::new(UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)), Vector3::new(tx, ty, tz))
}
