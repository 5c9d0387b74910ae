//! Poses, points and frames of maps as ROS 2 has them.
//!
//! [`messages`] are the messages, [`cdr`] their bytes, [`definitions`] their types; [`frames`] says how loopbox's axes become
//! those of ROS, [`mod@cloud`] and [`mod@odometry`] make messages of points and poses, [`bag`] writes a map as an MCAP file.
//! `zenoh` (a feature) publishes as `zenoh-bridge-ros2dds` does. Everything but that and the bag's stream is functions of
//! values.

pub mod bag;
pub mod cdr;
pub mod cloud;
pub mod definitions;
pub mod frames;
pub mod messages;
pub mod odometry;
#[cfg(feature = "zenoh")]
pub mod zenoh;

/// The topic of all transforms, `tf2_msgs/msg/TFMessage`.
pub const TF_TOPIC: &str = "/tf";
/// Of an agent: its poses, `nav_msgs/msg/Odometry`.
pub const ODOMETRY_TOPIC: &str = "odometry";
/// Of an agent: the points of its keyframes, `sensor_msgs/msg/PointCloud2`, in the frame of the map.
pub const POINTS_TOPIC: &str = "points";
/// Of an agent that runs: an even sample of the points of all of its map, as it is known now.
pub const MAP_POINTS_TOPIC: &str = "map_points";

/// The topic on which programs say how they are, `diagnostic_msgs/msg/DiagnosticArray`.
pub const DIAGNOSTICS_TOPIC: &str = "/diagnostics";

/// The topic of transforms that hold until others are said, `tf2_msgs/msg/TFMessage`.
pub const TF_STATIC_TOPIC: &str = "/tf_static";
/// Of an agent: its newest pose in the common map.
pub const COMMON_ODOMETRY_TOPIC: &str = "common_odometry";
/// Of the agent whose map the common one is: an even sample of the points of all.
pub const COMMON_POINTS_TOPIC: &str = "common_points";

/// Somebody who publishes messages.
pub trait Outlet: Send {
    /// Publishes the bytes of a message (see [`cdr::encode`]) on a topic, such as `/yard/odometry`. Whoever publishes waits
    /// for nobody: who does not keep up misses messages.
    fn publish(&mut self, topic: &str, message: Vec<u8>);
}
