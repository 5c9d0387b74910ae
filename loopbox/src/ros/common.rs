//! The common map of several agents, published to ROS 2: where their maps lie in it, where they are, and its points.
//!
//! The common frame is the map of the component's eldest agent, `ROOT/map`; it has his unit. Transforms of ROS have no scale, so
//! the map of another agent, in a unit of its own, lies where and as it should and not as large as it should; what is said
//! here in the common frame is as large.

use geometry::Se3;
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Map};
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

/// Publishes the common map.
pub struct Common {
    outlet: Box<dyn Outlet + Sync>,
    /// Topics and messages, as they were said last.
    said: Vec<(String, Vec<u8>)>,
    when: Instant,
}

impl Common {
    /// One that publishes on `outlet`.
    pub fn new(outlet: impl Outlet + Sync + 'static) -> Self {
        Self { outlet: Box::new(outlet), said: Vec::new(), when: Instant::now() }
    }

    /// Says what was merged.
    pub fn say(&mut self, merged: &[Fused]) {
        self.said = messages(merged);
        self.publish();
    }

    /// Says it again, when it is time.
    pub fn remind(&mut self) {
        if self.when.elapsed() >= INTERVAL {
            self.publish();
        }
    }

    fn publish(&mut self) {
        self.when = Instant::now();
        for (topic, message) in &self.said {
            self.outlet.publish(topic, message.clone());
        }
    }
}

/// What there is to say of components of several agents.
fn messages(merged: &[Fused]) -> Vec<(String, Vec<u8>)> {
    let mut messages = Vec::new();
    let mut transforms = Vec::new();
    for fused in merged.iter().filter(|fused| fused.agents.len() > 1) {
        let names = Names::of_map(&fused.map);
        let Some(root) = names.values().next() else { continue };
        transforms.extend(places(fused, root, names.values()));
        for (agent, names) in &names {
            let Some(pose) = fused.map.trajectory_of(*agent).pop() else { continue };
            let axes = Axes::of(&fused.map.agents[agent].sensor);
            let (stamp, pose) = (Time::of_seconds(pose.timestamp), axes.pose(axes, &pose.world_from_camera));
            let message = odometry(&root.map(), &names.body(), stamp, &pose, Twist::default());
            add(&mut messages, names.topic(COMMON_ODOMETRY_TOPIC), &message);
        }
        let (points, axes) = (points(&fused.map), axes(&fused.map));
        let turned = points.iter().map(|point| (axes.body_from_own() * point.position, point.intensity));
        let stamp = Time::of_seconds(fused.map.frames.last().map_or(0.0, |frame| frame.timestamp));
        add(&mut messages, root.topic(COMMON_POINTS_TOPIC), &cloud(&root.map(), stamp, turned, true));
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
fn places<'a>(fused: &Fused, root: &Names, names: impl Iterator<Item = &'a Names>) -> Vec<TransformStamped> {
    let axes = axes(&fused.map);
    let place = |(agent, names): (&map::AgentId, &Names)| {
        let root_from_agent = fused.component.agents.get(agent)?.root_from_agent.rigid();
        let root_from_agent: Se3 = axes.pose(axes, &root_from_agent);
        // It holds until another is said, whenever that is asked for.
        Some(transform(&root.map(), &names.map(), Time { sec: 0, nanosec: 0 }, &root_from_agent))
    };
    fused.agents.iter().zip(names).skip(1).filter_map(place).collect()
}

/// An even sample of a map's points.
fn points(map: &Map) -> Vec<map::CloudPoint> {
    let count = map.cloud(DEFAULT_MAX_RELATIVE_VARIANCE).count();
    map.cloud(DEFAULT_MAX_RELATIVE_VARIANCE).step_by(count.div_ceil(MAX_POINTS).max(1)).collect()
}

fn add(messages: &mut Vec<(String, Vec<u8>)>, topic: String, message: &impl Serialize) {
    // Nothing here is as long as what cannot be encoded.
    messages.extend(encode(message).ok().map(|bytes| (topic, bytes)));
}
