//! ROS 2 `sensor_msgs`: Image, CompressedImage and CameraInfo; and two messages of videos.

use super::cdr::Cdr;
use super::{ImageMessage, VideoMessage, stamp};
use crate::pictures::{Picture, RawPicture};
use anyhow::Result;
use calib::{CameraInfo, Roi};

/// `std_msgs/Header`: its stamp.
fn header(cdr: &mut Cdr) -> Result<Option<f64>> {
    let (seconds, nanoseconds) = (cdr.i32()?, cdr.u32()?);
    let _frame_id = cdr.string()?;
    Ok(stamp(seconds.into(), nanoseconds))
}

/// `sensor_msgs/msg/Image`.
pub fn raw(data: &[u8]) -> Result<ImageMessage> {
    let mut cdr = Cdr::new(data)?;
    let stamp = header(&mut cdr)?;
    let (height, width) = (cdr.u32()? as usize, cdr.u32()? as usize);
    let encoding = cdr.string()?;
    let big_endian = cdr.u8()? != 0;
    let step = cdr.u32()? as usize;
    let data = cdr.bytes()?.to_vec();
    let picture = Picture::Raw(RawPicture { width, height, step, encoding, big_endian, data });
    Ok(ImageMessage { stamp, picture })
}

/// `sensor_msgs/msg/CompressedImage`.
pub fn compressed(data: &[u8]) -> Result<ImageMessage> {
    let mut cdr = Cdr::new(data)?;
    let stamp = header(&mut cdr)?;
    let _format = cdr.string()?;
    Ok(ImageMessage { stamp, picture: Picture::Encoded(cdr.bytes()?.to_vec()) })
}

/// `foxglove_msgs/msg/CompressedVideo`.
pub fn video(data: &[u8]) -> Result<VideoMessage> {
    let mut cdr = Cdr::new(data)?;
    // A time and a frame's name, as a header.
    let stamp = header(&mut cdr)?;
    let data = cdr.bytes()?.to_vec();
    Ok(VideoMessage { stamp, codec: cdr.string()?, data })
}

/// `ffmpeg_image_transport_msgs/msg/FFMPEGPacket`.
pub fn packet(data: &[u8]) -> Result<VideoMessage> {
    let mut cdr = Cdr::new(data)?;
    let stamp = header(&mut cdr)?;
    let _size = (cdr.i32()?, cdr.i32()?);
    let codec = cdr.string()?;
    let (_time, _flags, _big_endian) = (cdr.u64()?, cdr.u8()?, cdr.u8()?);
    Ok(VideoMessage { stamp, codec, data: cdr.bytes()?.to_vec() })
}

/// `sensor_msgs/msg/CameraInfo`.
pub fn camera_info(data: &[u8]) -> Result<CameraInfo> {
    let mut cdr = Cdr::new(data)?;
    header(&mut cdr)?;
    let (height, width) = (cdr.u32()?, cdr.u32()?);
    let model = cdr.string()?;
    let d = cdr.f64_sequence()?;
    let mut numbers = |count: usize| (0..count).map(|_| cdr.f64()).collect::<Result<Vec<f64>>>();
    let (k, _r, p) = (numbers(9)?, numbers(9)?, numbers(12)?);
    let binning = (cdr.u32()?, cdr.u32()?);
    let (x, y, rows, columns) = (cdr.u32()?, cdr.u32()?, cdr.u32()?, cdr.u32()?);
    let roi = Roi { x, y, width: columns, height: rows };
    Ok(CameraInfo { width, height, model, d, k, p, binning, roi })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes CDR as a ROS 2 node on a machine of either byte order would.
    struct Writer {
        body: Vec<u8>,
        big_endian: bool,
    }

    impl Writer {
        fn number<const N: usize>(&mut self, mut little: [u8; N]) -> &mut Self {
            while !self.body.len().is_multiple_of(N) {
                self.body.push(0);
            }
            if self.big_endian {
                little.reverse();
            }
            self.body.extend(little);
            self
        }

        fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
            self.number((bytes.len() as u32).to_le_bytes()).body.extend(bytes);
            self
        }

        fn header(&mut self, frame_id: &[u8]) -> &mut Self {
            self.number(12i32.to_le_bytes()).number(500_000_000u32.to_le_bytes()).bytes(frame_id)
        }

        fn message(&self) -> Vec<u8> {
            [&[0, u8::from(!self.big_endian), 0, 0], self.body.as_slice()].concat()
        }
    }

    #[test]
    fn images_of_both_byte_orders_are_read() {
        for big_endian in [false, true] {
            let mut w = Writer { body: Vec::new(), big_endian };
            w.header(b"cam\0").number(1u32.to_le_bytes()).number(2u32.to_le_bytes());
            w.bytes(b"mono8\0").number([0u8]).number(2u32.to_le_bytes()).bytes(&[7, 8]);
            let message = raw(&w.message()).unwrap();
            assert_eq!(message.stamp, Some(12.5));
            assert_eq!(message.picture.into_grey().unwrap().data(), [7, 8]);
            let whole = w.message();
            for end in 0..whole.len() {
                assert!(raw(&whole[..end]).is_err(), "cut at {end}");
            }
        }
    }

    #[test]
    fn camera_info_becomes_a_camera() {
        for big_endian in [false, true] {
            let mut w = Writer { body: Vec::new(), big_endian };
            // An odd frame id, so that the floats need padding.
            w.header(b"c\0").number(480u32.to_le_bytes()).number(640u32.to_le_bytes()).bytes(b"plumb_bob\0");
            w.number(5u32.to_le_bytes());
            let k = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0f64];
            let p = [450.0, 0.0, 310.0, -9.0, 0.0, 450.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0];
            let r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
            for value in [0.1, -0.2, 0.001, 0.002, 0.0].into_iter().chain(k).chain(r).chain(p) {
                w.number(value.to_le_bytes());
            }
            // Binned once across and twice down; a region of 400×300 at (100, 60), rectified or not.
            [1u32, 2, 100, 60, 300, 400].iter().for_each(|v| {
                w.number(v.to_le_bytes());
            });
            w.number([0u8]);
            let info = camera_info(&w.message()).unwrap();
            assert_eq!((info.width, info.height, &info.k[..], &info.p[..]), (640, 480, &k[..], &p[..]));
            assert_eq!((info.binning, info.roi), ((1, 2), Roi { x: 100, y: 60, width: 400, height: 300 }));
            let whole = w.message();
            assert!((0..whole.len() - 1).all(|end| camera_info(&whole[..end]).is_err()));
            let camera = info.camera(calib::Imagery::Raw, "test").unwrap().unwrap();
            assert_eq!((camera.intrinsics().width, camera.intrinsics().fy), (400, 255.0));
            assert!(!camera.distortion().is_identity());
        }
    }
}
