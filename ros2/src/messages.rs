//! The messages, field by field as their definitions in ROS 2 have them; the order of fields is the encoding.
//!
//! The same since ROS 2 Foxy (`nav_msgs`, `sensor_msgs`, `geometry_msgs`, `std_msgs`, `builtin_interfaces` of
//! `common_interfaces`, and `tf2_msgs`); [`definitions`](crate::definitions) has their texts.

use serde::ser::SerializeTuple;
use serde::{Serialize, Serializer};

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Time {
    /// Whole seconds, rounded down.
    pub sec: i32,
    /// Nanoseconds after them, below 10⁹.
    pub nanosec: u32,
}

impl Time {
    /// A time in seconds, to the nanosecond. What is no number, or beyond what ROS 2 can say (1901 to 2038, as seconds since
    /// 1970), becomes the nearest that it can.
    pub fn of_seconds(seconds: f64) -> Self {
        let whole = seconds.floor();
        let (sec, nanosec) = (whole as i64, ((seconds - whole) * 1e9).round() as u32);
        // What is rounded up to a second is one.
        let (sec, nanosec) =
            if nanosec >= 1_000_000_000 { (sec.saturating_add(1), 0) } else { (sec, nanosec) };
        match i32::try_from(sec) {
            Ok(sec) => Self { sec, nanosec },
            Err(_) if sec < 0 => Self { sec: i32::MIN, nanosec: 0 },
            Err(_) => Self { sec: i32::MAX, nanosec: 999_999_999 },
        }
    }

    /// Nanoseconds, from 0 on, as the records of a bag have them.
    pub fn nanoseconds(self) -> u64 {
        u64::try_from(self.sec).map_or(0, |sec| sec * 1_000_000_000 + u64::from(self.nanosec))
    }
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Header {
    /// When what is said was so.
    pub stamp: Time,
    /// The frame in which it is said.
    pub frame_id: String,
}

/// `geometry_msgs/msg/Vector3`, and `Point`, which is encoded alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[expect(missing_docs, reason = "axes")]
pub struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "parts of a quaternion")]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/msg/Transform`, and `Pose`, which is encoded alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Transform {
    /// Where the child's origin is in the parent.
    pub translation: Vector3,
    /// How the child is turned in the parent.
    pub rotation: Quaternion,
}

/// `geometry_msgs/msg/TransformStamped`: maps points of the child's frame to that of the header.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TransformStamped {
    /// The parent, and when.
    pub header: Header,
    /// The child.
    pub child_frame_id: String,
    /// `parent_from_child`.
    pub transform: Transform,
}

/// `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TfMessage {
    /// In any order.
    pub transforms: Vec<TransformStamped>,
}

/// 6 × 6 covariances, row by row: of x, y, z and of turns about these axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance(pub [f64; 36]);

impl Covariance {
    /// What ROS 2 takes for "not known": zeros.
    pub const UNKNOWN: Self = Self([0.0; 36]);
}

impl Serialize for Covariance {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // An array, without a length before it; serde itself knows those up to 32.
        let mut array = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|value| array.serialize_element(value))?;
        array.end()
    }
}

/// `geometry_msgs/msg/PoseWithCovariance`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Transform,
    /// How sure it is.
    pub covariance: Covariance,
}

/// `geometry_msgs/msg/Twist`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Twist {
    /// Units of length a second.
    pub linear: Vector3,
    /// Radians a second, about the axes.
    pub angular: Vector3,
}

/// `geometry_msgs/msg/TwistWithCovariance`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TwistWithCovariance {
    /// The velocity.
    pub twist: Twist,
    /// How sure it is.
    pub covariance: Covariance,
}

/// `nav_msgs/msg/Odometry`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Odometry {
    /// The frame of the pose, and when.
    pub header: Header,
    /// The frame of the velocity, and whose pose it is.
    pub child_frame_id: String,
    /// The child's pose.
    pub pose: PoseWithCovariance,
    /// The child's velocity, in its own axes.
    pub twist: TwistWithCovariance,
}

/// `sensor_msgs/msg/PointField`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PointField {
    /// What it is called.
    pub name: String,
    /// Bytes from the beginning of a point.
    pub offset: u32,
    /// The type of its numbers, [`FLOAT32`](Self::FLOAT32).
    pub datatype: u8,
    /// How many numbers.
    pub count: u32,
}

impl PointField {
    /// `FLOAT32` of the definition.
    pub const FLOAT32: u8 = 7;
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PointCloud2 {
    /// The frame of the points, and when.
    pub header: Header,
    /// Rows; 1 where the points have no order.
    pub height: u32,
    /// Points in a row.
    pub width: u32,
    /// What a point has.
    pub fields: Vec<PointField>,
    /// The order of bytes in `data`.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of a row.
    pub row_step: u32,
    /// The points.
    #[serde(serialize_with = "as_bytes")]
    pub data: Vec<u8>,
    /// No point is invalid.
    pub is_dense: bool,
}

/// How well something is, as `diagnostic_msgs/msg/DiagnosticStatus` counts it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// As it should be.
    Ok = 0,
    /// Somebody should know.
    Warn = 1,
    /// It does not work.
    Error = 2,
}

impl Serialize for Level {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(*self as u8)
    }
}

/// `diagnostic_msgs/msg/KeyValue`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct KeyValue {
    /// What is said.
    pub key: String,
    /// It.
    pub value: String,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DiagnosticStatus {
    /// How well it is.
    pub level: Level,
    /// What it is of: the same for each message of it.
    pub name: String,
    /// For people.
    pub message: String,
    /// The device or robot.
    pub hardware_id: String,
    /// Numbers.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DiagnosticArray {
    /// When; the frame has no meaning.
    pub header: Header,
    /// What there is to say.
    pub status: Vec<DiagnosticStatus>,
}

/// Bytes at once, not one by one.
fn as_bytes<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_seconds_rounded_down_and_nanoseconds() {
        let time = |sec, nanosec| Time { sec, nanosec };
        assert_eq!(Time::of_seconds(0.0), time(0, 0));
        assert_eq!(Time::of_seconds(12.25), time(12, 250_000_000));
        assert_eq!(Time::of_seconds(-0.25), time(-1, 750_000_000));
        assert_eq!(Time::of_seconds(0.999_999_999_9), time(1, 0));
        let real = 1_305_031_102.175_304;
        let Time { sec, nanosec } = Time::of_seconds(real);
        assert_eq!(sec, 1_305_031_102);
        assert!((f64::from(nanosec) * 1e-9 - 0.175_304).abs() < 3e-7, "as near as the number itself is");
        // Of what there is no time for, the nearest.
        assert_eq!(Time::of_seconds(1e12).sec, i32::MAX);
        assert_eq!(Time::of_seconds(-1e12).sec, i32::MIN);
        assert_eq!(Time::of_seconds(f64::INFINITY).sec, i32::MAX);
        assert_eq!(Time::of_seconds(f64::NAN), time(0, 0));
        assert_eq!(Time::of_seconds(-3.0).nanoseconds(), 0);
        assert_eq!(Time::of_seconds(12.25).nanoseconds(), 12_250_000_000);
    }
}
