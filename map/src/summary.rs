//! The content of a map in numbers.

use crate::{AgentId, AgentInfo, EdgeKind, Identity, Map, SensorKind};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// A map in numbers, for people (`Display`) and programs (`Serialize`).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of keyframes.
    pub keyframes: usize,
    /// Sparse points, all keyframes together.
    pub points: usize,
    /// Observations of the sparse points.
    pub observations: usize,
    /// Pixels with inverse depth, all keyframes together.
    pub depth_pixels: usize,
    /// Share of all keyframes' pixels that have inverse depth, 0–1.
    pub density: f64,
    /// Points of scans, all keyframes together.
    pub scan_points: usize,
    /// Edges that join successive keyframes.
    pub odometry_edges: usize,
    /// Edges between keyframes that share points.
    pub covisibility_edges: usize,
    /// Loops closed.
    pub loop_edges: usize,
    /// Meetings of agents.
    pub merge_edges: usize,
    /// Frames tracked.
    pub frames: usize,
    /// Seconds from the first to the last tracked frame, the sum over the agents.
    pub duration: f64,
    /// Length of the trajectories, map units, the sum over the agents.
    pub path_length: f64,
    /// Whether a map unit is a metre.
    pub metric: bool,
    /// Size of the file, bytes, where the map came from one.
    pub file_bytes: Option<u64>,
    /// The agents in order.
    pub agents: Vec<AgentSummary>,
    /// How their maps came together; empty for one agent.
    pub merge_provenance: BTreeMap<String, String>,
}

/// The part of one agent in a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AgentSummary {
    /// Its name.
    pub name: String,
    /// Its identity and the epoch of this map; `null` if it has none.
    pub identity: Option<Identity>,
    /// Its sensor.
    pub sensor: SensorKind,
    /// Image width and height, pixels; none of a LiDAR.
    pub image_size: Option<[usize; 2]>,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Keyframes that have features.
    pub described: usize,
    /// Frames tracked.
    pub frames: usize,
    /// Seconds from the first to the last tracked frame.
    pub duration: f64,
    /// Length of the trajectory, map units.
    pub path_length: f64,
    /// Whether a map unit is a metre.
    pub metric: bool,
    /// Where its map came from.
    pub provenance: BTreeMap<String, String>,
}

impl Map {
    /// The map in numbers; `file_bytes` is the size of its file, if it has one.
    pub fn summary(&self, file_bytes: Option<u64>) -> Summary {
        let keyframes = self.keyframes.values();
        let points = keyframes.clone().flat_map(|keyframe| &keyframe.points);
        let all_pixels: usize = keyframes.clone().map(|keyframe| keyframe.image.data().len()).sum();
        let depth_pixels = keyframes.map(|keyframe| keyframe.semi_dense.len()).sum();
        let edges = |kind| self.edges.iter().filter(|edge| edge.kind == kind).count();
        let agents: Vec<_> = self.agents.iter().map(|(id, info)| self.agent_summary(*id, info)).collect();
        Summary {
            keyframes: self.keyframes.len(),
            points: points.clone().count(),
            observations: points.map(|point| point.observations.len()).sum(),
            depth_pixels,
            density: depth_pixels as f64 / all_pixels.max(1) as f64,
            scan_points: self.keyframes.values().filter_map(|k| k.scan.as_ref()).map(|scan| scan.len()).sum(),
            odometry_edges: edges(EdgeKind::Odometry),
            covisibility_edges: edges(EdgeKind::Covisibility),
            loop_edges: edges(EdgeKind::Loop),
            merge_edges: edges(EdgeKind::Merge),
            frames: self.frames.len(),
            // An empty `sum` would be −0.
            duration: agents.iter().fold(0.0, |sum, agent| sum + agent.duration),
            path_length: agents.iter().fold(0.0, |sum, agent| sum + agent.path_length),
            metric: self.is_metric(),
            file_bytes,
            agents,
            merge_provenance: self.merge_provenance.clone(),
        }
    }

    /// One agent in numbers.
    fn agent_summary(&self, id: AgentId, info: &AgentInfo) -> AgentSummary {
        let trajectory = self.trajectory_of(id);
        let own = self.keyframes.values().filter(|keyframe| keyframe.agent == id);
        let times = trajectory.first().zip(trajectory.last());
        let position = |index: usize| trajectory[index].world_from_camera.translation;
        AgentSummary {
            name: info.name.clone(),
            identity: info.identity,
            sensor: info.sensor.kind(),
            image_size: info.camera().map(|camera| [camera.width, camera.height]),
            keyframes: own.clone().count(),
            described: own.clone().filter(|keyframe| keyframe.features.is_some()).count(),
            frames: trajectory.len(),
            duration: times.map_or(0.0, |(first, last)| last.timestamp - first.timestamp),
            path_length: (1..trajectory.len())
                .fold(0.0, |sum, i| sum + (position(i) - position(i - 1)).norm()),
            metric: self.is_metric(),
            provenance: info.provenance.clone(),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let [agent] = &*self.agents {
            writeln!(f, "name         {}", agent.name)?;
            writeln!(f, "identity     {}", agent.named())?;
            writeln!(f, "{}", agent.seen_with())?;
        } else {
            writeln!(f, "agents       {}", self.agents.len())?;
        }
        writeln!(f, "keyframes    {}", self.keyframes)?;
        let has = |kind| self.agents.iter().any(|agent| agent.sensor == kind);
        if has(SensorKind::Lidar) {
            writeln!(f, "scans        {} points", self.scan_points)?;
        }
        if has(SensorKind::Camera) {
            let share = 100.0 * self.density;
            writeln!(f, "depth        {} pixels ({share:.1} % of the keyframes' pixels)", self.depth_pixels)?;
            writeln!(f, "sparse       {} points ({} observations)", self.points, self.observations)?;
        }
        writeln!(
            f,
            "edges        {} odometry, {} covisibility, {} loop, {} merge",
            self.odometry_edges, self.covisibility_edges, self.loop_edges, self.merge_edges
        )?;
        writeln!(f, "frames       {} in {:.2} s", self.frames, self.duration)?;
        writeln!(f, "path         {:.3} {}", self.path_length, unit(self.metric))?;
        if let Some(bytes) = self.file_bytes {
            write!(f, "file         {:.2} MB", bytes as f64 / 1e6)?;
            match self.keyframes {
                0 => writeln!(f)?,
                count => writeln!(f, " ({:.0} kB a keyframe)", bytes as f64 / 1e3 / count as f64)?,
            }
        }
        provenance(f, &self.merge_provenance)?;
        if let [agent] = &*self.agents {
            return provenance(f, &agent.provenance);
        }
        self.agents.iter().try_for_each(|agent| write!(f, "\n{agent}"))
    }
}

impl AgentSummary {
    /// Who it is, for people.
    fn named(&self) -> String {
        self.identity.map_or_else(|| "none".to_owned(), |identity| identity.to_string())
    }

    /// The sensor, and of a camera the size of its images, for people: a label and a text.
    fn seen_with(&self) -> String {
        match self.image_size {
            Some([width, height]) => format!("images       {width}×{height} pixels"),
            None => format!("sensor       {}", self.sensor),
        }
    }
}

impl fmt::Display for AgentSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "agent        {}", self.name)?;
        writeln!(f, "identity     {}", self.named())?;
        writeln!(f, "{}", self.seen_with())?;
        writeln!(f, "keyframes    {}", self.keyframes)?;
        writeln!(f, "frames       {} in {:.2} s", self.frames, self.duration)?;
        writeln!(f, "path         {:.3} {}", self.path_length, unit(self.metric))?;
        provenance(f, &self.provenance)
    }
}

/// What lengths are in, for people.
fn unit(metric: bool) -> &'static str {
    if metric { "m" } else { "map units" }
}

/// Writes a text of several lines beside each key.
fn provenance(f: &mut fmt::Formatter<'_>, entries: &BTreeMap<String, String>) -> fmt::Result {
    for (key, value) in entries {
        let mut lines = value.lines();
        writeln!(f, "{key:<12} {}", lines.next().unwrap_or_default())?;
        for line in lines {
            writeln!(f, "             {line}")?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::test_support::{sample_map, united};
    use crate::{FramePose, KeyframeId, Map};
    use geometry::{Se3, Sim3};
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn counts_add_up() {
        let summary = sample_map(5).summary(Some(2_000_000));
        assert_eq!((summary.keyframes, summary.frames, summary.points), (5, 25, 20));
        assert_eq!(summary.observations, 5 * (1 + 2 + 3));
        assert_eq!(
            [summary.odometry_edges, summary.covisibility_edges, summary.loop_edges, summary.merge_edges],
            [1, 1, 1, 1]
        );
        assert!((summary.duration - 24.0 / 30.0).abs() < 1e-6);
        let text = summary.to_string();
        assert!(text.contains("2.00 MB (400 kB a keyframe)"), "{text}");
        assert!(text.contains("\n             levels = 5\n"), "{text}");
    }

    #[test]
    fn the_path_is_measured_in_the_world() {
        let mut map: Map = sample_map(1);
        let keyframe = map.keyframes.values_mut().next().unwrap();
        keyframe.world_from_keyframe = Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), 2.0);
        let at = |x: f64| FramePose {
            timestamp: x,
            frame_index: x as u64,
            reference: KeyframeId(1),
            keyframe_from_frame: Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0)),
        };
        map.frames = [0.0, 1.0, 3.0].map(at).to_vec();
        assert!((map.summary(None).path_length - 6.0).abs() < 1e-12);
    }

    #[test]
    fn lengths_are_in_metres_where_the_first_agent_knows_them() {
        let mut map = united();
        let first = map.agents.values_mut().next().unwrap();
        first.set_metric();
        let text = map.summary(None).to_string();
        assert!(text.matches(" m\n").count() == 4 && !text.contains("map units"), "{text}");
    }

    #[test]
    fn agents_are_distinguished() {
        let summary = united().summary(None);
        let of_agents: Vec<_> = summary.agents.iter().map(|a| (&*a.name, a.keyframes, a.frames)).collect();
        assert_eq!(of_agents, [("sample", 3, 15), ("sample-2", 2, 10), ("other", 1, 5)]);
        assert_eq!((summary.keyframes, summary.frames), (6, 30));
        let sum = summary.agents.iter().map(|a| a.path_length).sum::<f64>();
        assert!((summary.path_length - sum).abs() < 1e-9);
        assert!(!summary.metric && summary.to_string().matches("map units").count() == 4);
        let text = summary.to_string();
        assert!(text.contains("agents       3\n") && text.contains("\nagent        other\n"), "{text}");
        assert!(text.contains("images       30×20 pixels\n"), "{text}");
    }

    #[test]
    fn an_empty_map_has_no_nan() {
        let empty = sample_map(0).summary(None);
        assert_eq!((empty.density, empty.duration, empty.path_length), (0.0, 0.0, 0.0));
    }
}
