//! ROS 1 bags with `sensor_msgs/CompressedImage` and `sensor_msgs/CameraInfo`.

use super::Target;
use crate::bag::{BagWriter, MessageType};
use crate::recording::{EncodedPicture, Head};
use crate::time;
use anyhow::{Context, Result};
use geometry::{Camera, Distortion, Pinhole};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// The definition of `std_msgs/Header` as part of another's.
macro_rules! header_text {
    () => {
        "================================================================================\n\
         MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    };
}

/// A bag being written.
pub struct BagTarget {
    writer: Option<BagWriter<BufWriter<File>>>,
    images: u32,
    /// The connection of calibrations, and one without its header.
    camera: Option<(u32, Vec<u8>)>,
    count: u32,
}

impl BagTarget {
    /// Begins it.
    pub fn create(path: &Path, head: &Head) -> Result<Self> {
        let camera = head.calibration.camera()?.map(|file| camera_info(&file.camera));
        let mut writer = BagWriter::create(BufWriter::with_capacity(1 << 18, File::create(path)?))?;
        let images = writer.connect("/camera/image/compressed", compressed_image_type());
        let camera = camera.map(|body| (writer.connect("/camera/camera_info", camera_info_type()), body));
        Ok(Self { writer: Some(writer), images, camera, count: 0 })
    }
}

impl Target for BagTarget {
    fn frame(&mut self, _index: u64, timestamp: f64, picture: EncodedPicture) -> Result<()> {
        let time = time::nanoseconds(timestamp)
            .with_context(|| format!("a bag cannot hold the time stamp {timestamp} s"))?;
        let writer = self.writer.as_mut().context("the bag has ended")?;
        let header = header(self.count, time);
        if let Some((connection, body)) = &self.camera {
            writer.message(*connection, time, &[header.as_slice(), body].concat())?;
        }
        let mut message = header;
        put_bytes(&mut message, picture.format.as_bytes());
        put_bytes(&mut message, &picture.bytes);
        writer.message(self.images, time, &message)?;
        self.count += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        let writer = self.writer.take().context("the bag has ended")?;
        Ok(writer.finish()?.get_ref().sync_all()?)
    }
}

fn put_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend(bytes);
}

/// `std_msgs/Header`.
fn header(sequence: u32, time: u64) -> Vec<u8> {
    let numbers = [sequence, (time / 1_000_000_000) as u32, (time % 1_000_000_000) as u32];
    let mut out: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    put_bytes(&mut out, b"camera");
    out
}

/// `sensor_msgs/CameraInfo` behind its header. ROS knows no field-of-view model, so that lens goes by
/// loopbox's own name.
fn camera_info(camera: &Camera) -> Vec<u8> {
    let Pinhole { width, height, fx, fy, cx, cy } = *camera.intrinsics();
    let (model, terms) = match camera.distortion() {
        Distortion::None => ("plumb_bob", Vec::new()),
        Distortion::RadTan(lens) => {
            let mut terms = lens.terms();
            terms.resize(terms.len().max(5), 0.0);
            (if terms.len() > 5 { "rational_polynomial" } else { "plumb_bob" }, terms)
        }
        Distortion::KannalaBrandt(lens) => ("equidistant", lens.terms().to_vec()),
        Distortion::Fov(lens) => ("fov", vec![lens.omega()]),
    };
    let mut out: Vec<u8> = [height as u32, width as u32].iter().flat_map(|side| side.to_le_bytes()).collect();
    put_bytes(&mut out, model.as_bytes());
    out.extend((terms.len() as u32).to_le_bytes());
    let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    let r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    terms.iter().chain(&k).chain(&r).chain(&p).for_each(|number| out.extend(number.to_le_bytes()));
    // No binning, and a region of interest that is the whole image.
    [0u32, 0, 0, 0, 0, 0].iter().for_each(|number| out.extend(number.to_le_bytes()));
    out.push(0);
    out
}

fn compressed_image_type() -> MessageType {
    MessageType {
        name: "sensor_msgs/CompressedImage",
        md5sum: "8f7a12909da2c9d3332d540a0977563f",
        definition: concat!("std_msgs/Header header\nstring format\nuint8[] data\n", header_text!()),
    }
}

fn camera_info_type() -> MessageType {
    MessageType {
        name: "sensor_msgs/CameraInfo",
        md5sum: "c9a58c1b0b154e0e6da7578cb991d214",
        definition: concat!(
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] D\n",
            "float64[9] K\nfloat64[9] R\nfloat64[12] P\nuint32 binning_x\nuint32 binning_y\n",
            "sensor_msgs/RegionOfInterest roi\n",
            header_text!(),
            "================================================================================\n",
            "MSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\n",
            "uint32 width\nbool do_rectify\n"
        ),
    }
}
