//! Colours of keyframes: a topic of their own, which only files with colours have.

use crate::KeyframeId;
use crate::color::{Color, Luma};

/// Where colours lie in a file that has some.
pub(super) const COLOR_TOPIC: &str = "/loopbox/color";
/// Name of the message's schema.
pub(super) const COLOR_SCHEMA: &str = "loopbox.Color";

/// A keyframe's colours.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ColorMessage {
    #[prost(uint32, tag = "1")]
    pub keyframe: u32,
    /// What the grey levels are made of, by its number.
    #[prost(uint32, tag = "2")]
    pub luma: u32,
    /// The differences of blue and of red.
    #[prost(bytes = "vec", tag = "3")]
    pub jpeg: Vec<u8>,
}

/// The message of a keyframe's colours.
pub(super) fn to_message(id: KeyframeId, color: &Color) -> ColorMessage {
    ColorMessage { keyframe: id.0, luma: color.luma.number(), jpeg: color.jpeg.to_vec() }
}

/// The colours of a message; `None` of a kind that this program does not know, whose image stays grey.
pub(super) fn from_message(message: ColorMessage) -> (KeyframeId, Option<Color>) {
    let luma = Luma::of_number(message.luma);
    (KeyframeId(message.keyframe), luma.map(|luma| Color { luma, jpeg: message.jpeg.into() }))
}
