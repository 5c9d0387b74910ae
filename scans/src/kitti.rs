//! `.bin` files: little-endian float32 x y z for each point, and what follows by the layout; KITTI's has the intensity.

use crate::bin_layout::BinLayout;
use crate::columns::{Gathering, Roles};
use crate::{Scan, ScanError};

/// Reads the bytes of a KITTI scan; `name` is for messages. The stamp is left at 0.
///
/// # Errors
/// When the length is no multiple of a point's.
pub fn read_kitti(bytes: &[u8], name: &str) -> Result<Scan, ScanError> {
    read_bin(bytes, &BinLayout::default(), 0.0, name)
}

/// Reads the bytes of a `.bin` scan of this layout; `name` is for messages, `stamp` the scan's, to which times of points relate.
///
/// # Errors
/// When the length is no multiple of a point's.
pub fn read_bin(bytes: &[u8], layout: &BinLayout, stamp: f64, name: &str) -> Result<Scan, ScanError> {
    let size = layout.bytes();
    if !bytes.len().is_multiple_of(size) {
        let what = format!(
            "{} bytes are no multiple of {size} (float32 {}); the file is cut off",
            bytes.len(),
            layout.columns()
        );
        return Err(ScanError::format(name, what));
    }
    let number =
        |point: &[u8], i: usize| f32::from_le_bytes([point[i], point[i + 1], point[i + 2], point[i + 3]]);
    if layout.ring.is_none() && layout.time.is_none() {
        let points = bytes.chunks_exact(size).map(|p| [number(p, 0), number(p, 4), number(p, 8)]).collect();
        return Ok(Scan { stamp, points, ..Scan::default() });
    }
    let mut gathering = Gathering::new(Roles::at([0, 1, 2], layout.time, layout.ring));
    for point in bytes.chunks_exact(size) {
        gathering.push(|column| f64::from(number(point, 4 * column)));
    }
    Ok(gathering.finish(stamp))
}
