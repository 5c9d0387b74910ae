//! The map's file, `map.mcap`; described field by field in `book/src/reference/map-format.md`.
//!
//! Three messages of loopbox's own hold the exact data (`messages`), `foxglove.CompressedImage` the keyframe images,
//! one more message the LiDARs' scans (`scan`), and one the colours of images (`color`). Metadata records describe the agents (`about`). The other
//! Foxglove messages (`views`) repeat the exact data for viewers and are never read back.

mod about;
mod channels;
mod color;
mod convert;
mod messages;
pub mod parts;
mod picture;
mod reader;
mod records;
mod scan;
mod schema;
mod sink;
#[cfg(test)]
mod tests;
mod views;
mod writer;

pub(crate) use picture::{encode_color_png, encode_png};
pub use reader::{LoadedMap, is_map_file, load_map, load_map_swapped, sensors_of};
pub use writer::{MapWriter, save_map};

/// The version of the file format that is written.
pub const FORMAT_VERSION: u32 = 3;
/// The version before agents had identities, which is read too.
const NAMELESS_FORMAT: u32 = 2;
/// The version for one agent, which is read too.
const SINGLE_AGENT_FORMAT: u32 = 1;

/// The MCAP header's profile: what makes an MCAP file a map.
const PROFILE: &str = "loopbox.map";
/// The metadata record that holds the version.
const MAP_METADATA: &str = "loopbox.map";
/// What the name of an agent's metadata record begins with; its id follows.
const AGENT_METADATA: &str = "loopbox.agent.";
/// What the name of the record of an agent's provenance begins with; its id follows.
const PROVENANCE_METADATA: &str = "loopbox.provenance.";
/// The metadata record of the one agent's provenance in the format for one agent.
const SINGLE_AGENT_PROVENANCE_METADATA: &str = "loopbox.provenance";
/// The metadata record that says how maps were merged.
const MERGE_METADATA: &str = "loopbox.merge";

const KEYFRAME_TOPIC: &str = "/loopbox/keyframe";
const FEATURES_TOPIC: &str = "/loopbox/features";
const GRAPH_TOPIC: &str = "/loopbox/graph";
const IMAGE_TOPIC: &str = "/keyframes/image";
const CLOUD_TOPIC: &str = "/keyframes/cloud";
const CALIBRATION_TOPIC: &str = "/camera/calibration";
const TRANSFORMS_TOPIC: &str = "/tf";
const TRAJECTORY_TOPIC: &str = "/trajectory";

/// The moving camera's coordinate frame.
const CAMERA_FRAME: &str = "camera";
/// The moving LiDAR's coordinate frame.
const LIDAR_FRAME: &str = "lidar";
/// What the name of a keyframe's coordinate frame begins with; its id follows.
const KEYFRAME_FRAME: &str = "keyframe_";
