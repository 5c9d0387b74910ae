//! `sensor_msgs/PointCloud2`.

use super::wire::Reader;
use super::{Encoding, cut_off};
use crate::columns::{Column, Gathering, Kind, Roles};
use crate::{Scan, ScanError};

/// Most fields of a point that are believed.
const MOST_FIELDS: u32 = 256;

/// Where points lie.
struct Layout {
    stamp: f64,
    height: usize,
    width: usize,
    columns: Vec<Column>,
    offsets: Vec<usize>,
    big_endian: bool,
    point_step: usize,
    row_step: usize,
}

/// Reads a message.
pub(super) fn read(encoding: Encoding, bytes: &[u8], name: &str) -> Result<Scan, ScanError> {
    let mut reader = Reader::new(encoding, bytes).ok_or_else(|| cut_off(name))?;
    let layout = layout(&mut reader, name)?;
    let data = reader.u32().and_then(|length| reader.take(length as usize)).ok_or_else(|| cut_off(name))?;
    let end = |c: usize| layout.offsets[c].saturating_add(layout.columns[c].kind.size());
    let least = (0..layout.columns.len()).map(end).max().unwrap_or(0);
    if layout.point_step < least {
        let what = format!("points of {} bytes have fields up to byte {least}", layout.point_step);
        return Err(ScanError::format(name, what));
    }
    let mut gathering = Gathering::new(Roles::find(&layout.columns, name)?);
    for row in 0..layout.height {
        let start = row.saturating_mul(layout.row_step);
        let wanted = layout.width.saturating_mul(layout.point_step);
        let points = data.get(start..start.saturating_add(wanted)).ok_or_else(|| {
            ScanError::format(
                name,
                format!("the data hold fewer than {}×{} points", layout.width, layout.height),
            )
        })?;
        for point in points.chunks_exact(layout.point_step.max(1)) {
            gathering.push(|c| layout.columns[c].kind.read(&point[layout.offsets[c]..], layout.big_endian));
        }
    }
    Ok(gathering.finish(layout.stamp))
}

fn layout(reader: &mut Reader<'_>, name: &str) -> Result<Layout, ScanError> {
    let cut = || cut_off(name);
    let stamp = reader.header().ok_or_else(cut)?;
    let height = reader.u32().ok_or_else(cut)? as usize;
    let width = reader.u32().ok_or_else(cut)? as usize;
    let count = reader.u32().ok_or_else(cut)?;
    if count > MOST_FIELDS {
        return Err(ScanError::format(name, format!("a point with {count} fields is none")));
    }
    let (mut columns, mut offsets) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let field = reader.string().ok_or_else(cut)?;
        let offset = reader.u32().ok_or_else(cut)? as usize;
        let kind = reader.u8().ok_or_else(cut)?;
        let count = reader.u32().ok_or_else(cut)? as usize;
        // Fields of unknown type are passed over: their names may not be those of points' roles.
        if let Some(kind) = kind_of(kind) {
            columns.push(Column { name: field, kind, count });
            offsets.push(offset);
        }
    }
    let big_endian = reader.u8().ok_or_else(cut)? != 0;
    let point_step = reader.u32().ok_or_else(cut)? as usize;
    let row_step = reader.u32().ok_or_else(cut)? as usize;
    // Some drivers leave the length of a row at 0.
    let row_step = if row_step == 0 { width.saturating_mul(point_step) } else { row_step };
    Ok(Layout { stamp, height, width, columns, offsets, big_endian, point_step, row_step })
}

/// The types of `sensor_msgs/PointField`.
fn kind_of(number: u8) -> Option<Kind> {
    Some(match number {
        1 => Kind::Signed(1),
        2 => Kind::Unsigned(1),
        3 => Kind::Signed(2),
        4 => Kind::Unsigned(2),
        5 => Kind::Signed(4),
        6 => Kind::Unsigned(4),
        7 => Kind::Float(4),
        8 => Kind::Float(8),
        _ => return None,
    })
}
