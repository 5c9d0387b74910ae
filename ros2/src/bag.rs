//! A map as a bag: an MCAP file with messages of ROS 2, as `ros2 bag record` writes them.

use crate::cdr::encode;
use crate::cloud::cloud;
use crate::definitions::{MessageType, ODOMETRY, POINT_CLOUD2, TF_MESSAGE};
use crate::frames::{Axes, Names, transform};
use crate::messages::{TfMessage, Time};
use crate::odometry::{odometry, velocity};
use crate::{ODOMETRY_TOPIC, POINTS_TOPIC, TF_TOPIC};
use geometry::Se3;
use map::{AgentId, CloudPoint, CloudSelection, Keyframe, Map, StampedPose};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Seek, Write};

/// The profile of MCAP files that hold messages of ROS 2.
const PROFILE: &str = "ros2";

/// What a bag holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Poses, each in a message of odometry and in one of transforms.
    pub poses: usize,
    /// Points of all clouds.
    pub points: usize,
    /// Clouds, one of each keyframe or one of all.
    pub clouds: usize,
}

/// Writes a map as a bag, message by message in order of time: the trajectory of each agent as transforms and odometry in
/// the frame of the map, that of its first agent, and the points that `selection` takes, each keyframe's at its time;
/// thinned to cubes they are one cloud, at the time of the last pose. `world` says how the axes of the map's world lie.
///
/// # Errors
/// When `out` takes no more.
pub fn write_bag(
    out: impl Write + Seek,
    map: &Map,
    world: Axes,
    selection: CloudSelection,
) -> io::Result<Counts> {
    let mut bag = Bag::begin(out, map, world).map_err(io_error)?;
    let mut counts = Counts::default();
    for event in bag.events(map, selection) {
        match event {
            Event::Pose { agent, pose, before } => {
                bag.pose(agent, &pose, before.as_ref())?;
                counts.poses += 1;
            }
            Event::Keyframe(keyframe) => {
                let (camera, shift) = (map.camera_of(keyframe), map.image_shift(keyframe));
                let bound = selection.max_relative_variance;
                let of_image = camera.zip(shift).map(|(camera, shift)| keyframe.cloud(camera, shift, bound));
                let pose = keyframe.world_from_keyframe;
                let points = of_image.into_iter().flatten().chain(keyframe.scan_cloud());
                let placed = points.map(|point| CloudPoint { position: pose * point.position, ..point });
                counts.points += bag.points(keyframe.agent, keyframe.timestamp, placed)?;
                counts.clouds += 1;
            }
            Event::Thinned(time, voxel) => {
                let points = map.thinned_cloud(selection.max_relative_variance, voxel);
                let agent = *map.agents.keys().next().unwrap_or(&AgentId::default());
                counts.points += bag.points(agent, time, points)?;
                counts.clouds += 1;
            }
        }
    }
    bag.mcap.finish().map_err(io_error)?;
    Ok(counts)
}

/// What is written at a time.
enum Event<'a> {
    /// A pose of an agent, and the one before it.
    Pose { agent: AgentId, pose: StampedPose, before: Option<StampedPose> },
    /// The points of a keyframe.
    Keyframe(&'a Keyframe),
    /// Those of the whole map, thinned to cubes of such an edge.
    Thinned(f64, f64),
}

struct Bag<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    world: Axes,
    /// The frame of the map.
    frame: String,
    transforms: u16,
    agents: BTreeMap<AgentId, Channels>,
    /// Messages written of each channel.
    sequence: BTreeMap<u16, u32>,
}

/// What is of one agent.
struct Channels {
    names: Names,
    /// The axes of its sensor.
    axes: Axes,
    odometry: u16,
    points: u16,
}

impl<W: Write + Seek> Bag<W> {
    /// Begins a file with all channels.
    fn begin(out: W, map: &Map, world: Axes) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .compression(Some(mcap::Compression::Lz4))
            .profile(PROFILE)
            .library(concat!("loopbox ", env!("CARGO_PKG_VERSION")));
        let mut mcap = options.create(out)?;
        let names = Names::of_map(map);
        let frame = names.values().next().map(Names::map).unwrap_or_default();
        let transforms = add_channel(&mut mcap, TF_TOPIC, &TF_MESSAGE)?;
        let mut agents = BTreeMap::new();
        for (id, names) in names {
            let odometry = add_channel(&mut mcap, &names.topic(ODOMETRY_TOPIC), &ODOMETRY)?;
            let points = add_channel(&mut mcap, &names.topic(POINTS_TOPIC), &POINT_CLOUD2)?;
            let axes = Axes::of(&map.agents[&id].sensor);
            agents.insert(id, Channels { names, axes, odometry, points });
        }
        Ok(Self { mcap, world, frame, transforms, agents, sequence: BTreeMap::new() })
    }

    /// All that is to be written, in order of time.
    fn events<'a>(&self, map: &'a Map, selection: CloudSelection) -> Vec<Event<'a>> {
        let mut events = Vec::new();
        for agent in self.agents.keys() {
            let mut before = None;
            for pose in map.trajectory_of(*agent) {
                events.push((pose.timestamp, Event::Pose { agent: *agent, pose, before }));
                before = Some(pose);
            }
        }
        match selection.voxel {
            None => {
                let of_keyframe = |keyframe: &'a Keyframe| (keyframe.timestamp, Event::Keyframe(keyframe));
                events.extend(map.keyframes.values().map(of_keyframe));
            }
            Some(voxel) => {
                let last = events.iter().map(|(time, _)| *time).fold(f64::NEG_INFINITY, f64::max);
                let time = if last.is_finite() { last } else { 0.0 };
                events.push((time, Event::Thinned(time, voxel)));
            }
        }
        // Of one time, poses first: they say where the points are.
        events.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        events.into_iter().map(|(_, event)| event).collect()
    }

    fn pose(&mut self, agent: AgentId, pose: &StampedPose, before: Option<&StampedPose>) -> io::Result<()> {
        let stamp = Time::of_seconds(pose.timestamp);
        let Channels { names, axes, odometry: channel, .. } = &self.agents[&agent];
        let of_body = |pose: &Se3| self.world.pose(*axes, pose);
        let map_from_body = of_body(&pose.world_from_camera);
        let moved = before.map(|before| {
            let before_from_now = of_body(&before.world_from_camera).inverse() * map_from_body;
            velocity(&before_from_now, pose.timestamp - before.timestamp)
        });
        let twist = moved.unwrap_or_default();
        let moving = transform(&self.frame, &names.body(), stamp, &map_from_body);
        let transforms = TfMessage { transforms: names.fixed(stamp).into_iter().chain([moving]).collect() };
        let odometry = odometry(&self.frame, &names.body(), stamp, &map_from_body, twist);
        let channel = *channel;
        self.message(self.transforms, stamp, &transforms)?;
        self.message(channel, stamp, &odometry)
    }

    /// Writes points in the world as a cloud; gives how many.
    fn points(
        &mut self,
        agent: AgentId,
        time: f64,
        points: impl Iterator<Item = CloudPoint>,
    ) -> io::Result<usize> {
        let turned = self.world.body_from_own();
        let points = points.map(|point| (turned * point.position, point.intensity));
        let Channels { names, points: channel, .. } = &self.agents[&agent];
        let message = cloud(&self.frame, Time::of_seconds(time), points, names.is_camera);
        let (channel, stamp, count) = (*channel, message.header.stamp, message.width as usize);
        self.message(channel, stamp, &message)?;
        Ok(count)
    }

    fn message(&mut self, channel_id: u16, stamp: Time, message: &impl Serialize) -> io::Result<()> {
        let bytes = encode(message).map_err(io::Error::other)?;
        let sequence = self.sequence.entry(channel_id).or_default();
        let log_time = stamp.nanoseconds();
        let header = MessageHeader { channel_id, sequence: *sequence, log_time, publish_time: log_time };
        *sequence += 1;
        self.mcap.write_to_known_channel(&header, &bytes).map_err(io_error)
    }
}

fn add_channel<W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
    topic: &str,
    kind: &MessageType,
) -> Result<u16, McapError> {
    let schema = mcap.add_schema(kind.name, "ros2msg", kind.definition().as_bytes())?;
    mcap.add_channel(schema, topic, "cdr", &BTreeMap::new())
}

/// The system's error inside of an error of the MCAP writer.
fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Sim3};
    use map::{AgentInfo, FramePose, KeyframeId, SemiDense};
    use mcap::MessageStream;
    use nalgebra::{SVector, Vector6};
    use std::io::Cursor;
    use std::sync::Arc;

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };

    /// Three keyframes a second apart, with two frames each, the later ones first known.
    fn map() -> Map {
        let mut map = Map::of(AgentInfo::new("the yard", CAMERA));
        for i in 0..3u32 {
            let id = KeyframeId(i);
            let pose = Sim3::exp(&SVector::<f64, 7>::from_fn(|k, _| 0.1 * (f64::from(i) + 1.0) * k as f64));
            let image = Arc::new(GrayImage::from_vec(4, 3, (0..12).map(|v| 20 * v as u8).collect()).unwrap());
            let mut keyframe = Keyframe::of_image(id, f64::from(i) + 5.0, u64::from(2 * i), pose, image);
            let depth = SemiDense {
                pixel: vec![0, 5, 11].into(),
                inverse_depth: vec![0.5, 1.0, 2.0].into(),
                variance: vec![1e-6, 1e-6, 1.0].into(),
            };
            keyframe.semi_dense = depth.into();
            map.keyframes.insert(id, keyframe);
            map.frames.extend((0..2).map(|k| FramePose {
                timestamp: f64::from(i) + 5.0 + 0.5 * f64::from(k),
                frame_index: u64::from(2 * i + k),
                reference: id,
                keyframe_from_frame: Se3::exp(&(Vector6::from_element(0.1) * f64::from(k))),
            }));
        }
        map
    }

    /// Another recording of the same.
    fn taken_later(mut map: Map, seconds: f64) -> Map {
        map.keyframes.values_mut().for_each(|keyframe| keyframe.timestamp += seconds);
        map.frames.iter_mut().for_each(|frame| frame.timestamp += seconds);
        map
    }

    /// Topic, seconds and bytes of all messages.
    fn written(map: &Map, world: Axes, selection: CloudSelection) -> (Counts, Vec<(String, f64, Vec<u8>)>) {
        let mut file = Cursor::new(Vec::new());
        let counts = write_bag(&mut file, map, world, selection).unwrap();
        let bytes = file.into_inner();
        let messages = MessageStream::new(&bytes).unwrap().map(|message| {
            let message = message.unwrap();
            assert_eq!(message.channel.message_encoding, "cdr");
            assert_eq!(message.channel.schema.as_ref().unwrap().encoding, "ros2msg");
            (message.channel.topic.clone(), message.log_time as f64 / 1e9, message.data.to_vec())
        });
        let messages = messages.collect();
        (counts, messages)
    }

    /// The last numbers of an encoded message.
    fn floats(bytes: &[u8], end: usize, count: usize) -> Vec<f32> {
        let from = bytes.len() - end - 4 * count;
        let numbers = bytes[from..bytes.len() - end].chunks_exact(4);
        numbers.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }

    #[test]
    fn a_bag_has_every_pose_and_every_keyframes_points_in_order_of_time() {
        let map = map();
        let (counts, messages) = written(&map, Axes::Optical, 0.01.into());
        assert_eq!(counts, Counts { poses: 6, points: 6, clouds: 3 });
        let of = |topic: &str| {
            let own = messages.iter().filter(|(own, ..)| own == topic);
            own.map(|(_, time, _)| *time).collect::<Vec<_>>()
        };
        let times = [5.0, 5.5, 6.0, 6.5, 7.0, 7.5];
        assert_eq!(of("/tf"), times);
        assert_eq!(of("/the_yard/odometry"), times);
        assert_eq!(of("/the_yard/points"), [5.0, 6.0, 7.0]);
        assert!(messages.is_sorted_by(|(_, a, _), (_, b, _)| a <= b));
        // The points lie where the map has them, turned to x forward, y left, z up.
        let clouds = messages.iter().filter(|(topic, ..)| topic == "/the_yard/points");
        let found: Vec<f32> = clouds.flat_map(|(.., bytes)| floats(bytes, 1, 8)).collect();
        let expected = map.cloud(0.01).flat_map(|point| {
            let [x, y, z]: [f64; 3] = point.position.into();
            [z, -x, -y, f64::from(point.intensity)].map(|value| value as f32)
        });
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}");
    }

    #[test]
    fn a_thinned_map_is_one_cloud_at_the_end() {
        let selection = CloudSelection { voxel: Some(100.0), ..CloudSelection::default() };
        let (counts, messages) = written(&map(), Axes::Body, selection);
        assert_eq!((counts.poses, counts.clouds), (6, 1));
        let (topic, time, _) = messages.last().unwrap();
        assert_eq!((topic.as_str(), *time), ("/the_yard/points", 7.5));
    }

    #[test]
    fn agents_of_one_map_have_topics_of_their_own() {
        let united = Map::unite(vec![map(), taken_later(map(), 100.0)]).unwrap();
        let (counts, messages) = written(&united, Axes::Optical, 0.01.into());
        assert_eq!(counts, Counts { poses: 12, points: 12, clouds: 6 });
        for topic in ["/the_yard/odometry", "/the_yard_2/odometry"] {
            assert_eq!(messages.iter().filter(|(own, ..)| own == topic).count(), 6, "{topic}");
        }
        let has = |text: &[u8], bytes: &[u8]| bytes.windows(text.len()).any(|window| window == text);
        let second = messages.iter().find(|(topic, ..)| topic == "/the_yard_2/odometry").unwrap();
        // In the frame of the first, whose world the common one is.
        assert!(has(b"the_yard/map\0", &second.2) && has(b"the_yard_2/camera\0", &second.2));
    }
}
