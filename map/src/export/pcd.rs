//! PCD, the format of the Point Cloud Library.

use super::{save, write_position};
use crate::{Map, MapError};
use std::io::{self, Write};
use std::path::Path;

/// Writes the cloud as binary PCD 0.7: `x y z intensity confidence`, all float as the library's own
/// point types have them; see [`Map::cloud`] for the bound. Returns the number of points.
pub fn write_pcd(out: &mut impl Write, map: &Map, max_relative_variance: f32) -> io::Result<usize> {
    let count = map.cloud(max_relative_variance).count();
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n\
         FIELDS x y z intensity confidence\nSIZE 4 4 4 4 4\nTYPE F F F F F\nCOUNT 1 1 1 1 1\n\
         WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )?;
    for point in map.cloud(max_relative_variance) {
        write_position(out, &point)?;
        out.write_all(&f32::from(point.intensity).to_le_bytes())?;
        out.write_all(&point.confidence.to_le_bytes())?;
    }
    Ok(count)
}

/// Makes a PCD file, see [`write_pcd`].
pub fn save_pcd(path: impl AsRef<Path>, map: &Map, max_relative_variance: f32) -> Result<usize, MapError> {
    save(path.as_ref(), |out| write_pcd(out, map, max_relative_variance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::sample_map;

    #[test]
    fn the_header_announces_what_follows() {
        let map = sample_map(2);
        let mut bytes = Vec::new();
        let count = write_pcd(&mut bytes, &map, f32::INFINITY).unwrap();
        let end = bytes.windows(12).position(|w| w == b"DATA binary\n").unwrap() + 12;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.contains(&format!("\nPOINTS {count}\n")));
        assert_eq!(bytes.len() - end, count * 20);
        let last = map.cloud(f32::INFINITY).last().unwrap();
        let tail = f32::from_le_bytes(*bytes.last_chunk().unwrap());
        assert_eq!(tail, last.confidence);
    }
}
