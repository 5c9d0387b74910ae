//! Resuming a map from an earlier run: to extend it, or only to localise in it.

use super::across::observe_others;
use super::mapper::{MapQuality, Mapper, index_all};
use super::{Agent, AgentError, State, error};
use crate::closing::edges;
use crate::local_map::{KeyframeState, LocalMap, PointRef, PointState, SeenAt};
use crate::params::Params;
use crate::tracker::Tracker;
use geometry::sensor::Sensor;
use geometry::{Pinhole, Pyramid, Se3};
use map::{Edge, Map, MapDelta, PlaceIndex};
use std::sync::Arc;

/// The use of a map from an earlier run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResumeMode {
    /// The map is extended: frames and keyframes are added, and it is optimised as if there had been no break.
    Mapping,
    /// The map stays as it is; frames get poses in it.
    Localising,
}

impl Agent {
    /// An agent that resumes a `map`, which its camera must have made. It searches the first frames among all
    /// keyframes of the map, wherever the camera was meanwhile. Until it finds one, nothing changes.
    ///
    /// The map may be the common map of several agents with the same camera. An agent that extends it is one more of
    /// them: it publishes its own map, in the world of the common one, and [`joint`](Self::joint) makes one map of
    /// both.
    ///
    /// The agent reads the remaining distortion of the lens from the map's provenance, if it is there. Indices of new
    /// frames must come after those of the map. The first report contains the whole map as a delta.
    ///
    /// ```no_run
    /// use place_recog::ThumbnailIndex;
    /// use slam_direct::{Agent, Frame, Params, ResumeMode};
    /// # fn frames() -> Vec<Frame> { Vec::new() }
    ///
    /// let map = map::load_map("out/map.mcap")?.map;
    /// let places = Box::new(ThumbnailIndex::default());
    /// let mut agent = Agent::resume(map, places, Params::default(), ResumeMode::Mapping)?;
    /// for frame in frames() {
    ///     let report = agent.process(frame)?;
    ///     println!("{:?}: {:?}", report.state, report.world_from_camera);
    /// }
    /// agent.finish();
    /// map::save_map("out/extended.mcap", &agent.into_map())?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// When the agents of the map have different cameras, a keyframe is missing, or there is nothing to track
    /// against; those of [`new`](Self::new).
    pub fn resume(
        mut map: Map,
        mut places: Box<dyn PlaceIndex>,
        params: Params,
        mode: ResumeMode,
    ) -> Result<Self, AgentError> {
        params.validate()?;
        let sensor = sensor_of(&map)?;
        let camera = sensor.lens.camera;
        error::check_camera(&camera)?;
        let mut local = working_map(&map, sensor, params.align.pyramid_levels)?;
        let is_extended_common = mode == ResumeMode::Mapping && map.agents.len() > 1;
        if is_extended_common {
            observe_others(&mut local, &map, &params);
        }
        let newest = map.frames.last().map(|frame| frame.reference.0 as usize);
        let newest = newest.filter(|&k| k < local.keyframes.len());
        let mut references = newest.into_iter().chain((0..local.keyframes.len()).rev());
        let reference = references
            .find(|&k| local.has_points(k))
            .ok_or(AgentError::Map("it has no points to track against".into()))?;
        index_all(places.as_mut(), &local);
        let mut agent = Self::new(camera, places, params)?;
        let last = match map.frames.last().filter(|frame| LocalMap::id(reference) == frame.reference) {
            // Where the camera was, it is soonest.
            Some(frame) => local.camera_from_world(reference, &frame.keyframe_from_frame),
            None => local.keyframes[reference].camera_from_world,
        };
        let tracker = Tracker::new(&local, reference, last, Se3::identity(), &agent.params).seeking();
        agent.state = State::Running(Box::new(tracker));
        let mapper = agent
            .mapper
            .take()
            .map(|fresh| Box::new(Mapper::resume(local.clone(), fresh.places, &map.edges)));
        agent.first_open = local.keyframes.len();
        agent.closed = mapper.as_ref().map_or(Vec::new(), |mapper| mapper.closed().to_vec());
        agent.mapper = mapper;
        agent.map_quality = MapQuality::Kept;
        agent.view = local;
        if mode == ResumeMode::Localising {
            map.frames.clear();
        }
        if is_extended_common {
            agent.common = Some(Box::new(map));
            map = Map::new(camera);
        }
        agent.pending_deltas.push(MapDelta::whole(&map));
        (agent.next_sequence, agent.map, agent.resumed, agent.is_relocalising) = (1, map, Some(mode), true);
        Ok(agent)
    }

    /// The camera of the frames.
    pub fn camera(&self) -> Pinhole {
        self.camera
    }

    /// Whether the map was given to the agent and is not its to give up or, while localising, to change.
    pub(crate) fn resumed(&self) -> Option<ResumeMode> {
        self.resumed
    }
}

/// The edges between the keyframes of one agent's map, from the points that they share. An agent makes them when it
/// ends, so the map of a killed run has none. Loops are not among them.
///
/// # Errors
/// When the map is not one agent's with a camera, or lacks keyframes.
pub fn edges_of(map: &Map) -> Result<Vec<Edge>, AgentError> {
    if map.agents.len() > 1 {
        return Err(AgentError::Map("it holds the maps of several agents, which have their edges".into()));
    }
    let sensor = sensor_of(map)?;
    error::check_camera(&sensor.lens.camera)?;
    Ok(edges::all(&working_map(map, sensor, 1)?, &[]))
}

/// The sensor of the agents of a map: of one camera, as the agent with most keyframes has seen it. Each has found out for
/// itself what is left of its lens's distortion, and the rays of all points are to be by one.
pub(super) fn sensor_of(map: &Map) -> Result<Sensor, AgentError> {
    let refused = |what: String| Err(AgentError::Map(what));
    let mut sensors = Vec::new();
    for (id, about) in &map.agents {
        let Some(sensor) = about.image_sensor() else {
            return refused(match map.agents.len() {
                1 => "it is a LiDAR's".into(),
                _ => format!("its agent \"{}\" has a LiDAR", about.name),
            });
        };
        let keyframes = map.keyframes.values().filter(|keyframe| keyframe.agent == *id).count();
        sensors.push((keyframes, sensor, &about.name));
    }
    let Some((_, first, name)) = sensors.first().copied() else { return refused("it is nobody's".into()) };
    if let Some((_, _, other)) = sensors.iter().find(|(_, sensor, _)| sensor.lens.camera != first.lens.camera)
    {
        return refused(format!("its agents \"{name}\" and \"{other}\" have different cameras"));
    }
    // Of equals the first.
    let most = sensors.iter().rev().max_by_key(|(keyframes, ..)| *keyframes);
    Ok(most.map_or(first, |(_, sensor, _)| *sensor))
}

/// The working map of a map that was handed out.
pub(super) fn working_map(map: &Map, sensor: Sensor, levels: usize) -> Result<LocalMap, AgentError> {
    let camera = sensor.lens.camera;
    let mut local = LocalMap { sensor, ..LocalMap::new(camera) };
    for (keyframe, motion) in map.keyframes.values().zip(map.motions()) {
        let index = local.keyframes.len();
        if keyframe.id != LocalMap::id(index) {
            return Err(AgentError::Map(format!("keyframe {index} is missing")));
        }
        let (width, height) = (keyframe.image.width(), keyframe.image.height());
        if (width, height) != (camera.width, camera.height) {
            return Err(AgentError::Map(format!(
                "the image of keyframe {index} has {width} × {height} pixels"
            )));
        }
        let pyramid = Pyramid::of(Arc::clone(&keyframe.image), levels);
        let pose = keyframe.world_from_keyframe;
        let state =
            KeyframeState::new(keyframe.timestamp, keyframe.frame_index, pyramid, pose.rigid().inverse());
        let semi_dense = keyframe.semi_dense.clone();
        local.push(KeyframeState { scale: pose.scale, motion, semi_dense, ..state });
    }
    let count = local.keyframes.len();
    for (host, keyframe) in map.keyframes.values().enumerate() {
        let scale = keyframe.world_from_keyframe.scale;
        for (index, point) in keyframe.points.iter().enumerate() {
            let known = |o: &&map::Observation| (o.keyframe.0 as usize) < count;
            let seen: Vec<SeenAt> = point
                .observations
                .iter()
                .filter(known)
                .map(|o| SeenAt {
                    keyframe: o.keyframe.0 as usize,
                    pixel: o.pixel,
                    information: o.information,
                })
                .collect();
            for seen in &seen {
                local.keyframes[seen.keyframe].seen.push(PointRef { host, index });
            }
            let inverse_depth = f64::from(point.inverse_depth) / scale;
            let alive = !seen.is_empty() && point.inverse_depth > 0.0;
            let state = PointState {
                pixel: point.pixel,
                ray: local.ray(host, point.pixel, inverse_depth),
                inverse_depth,
                variance: f64::from(point.variance) / (scale * scale),
                doubt: 0.0,
                observations: seen,
                alive,
                searched: 0,
                found: 0,
            };
            local.keyframes[host].points.push(state);
        }
    }
    Ok(local)
}

#[cfg(test)]
mod tests;
