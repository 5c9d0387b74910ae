//! ROS 1 `sensor_msgs`: Image, CompressedImage and CameraInfo. Little-endian, without padding
//! (wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes).

use super::{ImageMessage, stamp};
use crate::pictures::{Picture, RawPicture};
use anyhow::{Context, Result};
use calib::{CameraInfo, Roi};

/// Reads plain types in order.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count).context("the message ends early")?;
        self.0 = rest;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    fn f64(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.number()?))
    }

    fn bytes(&mut self) -> Result<&'a [u8]> {
        let count = self.u32()? as usize;
        self.take(count)
    }

    fn string(&mut self) -> Result<String> {
        Ok(String::from_utf8_lossy(self.bytes()?).into_owned())
    }

    /// `std_msgs/Header`: its stamp.
    fn header(&mut self) -> Result<Option<f64>> {
        let (_sequence, seconds, nanoseconds) = (self.u32()?, self.u32()?, self.u32()?);
        let _frame_id = self.bytes()?;
        Ok(stamp(seconds.into(), nanoseconds))
    }
}

/// `sensor_msgs/Image`.
pub fn raw(data: &[u8]) -> Result<ImageMessage> {
    let mut fields = Fields(data);
    let stamp = fields.header()?;
    let (height, width) = (fields.u32()? as usize, fields.u32()? as usize);
    let encoding = fields.string()?;
    let big_endian = fields.take(1)? != [0];
    let step = fields.u32()? as usize;
    let data = fields.bytes()?.to_vec();
    let picture = Picture::Raw(RawPicture { width, height, step, encoding, big_endian, data });
    Ok(ImageMessage { stamp, picture })
}

/// `sensor_msgs/CompressedImage`.
pub fn compressed(data: &[u8]) -> Result<ImageMessage> {
    let mut fields = Fields(data);
    let stamp = fields.header()?;
    let _format = fields.bytes()?;
    Ok(ImageMessage { stamp, picture: Picture::Encoded(fields.bytes()?.to_vec()) })
}

/// `sensor_msgs/CameraInfo`.
pub fn camera_info(data: &[u8]) -> Result<CameraInfo> {
    let mut fields = Fields(data);
    fields.header()?;
    let (height, width) = (fields.u32()?, fields.u32()?);
    let model = fields.string()?;
    let count = fields.u32()? as usize;
    // A damaged count must not ask for more memory than the message could fill.
    let count = Some(count).filter(|&count| count <= data.len() / 8).context("the message ends early")?;
    let mut numbers = |count: usize| (0..count).map(|_| fields.f64()).collect::<Result<Vec<f64>>>();
    let (d, k, _r, p) = (numbers(count)?, numbers(9)?, numbers(9)?, numbers(12)?);
    let binning = (fields.u32()?, fields.u32()?);
    let (x, y, rows, columns) = (fields.u32()?, fields.u32()?, fields.u32()?, fields.u32()?);
    let roi = Roi { x, y, width: columns, height: rows };
    Ok(CameraInfo { width, height, model, d, k, p, binning, roi })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_cut_anywhere_is_refused() {
        let mut message = Vec::new();
        [7u32, 12, 500_000_000, 3].iter().for_each(|v| message.extend(v.to_le_bytes()));
        message.extend(b"cam");
        [1u32, 2, 5].iter().for_each(|v| message.extend(v.to_le_bytes()));
        message.extend(b"mono8");
        message.push(0);
        [2u32, 2].iter().for_each(|v| message.extend(v.to_le_bytes()));
        message.extend([7, 8]);
        let read = raw(&message).unwrap();
        assert_eq!(read.stamp, Some(12.5));
        assert_eq!(read.picture.into_grey().unwrap().data(), [7, 8]);
        assert!((0..message.len()).all(|end| raw(&message[..end]).is_err()));
    }
}
