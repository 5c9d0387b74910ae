//! Writes the seeds that are not plain text: small files with uncompressed chunks and no checksums, so that what the
//! fuzzer changes in them is read.

use map::{AgentId, AgentInfo, FramePose, Keyframe, KeyframeId, Map, Point, SemiDense};
use mcap::WriteOptions;
use mcap::records::{MessageHeader, Record};
use std::collections::BTreeMap;
use std::error::Error;
use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn Error>> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for target in ["map", "recording"] {
        fs::create_dir_all(corpus.join(target))?;
    }
    let whole = corpus.join("map/whole.mcap");
    map::save_map(&whole, &small_map())?;
    write_plain(&fs::read(&whole)?, &corpus.join("map/plain.mcap"))?;
    recording(&corpus.join("recording/raw.mcap"))
}

/// Two keyframes of 8×6 pixels.
fn small_map() -> Map {
    let camera = geometry::Pinhole { width: 8, height: 6, fx: 7.0, fy: 7.0, cx: 3.5, cy: 2.5 };
    let mut map = Map::of(AgentInfo::new("seed", camera));
    for id in [KeyframeId(1), KeyframeId(4)] {
        let pixels = (0..48).map(|i| (i * 37 % 251) as u8).collect();
        let image = geometry::GrayImage::from_vec(8, 6, pixels).expect("48 pixels");
        map.keyframes.insert(
            id,
            Keyframe {
                id,
                agent: AgentId::default(),
                timestamp: f64::from(id.0),
                frame_index: id.0.into(),
                world_from_keyframe: geometry::Sim3::identity(),
                image: Arc::new(image),
                color: None,
                scan: None,
                semi_dense: SemiDense {
                    pixel: vec![3, 9].into(),
                    inverse_depth: vec![0.5, 0.7].into(),
                    variance: vec![0.1, 0.2].into(),
                }
                .into(),
                points: vec![Point {
                    pixel: [2.0, 3.0],
                    inverse_depth: 0.4,
                    variance: 0.1,
                    observations: Vec::new(),
                }],
                features: None,
                words: None,
            },
        );
        map.frames.push(FramePose {
            timestamp: f64::from(id.0),
            frame_index: id.0.into(),
            reference: id,
            keyframe_from_frame: geometry::Se3::identity(),
        });
    }
    map
}

fn plain() -> WriteOptions {
    WriteOptions::new()
        .compression(None)
        .calculate_chunk_crcs(false)
        .calculate_data_section_crc(false)
        .calculate_summary_section_crc(false)
}

/// The same messages and metadata, uncompressed and without checksums.
fn write_plain(file: &[u8], to: &Path) -> Result<(), Box<dyn Error>> {
    let mut writer = plain().profile("loopbox.map").create(File::create(to)?)?;
    for record in mcap::read::LinearReader::new(file)? {
        if let Record::Metadata(metadata) = record? {
            writer.write_metadata(&metadata)?;
        }
    }
    for message in mcap::MessageStream::new(file)? {
        writer.write(&message?)?;
    }
    writer.finish()?;
    Ok(())
}

/// One raw image in Foxglove's JSON.
fn recording(to: &Path) -> Result<(), Box<dyn Error>> {
    let mut writer = plain().create(File::create(to)?)?;
    let schema = writer.add_schema("foxglove.RawImage", "jsonschema", b"{}")?;
    let channel = writer.add_channel(schema, "/image", "json", &BTreeMap::new())?;
    let image = r#"{"timestamp":{"sec":1,"nsec":2},"frame_id":"c","width":2,"height":2,"encoding":"mono8","step":2,"data":"AAECAw=="}"#;
    writer.write_to_known_channel(
        &MessageHeader { channel_id: channel, sequence: 0, log_time: 1, publish_time: 1 },
        image.as_bytes(),
    )?;
    writer.finish()?;
    Ok(())
}
