//! The channels of a map file: those of the whole map, and those of each agent.

use super::color::{COLOR_SCHEMA, COLOR_TOPIC};
use super::scan::{SCAN_SCHEMA, SCAN_TOPIC};
use super::schema::{
    FEATURES_SCHEMA, GRAPH_SCHEMA, KEYFRAME_SCHEMA, color_descriptor_set, descriptor_set, scan_descriptor_set,
};
use super::{
    CALIBRATION_TOPIC, CAMERA_FRAME, CLOUD_TOPIC, FEATURES_TOPIC, GRAPH_TOPIC, IMAGE_TOPIC, KEYFRAME_TOPIC,
    LIDAR_FRAME, TRAJECTORY_TOPIC, TRANSFORMS_TOPIC,
};
use crate::agent::labels;
use crate::{AgentId, AgentInfo, SensorKind};
use foxglove::Encode;
use foxglove::messages::{CameraCalibration, CompressedImage, FrameTransforms, PointCloud, PosesInFrame};
use mcap::McapError;
use std::collections::BTreeMap;
use std::io::{self, Seek, Write};

/// The channel of each topic.
pub(super) struct Channels {
    pub keyframe: u16,
    pub features: u16,
    pub graph: u16,
    pub image: u16,
    pub transforms: u16,
    /// In a map with a LiDAR.
    pub scan: Option<u16>,
    /// Once a keyframe with colours was written: a map without any is as if there were none.
    color: Option<u16>,
    pub agents: BTreeMap<AgentId, AgentChannels>,
}

/// Where viewers find what is of one agent.
#[derive(Clone)]
pub(super) struct AgentChannels {
    pub cloud: u16,
    /// The channel of a camera's calibration.
    pub calibration: Option<u16>,
    pub trajectory: u16,
    /// The coordinate frame of its moving sensor.
    pub sensor_frame: String,
}

impl Channels {
    /// Adds all channels, in an order that is always the same.
    pub(super) fn register<W: Write + Seek>(
        mcap: &mut mcap::Writer<W>,
        agents: &BTreeMap<AgentId, AgentInfo>,
    ) -> Result<Self, McapError> {
        let own = descriptor_set();
        Ok(Self {
            keyframe: add_channel(mcap, KEYFRAME_TOPIC, KEYFRAME_SCHEMA, &own)?,
            features: add_channel(mcap, FEATURES_TOPIC, FEATURES_SCHEMA, &own)?,
            graph: add_channel(mcap, GRAPH_TOPIC, GRAPH_SCHEMA, &own)?,
            image: add_foxglove::<CompressedImage, W>(mcap, IMAGE_TOPIC)?,
            transforms: add_foxglove::<FrameTransforms, W>(mcap, TRANSFORMS_TOPIC)?,
            scan: agents
                .values()
                .any(|info| info.sensor.kind() == SensorKind::Lidar)
                .then(|| add_channel(mcap, SCAN_TOPIC, SCAN_SCHEMA, &scan_descriptor_set()))
                .transpose()?,
            color: None,
            agents: labels(agents)
                .into_iter()
                .map(|(id, label)| {
                    let kind = agents[&id].sensor.kind();
                    // One agent needs no name to be told apart.
                    let label = (agents.len() > 1).then_some(label);
                    AgentChannels::register(mcap, kind, label.as_deref()).map(|channels| (id, channels))
                })
                .collect::<Result<_, _>>()?,
        })
    }
}

impl Channels {
    /// The channel of colours, which is added with the first of them.
    pub(super) fn color<W: Write + Seek>(&mut self, mcap: &mut mcap::Writer<W>) -> Result<u16, McapError> {
        if let Some(channel) = self.color {
            return Ok(channel);
        }
        let channel = add_channel(mcap, COLOR_TOPIC, COLOR_SCHEMA, &color_descriptor_set())?;
        self.color = Some(channel);
        Ok(channel)
    }
}

impl AgentChannels {
    /// Adds the channels of an agent, under its label if it has one.
    fn register<W: Write + Seek>(
        mcap: &mut mcap::Writer<W>,
        kind: SensorKind,
        label: Option<&str>,
    ) -> Result<Self, McapError> {
        let frame = if kind == SensorKind::Lidar { LIDAR_FRAME } else { CAMERA_FRAME };
        let topic = |topic: &str| label.map_or(topic.to_owned(), |label| format!("/{label}{topic}"));
        Ok(Self {
            cloud: add_foxglove::<PointCloud, W>(mcap, &topic(CLOUD_TOPIC))?,
            calibration: (kind == SensorKind::Camera)
                .then(|| add_foxglove::<CameraCalibration, W>(mcap, &topic(CALIBRATION_TOPIC)))
                .transpose()?,
            trajectory: add_foxglove::<PosesInFrame, W>(mcap, &topic(TRAJECTORY_TOPIC))?,
            sensor_frame: label.map_or(frame.into(), |label| format!("{label}/{frame}")),
        })
    }
}

/// Adds a channel for a message of Foxglove's.
fn add_foxglove<T: Encode, W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
    topic: &str,
) -> Result<u16, McapError> {
    let schema = T::get_schema().ok_or_else(|| io::Error::other(format!("{topic} has no schema")))?;
    add_channel(mcap, topic, &schema.name, &schema.data)
}

/// Adds a channel of protobuf messages.
fn add_channel<W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
    topic: &str,
    schema: &str,
    descriptors: &[u8],
) -> Result<u16, McapError> {
    let schema = mcap.add_schema(schema, "protobuf", descriptors)?;
    mcap.add_channel(schema, topic, "protobuf", &BTreeMap::new())
}
