//! `foxglove.PointCloud`, as protocol buffers. The pose in the message, of the sensor on the robot, is not applied: scans are
//! in the sensor's frame.

use super::cut_off;
use crate::columns::{Column, Gathering, Kind, Roles};
use crate::{Scan, ScanError};

/// A field of a message: its number and value.
enum Value<'a> {
    Number(u64),
    Bytes(&'a [u8]),
}

/// The fields of a message in order; ends where the bytes make no sense, with `None`.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let (&byte, rest) = self.0.split_first()?;
            self.0 = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn fixed<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (found, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*found)
    }

    fn next(&mut self) -> Option<(u64, Value<'a>)> {
        let tag = self.varint()?;
        let value = match tag & 7 {
            0 => Value::Number(self.varint()?),
            1 => Value::Number(u64::from_le_bytes(self.fixed()?)),
            2 => {
                let length = usize::try_from(self.varint()?).ok()?;
                let (found, rest) = self.0.split_at_checked(length)?;
                self.0 = rest;
                Value::Bytes(found)
            }
            5 => Value::Number(u32::from_le_bytes(self.fixed()?).into()),
            _ => return None,
        };
        Some((tag >> 3, value))
    }

    /// Gives every field to `take`; false when the bytes make no sense.
    fn all(mut self, mut take: impl FnMut(u64, Value<'a>)) -> bool {
        while !self.0.is_empty() {
            let Some((number, value)) = self.next() else { return false };
            take(number, value);
        }
        true
    }
}

/// Reads a message.
pub(super) fn read(bytes: &[u8], name: &str) -> Result<Scan, ScanError> {
    let (mut stamp, mut stride, mut fields, mut data) = (0.0, 0usize, Vec::new(), &[][..]);
    let whole = Fields(bytes).all(|number, value| match (number, value) {
        (1, Value::Bytes(bytes)) => stamp = timestamp(bytes),
        (4, Value::Number(value)) => stride = usize::try_from(value).unwrap_or(usize::MAX),
        (5, Value::Bytes(bytes)) => fields.push(bytes),
        (6, Value::Bytes(bytes)) => data = bytes,
        _ => {}
    });
    if !whole {
        return Err(cut_off(name));
    }
    let (columns, offsets): (Vec<Column>, Vec<usize>) = fields.into_iter().filter_map(field).unzip();
    let end = |c: usize| offsets[c].saturating_add(columns[c].kind.size());
    if stride == 0 || (0..columns.len()).any(|c| end(c) > stride) {
        return Err(ScanError::format(name, format!("points of {stride} bytes do not hold their fields")));
    }
    let mut gathering = Gathering::new(Roles::find(&columns, name)?);
    for point in data.chunks_exact(stride) {
        gathering.push(|c| columns[c].kind.read(&point[offsets[c]..], false));
    }
    Ok(gathering.finish(stamp))
}

/// The stamp alone.
pub(super) fn stamp(bytes: &[u8]) -> Option<f64> {
    let mut fields = Fields(bytes);
    loop {
        if let (1, Value::Bytes(bytes)) = fields.next()? {
            return Some(timestamp(bytes));
        }
    }
}

/// A `google.protobuf.Timestamp`, seconds.
fn timestamp(bytes: &[u8]) -> f64 {
    let (mut seconds, mut nanoseconds) = (0, 0);
    Fields(bytes).all(|number, value| match (number, value) {
        (1, Value::Number(value)) => seconds = value,
        (2, Value::Number(value)) => nanoseconds = value,
        _ => {}
    });
    seconds as f64 + nanoseconds as f64 * 1e-9
}

/// A `foxglove.PackedElementField` and its offset.
fn field(bytes: &[u8]) -> Option<(Column, usize)> {
    let (mut name, mut offset, mut kind) = (String::new(), 0, 0);
    Fields(bytes).all(|number, value| match (number, value) {
        (1, Value::Bytes(bytes)) => name = String::from_utf8_lossy(bytes).into_owned(),
        (2, Value::Number(value)) => offset = value,
        (3, Value::Number(value)) => kind = value,
        _ => {}
    });
    let kind = match kind {
        1 => Kind::Unsigned(1),
        2 => Kind::Signed(1),
        3 => Kind::Unsigned(2),
        4 => Kind::Signed(2),
        5 => Kind::Unsigned(4),
        6 => Kind::Signed(4),
        7 => Kind::Float(4),
        8 => Kind::Float(8),
        _ => return None,
    };
    Some((Column { name, kind, count: 1 }, usize::try_from(offset).ok()?))
}
