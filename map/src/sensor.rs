//! The sensors of agents, and which maps a function accepts.

use crate::{Map, MapError};
use geometry::Pinhole;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The sensor of an agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sensor {
    /// A camera: the pinhole camera to which its keyframes' images were undistorted. Its map's unit is unknown.
    Camera(Pinhole),
    /// A spinning LiDAR: its keyframes are scans, its map is in metres.
    Lidar,
}

/// A kind of sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorKind {
    /// A camera.
    Camera,
    /// A spinning LiDAR.
    Lidar,
}

impl Sensor {
    /// Which kind it is.
    pub fn kind(&self) -> SensorKind {
        match self {
            Self::Camera(_) => SensorKind::Camera,
            Self::Lidar => SensorKind::Lidar,
        }
    }
}

impl From<Pinhole> for Sensor {
    fn from(camera: Pinhole) -> Self {
        Self::Camera(camera)
    }
}

impl fmt::Display for SensorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Camera => "camera",
            Self::Lidar => "LiDAR",
        })
    }
}

impl Map {
    /// The kind of sensor that all of the map's agents have; `None` of different ones, or without agents.
    pub fn sensor(&self) -> Option<SensorKind> {
        let mut kinds = self.agents.values().map(|info| info.sensor.kind());
        let first = kinds.next()?;
        kinds.all(|kind| kind == first).then_some(first)
    }

    /// Whether all agents have cameras. Functions that work on images check this.
    ///
    /// # Errors
    /// [`MapError::Sensor`] names an agent that has none.
    pub fn of_cameras(&self) -> Result<(), MapError> {
        self.of_sensors(SensorKind::Camera)
    }

    /// Whether all agents have LiDARs: what functions ask that work on scans.
    ///
    /// # Errors
    /// [`MapError::Sensor`] names an agent that has none.
    pub fn of_lidars(&self) -> Result<(), MapError> {
        self.of_sensors(SensorKind::Lidar)
    }

    fn of_sensors(&self, wanted: SensorKind) -> Result<(), MapError> {
        match self.agents.values().find(|info| info.sensor.kind() != wanted) {
            None => Ok(()),
            Some(info) => {
                Err(MapError::Sensor { agent: info.name.clone(), found: info.sensor.kind(), wanted })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{lidar_map, sample_map};

    #[test]
    fn maps_of_the_other_sensor_are_refused_by_the_agents_name() {
        let (lidar, camera) = (lidar_map(1), sample_map(1));
        assert_eq!((lidar.sensor(), camera.sensor()), (Some(SensorKind::Lidar), Some(SensorKind::Camera)));
        assert!(lidar.of_lidars().is_ok() && camera.of_cameras().is_ok());
        let text = |refused: Result<(), MapError>| refused.unwrap_err().to_string();
        assert!(text(lidar.of_cameras()).contains("agent \"rover\" has a LiDAR"));
        assert!(text(camera.of_lidars()).contains("agent \"sample\" has a camera"));
        let both = Map::unite(vec![lidar, camera]).unwrap();
        assert_eq!(both.sensor(), None);
        assert!(both.of_cameras().is_err() && both.of_lidars().is_err());
    }
}
