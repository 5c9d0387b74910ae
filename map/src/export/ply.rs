//! PLY, the format most viewers of point clouds read.

use super::{save, write_position};
use crate::{Map, MapError};
use std::io::{self, Write};
use std::path::Path;

/// Writes the cloud as binary little-endian PLY: `x y z` float (map units), `intensity` uchar,
/// `confidence` float; see [`Map::cloud`] for the bound. Returns the number of points.
pub fn write_ply(out: &mut impl Write, map: &Map, max_relative_variance: f32) -> io::Result<usize> {
    let count = map.cloud(max_relative_variance).count();
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment loopbox map, lengths in map units\n\
         element vertex {count}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar intensity\nproperty float confidence\nend_header\n"
    )?;
    for point in map.cloud(max_relative_variance) {
        write_position(out, &point)?;
        out.write_all(&[point.intensity])?;
        out.write_all(&point.confidence.to_le_bytes())?;
    }
    Ok(count)
}

/// Makes a PLY file, see [`write_ply`].
pub fn save_ply(path: impl AsRef<Path>, map: &Map, max_relative_variance: f32) -> Result<usize, MapError> {
    save(path.as_ref(), |out| write_ply(out, map, max_relative_variance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::sample_map;

    #[test]
    fn the_header_announces_what_follows() {
        let map = sample_map(2);
        let mut bytes = Vec::new();
        let count = write_ply(&mut bytes, &map, f32::INFINITY).unwrap();
        assert_eq!(count, map.keyframes.values().map(|k| k.semi_dense.len()).sum::<usize>());
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.contains(&format!("element vertex {count}\n")));
        assert_eq!(bytes.len() - end, count * 17);
        let first = map.cloud(f32::INFINITY).next().unwrap();
        let float = |at: usize| f32::from_le_bytes(bytes[end + at..end + at + 4].try_into().unwrap());
        assert_eq!([float(0), float(4), float(8)], [0, 1, 2].map(|i| first.position[i] as f32));
        assert_eq!((bytes[end + 12], float(13)), (first.intensity, first.confidence));
    }
}
