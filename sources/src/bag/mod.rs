//! ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0), read record by record from any stream and written.
//!
//! Own code rather than the crate `rosbag`: that one maps the file into memory, trusts its index, and cannot
//! read a bag whose recorder was killed.

mod fields;
mod reader;
mod writer;

pub use reader::{BagReader, Connection, Content, Message};
pub use writer::{BagWriter, MessageType};

/// The first bytes of every bag.
pub const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

const MESSAGE: u8 = 0x02;
const BAG_HEADER: u8 = 0x03;
const INDEX_DATA: u8 = 0x04;
const CHUNK: u8 = 0x05;
const CHUNK_INFO: u8 = 0x06;
const CONNECTION: u8 = 0x07;

#[cfg(test)]
mod tests;
