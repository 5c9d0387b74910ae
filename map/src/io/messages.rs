//! Loopbox's own messages: the exact data of a map, as protobuf structures of arrays.
//!
//! The field numbers are the format: they are described in `book/src/reference/map-format.md` and in the schema
//! that every file carries ([`super::schema`]).

/// Numbers in a similarity: `tx ty tz qx qy qz qw scale`.
pub(super) const SIM3_LEN: usize = 8;
/// Numbers in a rigid motion: `tx ty tz qx qy qz qw`.
pub(super) const SE3_LEN: usize = 7;
/// Numbers in an edge's information matrix, column by column.
pub(super) const INFORMATION_LEN: usize = 49;

/// A keyframe without its image.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct KeyframeMessage {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    #[prost(double, tag = "2")]
    pub timestamp: f64,
    #[prost(uint64, tag = "3")]
    pub frame_index: u64,
    #[prost(double, repeated, tag = "4")]
    pub world_from_keyframe: Vec<f64>,
    /// The first pixel index, then each one's distance from the one before: one byte for most.
    #[prost(uint32, repeated, tag = "5")]
    pub pixel_step: Vec<u32>,
    #[prost(float, repeated, tag = "6")]
    pub inverse_depth: Vec<f32>,
    #[prost(float, repeated, tag = "7")]
    pub variance: Vec<f32>,
    #[prost(float, repeated, tag = "8")]
    pub point_pixel: Vec<f32>,
    #[prost(float, repeated, tag = "9")]
    pub point_inverse_depth: Vec<f32>,
    #[prost(float, repeated, tag = "10")]
    pub point_variance: Vec<f32>,
    /// How many of the observations below belong to each point, in order.
    #[prost(uint32, repeated, tag = "11")]
    pub point_observation_count: Vec<u32>,
    #[prost(uint32, repeated, tag = "12")]
    pub observation_keyframe: Vec<u32>,
    #[prost(float, repeated, tag = "13")]
    pub observation_pixel: Vec<f32>,
    #[prost(float, repeated, tag = "14")]
    pub observation_information: Vec<f32>,
    /// Whose keyframe it is.
    #[prost(uint32, tag = "15")]
    pub agent: u32,
    /// In a united map, the pose in the agent's own one.
    #[prost(double, repeated, tag = "16")]
    pub own_world_from_keyframe: Vec<f64>,
}

/// The features of a keyframe.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct FeaturesMessage {
    #[prost(uint32, tag = "1")]
    pub keyframe: u32,
    /// As the crate `features` encodes them.
    #[prost(bytes = "vec", tag = "2")]
    pub data: Vec<u8>,
    /// As the crate `place-recog` writes them; empty if they were not looked up.
    #[prost(bytes = "vec", tag = "3")]
    pub words: Vec<u8>,
}

/// A change of the graph: poses of keyframes, and the tails of the lists of edges and frames.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct GraphMessage {
    #[prost(uint32, repeated, tag = "1")]
    pub keyframe_id: Vec<u32>,
    #[prost(double, repeated, tag = "2")]
    pub world_from_keyframe: Vec<f64>,
    #[prost(uint32, repeated, tag = "3")]
    pub removed_keyframe: Vec<u32>,
    /// The list of edges is cut to this length before the edges below are appended.
    #[prost(uint64, tag = "4")]
    pub edge_offset: u64,
    #[prost(uint32, repeated, tag = "5")]
    pub edge_from: Vec<u32>,
    #[prost(uint32, repeated, tag = "6")]
    pub edge_to: Vec<u32>,
    #[prost(uint32, repeated, tag = "7")]
    pub edge_kind: Vec<u32>,
    #[prost(double, repeated, tag = "8")]
    pub edge_from_from_to: Vec<f64>,
    #[prost(double, repeated, tag = "9")]
    pub edge_information: Vec<f64>,
    /// The list of frames is cut to this length before the frames below are appended.
    #[prost(uint64, tag = "10")]
    pub frame_offset: u64,
    #[prost(double, repeated, tag = "11")]
    pub frame_timestamp: Vec<f64>,
    #[prost(uint64, repeated, tag = "12")]
    pub frame_index: Vec<u64>,
    #[prost(uint32, repeated, tag = "13")]
    pub frame_reference: Vec<u32>,
    #[prost(double, repeated, tag = "14")]
    pub keyframe_from_frame: Vec<f64>,
}
