//! Scans as messages on the wire: what recordings hold, whatever file they lie in.
//!
//! [`MessageKind`] is which message it is, by the name of its schema; [`Encoding`] how its bytes are put together. `wire` reads
//! numbers off them, `point_cloud2`, `foxglove` and `livox` know a message each.

mod foxglove;
mod livox;
mod point_cloud2;
#[cfg(test)]
mod tests;
mod wire;

use crate::{Scan, ScanError, rings_of};

/// A message that holds a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageKind {
    /// ROS's `sensor_msgs/PointCloud2`, of 1 and 2.
    PointCloud2,
    /// `foxglove.PointCloud`.
    Foxglove,
    /// `CustomMsg` of Livox's drivers.
    Livox,
}

/// How a message's bytes are put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// ROS 1: one number after the other.
    Ros1,
    /// ROS 2: CDR, numbers at multiples of their size.
    Cdr,
    /// Protocol buffers.
    Protobuf,
}

impl MessageKind {
    /// The message of a schema, with or without ROS 2's `msg/`.
    pub fn of_schema(name: &str) -> Option<Self> {
        match name {
            "sensor_msgs/PointCloud2" | "sensor_msgs/msg/PointCloud2" => Some(Self::PointCloud2),
            "foxglove.PointCloud" => Some(Self::Foxglove),
            _ if name.contains("livox") && name.ends_with("/CustomMsg") => Some(Self::Livox),
            _ => None,
        }
    }

    /// Reads a message; `name` is for messages. Rings are derived where points come ring by ring and do not say theirs.
    ///
    /// # Errors
    /// When the bytes are not such a message, or the scan is of no use.
    pub fn read(self, encoding: Encoding, bytes: &[u8], name: &str) -> Result<Scan, ScanError> {
        let scan = match (self, encoding) {
            (Self::Foxglove, Encoding::Protobuf) => foxglove::read(bytes, name),
            (Self::Foxglove, _) | (_, Encoding::Protobuf) => {
                Err(ScanError::format(name, "the message is in an encoding that is not read for it"))
            }
            (Self::PointCloud2, _) => point_cloud2::read(encoding, bytes, name),
            (Self::Livox, _) => livox::read(encoding, bytes, name),
        };
        let mut scan = scan?;
        if scan.rings.is_empty() {
            scan.rings = rings_of(&scan.points);
        }
        scan.checked(name)
    }

    /// The stamp of a message without its points, seconds; `None` when it cannot be read.
    pub fn stamp(self, encoding: Encoding, bytes: &[u8]) -> Option<f64> {
        match (self, encoding) {
            (Self::Foxglove, Encoding::Protobuf) => foxglove::stamp(bytes),
            (Self::Foxglove, _) | (_, Encoding::Protobuf) => None,
            _ => wire::Reader::new(encoding, bytes)?.header(),
        }
    }
}

/// What is said of bytes that end early.
fn cut_off(name: &str) -> ScanError {
    ScanError::format(name, "the message ends early")
}
