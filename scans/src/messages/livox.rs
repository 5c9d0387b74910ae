//! `CustomMsg` of Livox's drivers: points with their times after the first, nanoseconds, and their lines.

use super::wire::Reader;
use super::{Encoding, cut_off};
use crate::{Scan, ScanError};

/// Bytes of a point, without what aligns the next.
const POINT: usize = 19;

/// Reads a message.
pub(super) fn read(encoding: Encoding, bytes: &[u8], name: &str) -> Result<Scan, ScanError> {
    (|| points(Reader::new(encoding, bytes)?, bytes.len()))().ok_or_else(|| cut_off(name))
}

fn points(mut reader: Reader<'_>, length: usize) -> Option<Scan> {
    let stamp = reader.header()?;
    // The time of the first point, on the sensor's own clock; the stamp is the same instant on the recording's.
    reader.u64()?;
    let number = reader.u32()?;
    reader.take(4)?;
    let count = reader.u32()? as usize;
    if count != number as usize || count > length / POINT {
        return None;
    }
    let mut scan = Scan { stamp, ..Scan::default() };
    for _ in 0..count {
        let time = reader.u32()?;
        scan.points.push([reader.f32()?, reader.f32()?, reader.f32()?]);
        reader.take(2)?;
        scan.times.push((f64::from(time) * 1e-9) as f32);
        scan.rings.push(reader.u8()?.into());
    }
    Some(scan)
}
