//! Coordinate frames: loopbox's own, which are a camera's or a LiDAR's, as ROS has them (REP 103 and 105).
//!
//! A camera's axes in loopbox are x right, y down, z forward; ROS calls such a frame *optical* and has bodies, and maps,
//! with x forward, y left, z up. So an agent `NAME` has these frames:
//!
//! | frame | is |
//! |---|---|
//! | `NAME/map` | the world of the map: the first keyframe's body frame, so that x is where it looked; corrected by loops |
//! | `NAME/odom` | the same at the start, and never corrected: the agent moves steadily in it, and drifts (runs only) |
//! | `NAME/camera` | the camera, x forward, y left, z up |
//! | `NAME/camera_optical` | the camera, x right, y down, z forward |
//! | `NAME/lidar` | a LiDAR, x forward, y left, z up as its scans are |

use crate::messages::{Header, Quaternion, Time, Transform, TransformStamped, Vector3};
use geometry::Se3;
use map::{AgentId, Map, Sensor, SensorKind};
use nalgebra::UnitQuaternion;
use std::collections::{BTreeMap, BTreeSet};

/// What an agent is called where its name has nothing that ROS could use.
const DEFAULT_NAME: &str = "agent";

/// How the axes of a frame lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// x right, y down, z forward: a camera's, and those of a world that begins with one.
    Optical,
    /// x forward, y left, z up.
    Body,
    /// x right, y up, z backward: as in computer graphics.
    Graphics,
}

impl Axes {
    /// Those of an agent's sensor, and of the world of its map as it was made.
    pub fn of(sensor: &Sensor) -> Self {
        match sensor.kind() {
            SensorKind::Camera => Self::Optical,
            SensorKind::Lidar => Self::Body,
        }
    }

    /// The turn that maps points of these axes to those of a body.
    pub fn body_from_own(self) -> UnitQuaternion<f64> {
        let numbers = match self {
            Self::Optical => [-0.5, 0.5, -0.5, 0.5],
            Self::Body => [0.0, 0.0, 0.0, 1.0],
            Self::Graphics => [0.5, -0.5, -0.5, 0.5],
        };
        Se3::from_tum([0.0, 0.0, 0.0, numbers[0], numbers[1], numbers[2], numbers[3]]).rotation
    }

    /// A pose in a world of these axes of a sensor with axes `sensor`, both as bodies: `map_from_body`.
    pub fn pose(self, sensor: Self, world_from_sensor: &Se3) -> Se3 {
        let turned = self.body_from_own();
        let rotation = turned * world_from_sensor.rotation * sensor.body_from_own().inverse();
        Se3::new(rotation, turned * world_from_sensor.translation)
    }
}

/// The frames and topics of an agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// What ROS knows the agent by: letters, digits and `_`, beginning with a letter.
    pub agent: String,
    /// Whether its sensor is a camera.
    pub is_camera: bool,
}

impl Names {
    /// Those of an agent of that name, if no other is called alike.
    pub fn of(name: &str, sensor: &Sensor) -> Self {
        Self { agent: sanitised(name), is_camera: sensor.kind() == SensorKind::Camera }
    }

    /// Those of all agents of a map, told apart where they are called alike.
    pub fn of_map(map: &Map) -> BTreeMap<AgentId, Self> {
        let mut taken = BTreeSet::new();
        let names = map.agents.iter().map(|(id, info)| {
            let own = Self::of(&info.name, &info.sensor);
            let others = (2..).map(|number| format!("{}_{number}", own.agent));
            let free = std::iter::once(own.agent.clone()).chain(others).find(|name| !taken.contains(name));
            let agent = free.unwrap_or_default();
            taken.insert(agent.clone());
            (*id, Self { agent, ..own })
        });
        names.collect()
    }

    /// The frame of the world of the agent's map.
    pub fn map(&self) -> String {
        format!("{}/map", self.agent)
    }

    /// That of another world of the same run, by its number: of the first, 0, it is [`map`](Self::map), of those that a run
    /// began after it was lost `map_2` and so on.
    pub fn map_of(&self, world: usize) -> String {
        if world == 0 { self.map() } else { format!("{}_{}", self.map(), world + 1) }
    }

    /// The frame that is never corrected.
    pub fn odom(&self) -> String {
        format!("{}/odom", self.agent)
    }

    /// The frame of the sensor as a body.
    pub fn body(&self) -> String {
        format!("{}/{}", self.agent, if self.is_camera { "camera" } else { "lidar" })
    }

    /// The frame of a camera's images.
    pub fn optical(&self) -> Option<String> {
        self.is_camera.then(|| format!("{}/camera_optical", self.agent))
    }

    /// A topic of the agent.
    pub fn topic(&self, topic: &str) -> String {
        format!("/{}/{topic}", self.agent)
    }

    /// What lies fast to the sensor's body, at a time.
    pub fn fixed(&self, stamp: Time) -> Option<TransformStamped> {
        let rotation = Axes::Optical.body_from_own();
        let body_from_optical = Se3::new(rotation, nalgebra::Vector3::zeros());
        Some(transform(&self.body(), &self.optical()?, stamp, &body_from_optical))
    }
}

/// A name as ROS takes it (names of topics, design article "Topic and Service name mapping to DDS").
fn sanitised(name: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = name.chars().map(safe).collect();
    // ROS takes no two `_` in a row, and none at the ends leaves nothing hidden.
    let parts: Vec<&str> = name.split('_').filter(|part| !part.is_empty()).collect();
    match parts.join("_") {
        name if name.is_empty() => DEFAULT_NAME.into(),
        name if name.starts_with(|c: char| c.is_ascii_digit()) => format!("{DEFAULT_NAME}_{name}"),
        name => name,
    }
}

/// A transform between frames, `parent_from_child`, at a time.
pub fn transform(parent: &str, child: &str, stamp: Time, parent_from_child: &Se3) -> TransformStamped {
    TransformStamped {
        header: Header { stamp, frame_id: parent.into() },
        child_frame_id: child.into(),
        transform: pose(parent_from_child),
    }
}

/// A pose's numbers.
pub fn pose(pose: &Se3) -> Transform {
    let [tx, ty, tz, x, y, z, w] = pose.to_tum();
    Transform { translation: Vector3 { x: tx, y: ty, z: tz }, rotation: Quaternion { x, y, z, w } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pinhole;
    use map::AgentInfo;
    use nalgebra::{Vector3, Vector6};

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };

    #[test]
    fn forward_is_x_left_is_y_and_up_is_z() {
        for (axes, forward, left, up) in [
            (Axes::Optical, Vector3::z(), -Vector3::x(), -Vector3::y()),
            (Axes::Body, Vector3::x(), Vector3::y(), Vector3::z()),
            (Axes::Graphics, -Vector3::z(), -Vector3::x(), Vector3::y()),
        ] {
            let turned = [forward, left, up].map(|axis| axes.body_from_own() * axis);
            for (found, expected) in turned.iter().zip([Vector3::x(), Vector3::y(), Vector3::z()]) {
                assert!((found - expected).norm() < 1e-12, "{axes:?}");
            }
        }
    }

    #[test]
    fn a_pose_of_a_body_maps_its_points_to_the_same_place_of_the_map() {
        let world_from_camera = Se3::exp(&Vector6::new(0.3, -1.0, 2.0, 0.5, -0.2, 0.9));
        let point = Vector3::new(0.4, 0.1, 3.0);
        let rotated_by = Axes::Optical.body_from_own();
        for world in [Axes::Optical, Axes::Body, Axes::Graphics] {
            let map_from_body = world.pose(Axes::Optical, &world_from_camera);
            let of_body = map_from_body * (rotated_by * point);
            let expected = world.body_from_own() * (world_from_camera * point);
            assert!((of_body - expected).norm() < 1e-12, "{world:?}");
        }
    }

    #[test]
    fn names_are_those_that_ros_takes_and_unique() {
        let names = ["yard", "parking a", "7 scenes", "früh__2", "..", "yard", "parking-a"];
        let mut map = Map::new(CAMERA);
        map.agents = names.iter().zip(0..).map(|(n, i)| (AgentId(i), AgentInfo::new(*n, CAMERA))).collect();
        let found: Vec<String> = Names::of_map(&map).into_values().map(|names| names.agent).collect();
        assert_eq!(
            found,
            ["yard", "parking_a", "agent_7_scenes", "fr_h_2", "agent", "yard_2", "parking_a_2"]
        );
        let lidar = Names::of("rover", &Sensor::Lidar);
        assert_eq!((lidar.body(), lidar.optical()), ("rover/lidar".into(), None));
        assert_eq!(lidar.topic("points"), "/rover/points");
    }
}
