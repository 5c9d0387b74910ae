//! Recordings in MCAP with Foxglove's schemas, as `book/src/reference/recording.md` describes them.

use super::calibration::{CalibrationFiles, NamedFile};
use super::numbers::NumberSet;
use super::picture::EncodedPicture;
use super::{
    CALIBRATION_TOPIC, DROPPED_METADATA, DROPPED_SCHEMA, DROPPED_TOPIC, FRAME, GREY_RANGE, HEAD_METADATA,
    IMAGE_TOPIC, LAG, PROFILE,
};
use crate::pictures::GreyRange;
use crate::{SourceInfo, time};
use anyhow::{Context, Result, anyhow};
use foxglove::Encode;
use foxglove::messages::{CameraCalibration, CompressedImage, Timestamp};
use geometry::{Camera, Distortion, Pinhole};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// A chunk ends here at the latest, so that readers need not hold more than about this.
const CHUNK_BYTES: u64 = 4 << 20;

/// The description of a recording, before its first frame.
#[derive(Clone, Debug, Default)]
pub struct Head {
    /// Where the frames come from, for people.
    pub source: String,
    /// The kind of source, for people.
    pub kind: String,
    /// The calibration.
    pub calibration: CalibrationFiles,
    /// For a run: the number of frames that its mapping takes, which a replay repeats.
    pub lag: Option<usize>,
}

impl Head {
    /// The head of a recording of this source.
    pub fn new(info: &SourceInfo, calibration: CalibrationFiles) -> Self {
        let source = info.path.display().to_string();
        Self { source, kind: info.kind.to_owned(), calibration, lag: info.lag }
    }
}

/// Writes a recording to any stream.
pub struct RecordingWriter<W: Write + Seek> {
    mcap: Writer<W>,
    images: u16,
    calibration: u16,
    dropped: u16,
    camera: Option<Camera>,
    /// Index at the source of the frame that is number 0 here.
    first_index: Option<u64>,
    last_time: u64,
    frames: u64,
    dropped_numbers: NumberSet,
    grey_range: Option<GreyRange>,
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Begins a recording; its head is on the stream when this returns.
    ///
    /// # Errors
    /// When the stream cannot be written to, or the calibration is none.
    pub fn create(out: W, head: &Head) -> Result<Self> {
        let camera = head.calibration.camera()?.map(|file| file.camera);
        // Pictures are compressed already. Chunks are put together in memory, so that what is on the
        // stream is whole at any time.
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .profile(PROFILE)
            .library(concat!("loopbox ", env!("CARGO_PKG_VERSION")));
        let mut mcap = options.create(out)?;
        let CalibrationFiles { camera: camera_file, response, vignette } = &head.calibration;
        for (role, file) in [("camera", camera_file), ("response", response), ("vignette", vignette)] {
            if let Some(file) = file {
                mcap.attach(&attachment(role, file))?;
            }
        }
        let lag = head.lag.map(|lag| lag.to_string());
        let about = [("version", "1"), ("source", &head.source), ("kind", &head.kind)];
        let about: Vec<_> = about.into_iter().chain(lag.as_deref().map(|lag| (LAG, lag))).collect();
        mcap.write_metadata(&metadata(HEAD_METADATA, &about))?;
        let images = add_channel::<CompressedImage, _>(&mut mcap, IMAGE_TOPIC)?;
        let calibration = add_channel::<CameraCalibration, _>(&mut mcap, CALIBRATION_TOPIC)?;
        let schema = mcap.add_schema("loopbox.Dropped", "jsonschema", DROPPED_SCHEMA)?;
        let dropped = mcap.add_channel(schema, DROPPED_TOPIC, "json", &BTreeMap::new())?;
        mcap.flush()?;
        Ok(Self {
            mcap,
            images,
            calibration,
            dropped,
            camera,
            first_index: None,
            last_time: 0,
            frames: 0,
            dropped_numbers: NumberSet::default(),
            grey_range: None,
        })
    }

    /// The range of samples of more than eight bits that tracking sees as 0–255, which a replay repeats.
    pub fn grey_range(&mut self, range: GreyRange) {
        self.grey_range = Some(range);
    }

    /// Writes a frame with its index at the source and its time in seconds.
    ///
    /// # Errors
    /// When the stream cannot be written to, or no recording can hold the time stamp.
    pub fn frame(&mut self, index: u64, timestamp: f64, picture: EncodedPicture) -> Result<()> {
        let time = time::nanoseconds(timestamp)
            .with_context(|| format!("a recording cannot hold the time stamp {timestamp} s"))?;
        if self.first_index.is_none() {
            self.first_index = Some(index);
            self.write_calibration(time)?;
        }
        let number = self.number(index).with_context(|| format!("a recording cannot hold frame {index}"))?;
        let message = CompressedImage {
            timestamp: Some(stamp(time)),
            frame_id: FRAME.into(),
            data: picture.bytes.into(),
            format: picture.format.into(),
        };
        self.message(self.images, number, time, &encoded(&message)?)?;
        self.last_time = time;
        self.frames += 1;
        Ok(())
    }

    /// Notes that the run did not process a frame.
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn dropped(&mut self, index: u64) -> Result<()> {
        // A frame from before the recording began is not in it.
        let Some(number) = self.number(index) else { return Ok(()) };
        if self.dropped_numbers.insert(number) {
            let text = serde_json::json!({ "frame": number }).to_string();
            self.message(self.dropped, 0, self.last_time, text.as_bytes())?;
        }
        Ok(())
    }

    /// Puts everything written so far on the stream, readable whatever comes next.
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn flush(&mut self) -> Result<()> {
        Ok(self.mcap.flush()?)
    }

    /// Ends the file with its index; `left_out` frames are missing from it.
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn finish(&mut self, left_out: u64) -> Result<()> {
        let (frames, left_out) = (self.dropped_numbers.to_string(), left_out.to_string());
        let mut about = vec![("frames", frames.as_str()), ("left out", &left_out)];
        let range = self.grey_range.map(GreyRange::written);
        about.extend(range.as_deref().map(|range| (GREY_RANGE, range)));
        self.mcap.write_metadata(&metadata(DROPPED_METADATA, &about))?;
        self.mcap.finish()?;
        Ok(())
    }

    /// Frames written.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames that the run did not process.
    pub fn dropped_count(&self) -> u64 {
        self.dropped_numbers.count()
    }

    fn number(&self, index: u64) -> Option<u32> {
        index.checked_sub(self.first_index?)?.try_into().ok()
    }

    fn write_calibration(&mut self, time: u64) -> Result<()> {
        let Some(camera) = &self.camera else { return Ok(()) };
        let message = calibration_message(camera, time);
        self.message(self.calibration, 0, time, &encoded(&message)?)
    }

    fn message(&mut self, channel_id: u16, sequence: u32, time: u64, data: &[u8]) -> Result<()> {
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        Ok(self.mcap.write_to_known_channel(&header, data)?)
    }
}

fn attachment<'a>(role: &str, file: &'a NamedFile) -> Attachment<'a> {
    Attachment {
        log_time: 0,
        create_time: 0,
        name: format!("{role}/{}", file.name),
        media_type: "application/octet-stream".into(),
        data: Cow::Borrowed(&file.bytes),
    }
}

fn metadata(name: &str, pairs: &[(&str, &str)]) -> Metadata {
    let metadata = pairs.iter().map(|&(key, value)| (key.to_owned(), value.to_owned())).collect();
    Metadata { name: name.into(), metadata }
}

fn add_channel<T: Encode, W: Write + Seek>(mcap: &mut Writer<W>, topic: &str) -> Result<u16> {
    let schema = T::get_schema().context("a message without a schema")?;
    let schema = mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?;
    Ok(mcap.add_channel(schema, topic, &T::get_message_encoding(), &BTreeMap::new())?)
}

fn encoded<T: Encode>(message: &T) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or(0));
    message.encode(&mut bytes).map_err(|error| anyhow!("a message cannot be encoded: {error}"))?;
    Ok(bytes)
}

/// A time below [`time::nanoseconds`]'s end as Foxglove writes it.
fn stamp(time: u64) -> Timestamp {
    Timestamp::new((time / 1_000_000_000) as u32, (time % 1_000_000_000) as u32)
}

/// The calibration for other tools; loopbox reads the attached file. Foxglove knows no field-of-view model,
/// so that lens goes by loopbox's own name.
pub(super) fn calibration_message(camera: &Camera, time: u64) -> CameraCalibration {
    let Pinhole { width, height, fx, fy, cx, cy } = *camera.intrinsics();
    let (model, d) = match camera.distortion() {
        Distortion::None => ("", Vec::new()),
        Distortion::RadTan(lens) => {
            let mut terms = lens.terms();
            let model = if terms.len() > 5 { "rational_polynomial" } else { "plumb_bob" };
            terms.resize(terms.len().max(5), 0.0);
            (model, terms)
        }
        Distortion::KannalaBrandt(lens) => ("kannala_brandt", lens.terms().to_vec()),
        Distortion::Fov(lens) => ("fov", vec![lens.omega()]),
    };
    CameraCalibration {
        timestamp: Some(stamp(time)),
        frame_id: FRAME.into(),
        width: width as u32,
        height: height as u32,
        distortion_model: model.into(),
        d,
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}
