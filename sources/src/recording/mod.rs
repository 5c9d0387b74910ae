//! Recording and replay: frames as they were captured, in a file that outlives a crash.

mod button;
mod calibration;
mod numbers;
mod picture;
mod reader;
mod recorder;
mod writer;

pub use button::{RecordButton, number_of};
pub use calibration::{CalibrationFiles, NamedFile};
pub use numbers::NumberSet;
pub use picture::{EncodedPicture, encode};
pub use reader::{RecordedHead, dropped_number, read_head};
pub use recorder::{Recorder, Summary, check_length, check_name, refuse_existing};
pub use writer::{Head, RecordingWriter};

/// The profile of loopbox's recordings in MCAP's header.
pub const PROFILE: &str = "loopbox.recording";
/// Topic of the pictures.
pub const IMAGE_TOPIC: &str = "/camera/image";
/// Topic of the calibration.
pub const CALIBRATION_TOPIC: &str = "/camera/calibration";
/// Key in the head's metadata of how many frames the mapping of the recorded run took.
const LAG: &str = "mapping lag";
/// Topic of the numbers of frames that the run did not process.
pub const DROPPED_TOPIC: &str = "/loopbox/dropped";
/// Metadata at the end: all of those numbers.
pub const DROPPED_METADATA: &str = "loopbox.dropped";
/// Key in it of the samples that are grey levels 0 and 255, of pictures of more than eight bits.
pub const GREY_RANGE: &str = "grey range";
/// Metadata at the start: where the frames come from.
pub const HEAD_METADATA: &str = "loopbox.recording";
/// The coordinate frame of the pictures.
const FRAME: &str = "camera";
const DROPPED_SCHEMA: &[u8] = br#"{"type":"object","properties":{"frame":{"type":"integer"}}}"#;

#[cfg(test)]
mod tests;
