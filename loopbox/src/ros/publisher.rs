//! What is published of a run: messages made of what is pending.

use super::following::{Depth, Pending, Tracked};
use super::health::Health;
use geometry::{Se3, Sim3};
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Keyframe, KeyframeId, SemiDense, Shared};
use nalgebra::Vector3;
use ros2::cdr::encode;
use ros2::cloud::cloud;
use ros2::frames::{Axes, Names, transform};
use ros2::messages::{TfMessage, Time};
use ros2::odometry::{Odometer, Place, odometry, rotated};
use ros2::{DIAGNOSTICS_TOPIC, MAP_POINTS_TOPIC, ODOMETRY_TOPIC, Outlet, POINTS_TOPIC, TF_TOPIC};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// The axes of a world that begins with a camera.
const WORLD: Axes = Axes::Optical;
/// Points of a keyframe's cloud at the most: a quarter of a megabyte.
const KEYFRAME_POINTS: usize = 1 << 14;
/// Points of the map's cloud at the most, a megabyte, and of each keyframe those that are kept for it.
const MAP_POINTS: usize = 1 << 16;
const KEPT_POINTS: usize = 1 << 11;
/// The map's cloud is published this often while it changes, and this often for those who come late.
const CHANGED_INTERVAL: Duration = Duration::from_secs(2);
const SAME_INTERVAL: Duration = Duration::from_secs(10);
/// How the tracking goes is published when it changes, and this often.
const HEALTH_INTERVAL: Duration = Duration::from_secs(1);

/// What was published.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// Poses, each as odometry and as transforms.
    pub poses: u64,
    /// Poses that were not, as more waited than may.
    pub dropped: u64,
    /// Clouds of keyframes.
    pub clouds: u64,
    /// Clouds of the whole map.
    pub map_clouds: u64,
}

/// Publishes what is pending as messages.
#[derive(Default)]
pub(super) struct RunPublisher {
    names: Option<Names>,
    odometer: Odometer,
    keyframes: BTreeMap<KeyframeId, PublishedKeyframe>,
    world: usize,
    /// The time of the newest pose, seconds.
    time: f64,
    is_changed: bool,
    map_published: Option<Instant>,
    health_published: Option<(Instant, Health)>,
    published: Published,
}

/// A keyframe that was published, or is about to be.
#[derive(Default)]
struct PublishedKeyframe {
    world_from_keyframe: Option<Sim3>,
    /// The depth that was published of it.
    published_depth: Option<Shared<SemiDense>>,
    /// An even sample of its points, in its frame and unit, with their intensities.
    sample: Vec<(Vector3<f32>, u8)>,
}

impl RunPublisher {
    /// What was published so far.
    pub fn published(&self) -> Published {
        self.published
    }

    /// Publishes what is pending.
    pub fn publish(&mut self, mut pending: Pending, outlet: &mut dyn Outlet) {
        if let Some(about) = &pending.about {
            self.names = Some(Names::of(&about.name, &about.sensor));
        }
        let Some(names) = self.names.clone() else { return };
        self.published.dropped += pending.dropped;
        for tracked in &pending.poses {
            self.publish_pose(&names, tracked, outlet);
        }
        if let Some(health) = pending.health.take() {
            self.publish_health(&names, health, outlet);
        }
        if pending.anew {
            if pending.world != self.world {
                self.keyframes.clear();
            }
            // Those that are left are published again.
            self.keyframes.retain(|id, _| pending.moved.contains_key(id));
        }
        self.world = pending.world;
        self.is_changed |= pending.anew || !pending.moved.is_empty() || !pending.depths.is_empty();
        for (id, pose) in &pending.moved {
            self.keyframes.entry(*id).or_default().world_from_keyframe = Some(*pose);
        }
        for (id, depth) in std::mem::take(&mut pending.depths) {
            self.publish_points(&names, id, depth, outlet);
        }
        let interval = if self.is_changed { CHANGED_INTERVAL } else { SAME_INTERVAL };
        if pending.ended
            || self.map_published.is_none_or(|published_depth| published_depth.elapsed() >= interval)
        {
            self.publish_map(&names, outlet);
        }
    }

    /// Publishes where a frame is.
    fn publish_pose(&mut self, names: &Names, tracked: &Tracked, outlet: &mut dyn Outlet) {
        let body = |pose: &Se3| WORLD.pose(Axes::Optical, pose);
        let turned = Axes::Optical.body_from_own();
        let covariance = tracked.covariance.map(|covariance| rotated(&covariance, &turned));
        let place = Place { map_from_body: body(&tracked.world_from_camera), covariance };
        let before = tracked.world_from_before.as_ref().map(body);
        let reading = self.odometer.advance(tracked.timestamp, &place, before.as_ref());
        let stamp = Time::of_seconds(tracked.timestamp);
        let (map, odom, child) = (names.map_of(tracked.world), names.odom(), names.body());
        let corrected = transform(&map, &odom, stamp, &reading.map_from_odom);
        let moving = transform(&odom, &child, stamp, &reading.odom_from_body);
        let transforms = [corrected, moving].into_iter().chain(names.fixed(stamp)).collect();
        publish(outlet, TF_TOPIC, &TfMessage { transforms });
        let message = odometry(&odom, &child, stamp, &reading.odom_from_body, reading.twist)
            .known_to(&reading.certainty);
        publish(outlet, &names.topic(ODOMETRY_TOPIC), &message);
        self.time = tracked.timestamp;
        self.published.poses += 1;
    }

    /// Publishes how the tracking goes, where it goes otherwise than before, or that was said some time ago.
    fn publish_health(&mut self, names: &Names, health: Health, outlet: &mut dyn Outlet) {
        let is_said =
            |(when, before): &(Instant, Health)| when.elapsed() < HEALTH_INTERVAL && !health.differs(before);
        if !self.health_published.as_ref().is_some_and(is_said) {
            publish(outlet, DIAGNOSTICS_TOPIC, &health.diagnostics(&names.agent));
            self.health_published = Some((Instant::now(), health));
        }
    }

    /// Publishes the points of a keyframe whose depth is new.
    fn publish_points(&mut self, names: &Names, id: KeyframeId, depth: Depth, outlet: &mut dyn Outlet) {
        let Depth { timestamp, image, semi_dense, camera, shift } = depth;
        let known = self.keyframes.entry(id).or_default();
        let Some(pose) = known.world_from_keyframe else { return };
        if known.published_depth.as_ref() == Some(&semi_dense) {
            return;
        }
        let mut keyframe = Keyframe::of_image(id, timestamp, 0, pose, image);
        keyframe.semi_dense = semi_dense;
        let points = keyframe.cloud(&camera, shift, DEFAULT_MAX_RELATIVE_VARIANCE);
        let points: Vec<_> = points.map(|point| (point.position.cast::<f32>(), point.intensity)).collect();
        known.sample = evenly(&points, KEPT_POINTS).copied().collect();
        known.published_depth = Some(keyframe.semi_dense);
        if points.is_empty() {
            return;
        }
        let placed = evenly(&points, KEYFRAME_POINTS).map(|point| in_map(&pose, point));
        let message = cloud(&names.map_of(self.world), Time::of_seconds(timestamp), placed, true);
        publish(outlet, &names.topic(POINTS_TOPIC), &message);
        self.published.clouds += 1;
    }

    /// Publishes the points of all keyframes.
    fn publish_map(&mut self, names: &Names, outlet: &mut dyn Outlet) {
        let count: usize = self.keyframes.values().map(|known| known.sample.len()).sum();
        if count == 0 {
            return;
        }
        let step = count.div_ceil(MAP_POINTS);
        let of_keyframe = |known: &PublishedKeyframe| {
            let pose = known.world_from_keyframe?;
            Some(known.sample.iter().step_by(step).map(move |point| in_map(&pose, point)).collect::<Vec<_>>())
        };
        let points: Vec<_> = self.keyframes.values().filter_map(of_keyframe).flatten().collect();
        let message = cloud(&names.map_of(self.world), Time::of_seconds(self.time), points.into_iter(), true);
        publish(outlet, &names.topic(MAP_POINTS_TOPIC), &message);
        (self.is_changed, self.map_published) = (false, Some(Instant::now()));
        self.published.map_clouds += 1;
    }
}

/// Every so manieth of a list, so that there are no more than `count`.
fn evenly<T>(list: &[T], count: usize) -> impl Iterator<Item = &T> {
    list.iter().step_by(list.len().div_ceil(count).max(1))
}

/// A point of a keyframe in the frame of the map as ROS has it.
fn in_map(world_from_keyframe: &Sim3, (position, intensity): &(Vector3<f32>, u8)) -> (Vector3<f64>, u8) {
    (WORLD.body_from_own() * (*world_from_keyframe * position.cast::<f64>()), *intensity)
}

fn publish(outlet: &mut dyn Outlet, topic: &str, message: &impl Serialize) {
    // Nothing here is as long as what cannot be encoded.
    if let Ok(bytes) = encode(message) {
        outlet.publish(topic, bytes);
    }
}
