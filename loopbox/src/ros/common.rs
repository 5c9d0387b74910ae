//! The common maps of several agents, published to ROS 2: where their maps lie in them, where they are, and the points.
//!
//! The common frame is the map of the component's eldest agent, `ROOT/map`; it has his unit. Transforms of ROS have no scale, so
//! the map of another agent, in a unit of its own, lies where and as it should and not as large as it should; what is said
//! here in the common frame is as large.

use crate::lidar::merging::LidarMerging;
use geometry::Se3;
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Map, SensorKind};
use merge::common_map::Fused;
use ros2::cdr::encode;
use ros2::cloud::cloud;
use ros2::frames::{Axes, Names, transform};
use ros2::messages::{TfMessage, Time, TransformStamped, Twist};
use ros2::odometry::odometry;
use ros2::{COMMON_ODOMETRY_TOPIC, COMMON_POINTS_TOPIC, Outlet, TF_STATIC_TOPIC};
use serde::Serialize;
use std::time::{Duration, Instant};

/// Points of a component's cloud at the most: a megabyte.
const MAX_POINTS: usize = 1 << 16;
/// How often all is said again for those who come late.
const INTERVAL: Duration = Duration::from_secs(5);

/// A topic and a message.
type TopicMessage = (String, Vec<u8>);

/// Publishes the common maps.
pub struct Common {
    outlet: Box<dyn Outlet + Sync>,
    /// What was said last of cameras.
    of_cameras: Vec<TopicMessage>,
    /// The same of LiDARs.
    of_lidars: Vec<TopicMessage>,
    when: Instant,
}

/// Agents that hang together.
struct Together<'a> {
    /// Their maps in the world of the first.
    map: &'a Map,
    /// Where their own worlds lie in that, in their order.
    root_from_agent: Vec<Option<Se3>>,
}

impl<'a> Together<'a> {
    /// Of cameras.
    fn of(fused: &'a Fused) -> Self {
        let place = |agent| Some(fused.component.agents.get(agent)?.root_from_agent.rigid());
        Self { map: &fused.map, root_from_agent: fused.agents.iter().map(place).collect() }
    }
}

impl Common {
    /// One that publishes on `outlet`.
    pub fn new(outlet: impl Outlet + Sync + 'static) -> Self {
        let (of_cameras, of_lidars) = Default::default();
        Self { outlet: Box::new(outlet), of_cameras, of_lidars, when: Instant::now() }
    }

    /// Publishes what was merged of cameras.
    pub fn publish_cameras(&mut self, merged: &[Fused]) {
        self.of_cameras = messages(&merged.iter().map(Together::of).collect::<Vec<_>>());
        self.publish();
    }

    /// Publishes what was merged of LiDARs.
    pub fn publish_lidars(&mut self, merging: &LidarMerging) {
        let together = merging.groups.iter().map(|group| {
            let root_from_agent = group.root_from_map.iter().copied().map(Some).collect();
            Together { map: &group.map, root_from_agent }
        });
        self.of_lidars = messages(&together.collect::<Vec<_>>());
        self.publish();
    }

    /// Publishes it again, when it is time.
    pub fn tick(&mut self) {
        if self.when.elapsed() >= INTERVAL {
            self.publish();
        }
    }

    fn publish(&mut self) {
        self.when = Instant::now();
        for (topic, message) in self.of_cameras.iter().chain(&self.of_lidars) {
            self.outlet.publish(topic, message.clone());
        }
    }
}

/// What is published of several agents that hang together.
fn messages(all: &[Together]) -> Vec<TopicMessage> {
    let mut messages = Vec::new();
    let mut transforms = Vec::new();
    for together in all.iter().filter(|together| together.root_from_agent.len() > 1) {
        let (map, names) = (together.map, Names::of_map(together.map));
        let Some(root) = names.values().next() else { continue };
        transforms.extend(places(together, root, names.values()));
        for (agent, names) in &names {
            let Some(pose) = map.trajectory_of(*agent).pop() else { continue };
            let axes = Axes::of(&map.agents[agent].sensor);
            let (stamp, pose) = (Time::of_seconds(pose.timestamp), axes.pose(axes, &pose.world_from_camera));
            let message = odometry(&root.map(), &names.body(), stamp, &pose, Twist::default());
            add(&mut messages, names.topic(COMMON_ODOMETRY_TOPIC), &message);
        }
        let (points, axes) = (points(map), axes(map));
        let turned = points.iter().map(|point| (axes.body_from_own() * point.position, point.intensity));
        let stamp = Time::of_seconds(map.frames.last().map_or(0.0, |frame| frame.timestamp));
        add(
            &mut messages,
            root.topic(COMMON_POINTS_TOPIC),
            &cloud(&root.map(), stamp, turned, map.sensor() == Some(SensorKind::Camera)),
        );
    }
    if !transforms.is_empty() {
        add(&mut messages, TF_STATIC_TOPIC.into(), &TfMessage { transforms });
    }
    messages
}

/// The axes of a common world: those of its first agent's.
fn axes(map: &Map) -> Axes {
    map.agents.values().next().map_or(Axes::Body, |about| Axes::of(&about.sensor))
}

/// Where the maps of all but the root lie in the root's.
fn places<'a>(
    together: &Together,
    root: &Names,
    names: impl Iterator<Item = &'a Names>,
) -> Vec<TransformStamped> {
    let axes = axes(together.map);
    let place = |(root_from_agent, names): (&Option<Se3>, &Names)| {
        let root_from_agent: Se3 = axes.pose(axes, root_from_agent.as_ref()?);
        // It holds until another is said, whenever that is asked for.
        Some(transform(&root.map(), &names.map(), Time { sec: 0, nanosec: 0 }, &root_from_agent))
    };
    together.root_from_agent.iter().zip(names).skip(1).filter_map(place).collect()
}

/// An even sample of a map's points.
fn points(map: &Map) -> Vec<map::CloudPoint> {
    let count = map.cloud(DEFAULT_MAX_RELATIVE_VARIANCE).count();
    map.cloud(DEFAULT_MAX_RELATIVE_VARIANCE).step_by(count.div_ceil(MAX_POINTS).max(1)).collect()
}

fn add(messages: &mut Vec<TopicMessage>, topic: String, message: &impl Serialize) {
    // Nothing here is as long as what cannot be encoded.
    messages.extend(encode(message).ok().map(|bytes| (topic, bytes)));
}
