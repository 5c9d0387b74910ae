//! KITTI's `.bin`: little-endian float32 x y z intensity for each point, nothing else.

use crate::{Scan, ScanError};

/// Bytes of a point.
const POINT: usize = 16;

/// Reads the bytes of a KITTI scan; `name` is for messages. The stamp is left at 0.
///
/// # Errors
/// When the length is no multiple of a point's.
pub fn read_kitti(bytes: &[u8], name: &str) -> Result<Scan, ScanError> {
    if !bytes.len().is_multiple_of(POINT) {
        let what = format!(
            "{} bytes are no multiple of {POINT} (float32 x y z intensity); the file is cut off",
            bytes.len()
        );
        return Err(ScanError::format(name, what));
    }
    let number =
        |point: &[u8], i: usize| f32::from_le_bytes([point[i], point[i + 1], point[i + 2], point[i + 3]]);
    let points = bytes.chunks_exact(POINT).map(|p| [number(p, 0), number(p, 4), number(p, 8)]).collect();
    Ok(Scan { points, ..Scan::default() })
}
