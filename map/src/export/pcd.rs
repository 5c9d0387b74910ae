//! PCD, the format of the Point Cloud Library.

use super::{CloudFormat, CloudPoint, CloudSelection, Columns};
use crate::{Map, MapError};
use std::io::{self, Write};
use std::path::Path;

const PCD: CloudFormat = CloudFormat { header, attributes };

/// Writes the cloud as binary PCD 0.7 and returns the number of points. Fields are `x y z intensity confidence rgb`,
/// all of them float as the library's own point types have them; `rgb` is the colour, packed as the library packs
/// colours, of the same points as in [`write_ply`](super::write_ply). LiDARs alone give `x y z`. With several agents
/// `label` (unsigned) is the agent's id.
pub fn write_pcd(out: &mut impl Write, map: &Map, selection: impl Into<CloudSelection>) -> io::Result<usize> {
    PCD.write(out, map, selection.into())
}

/// Makes a PCD file, see [`write_pcd`].
pub fn save_pcd(
    path: impl AsRef<Path>,
    map: &Map,
    selection: impl Into<CloudSelection>,
) -> Result<usize, MapError> {
    PCD.save(path.as_ref(), map, selection.into())
}

fn header(count: usize, columns: Columns) -> String {
    let [fields, sizes, types, counts] = match (columns.agents, columns.colors()) {
        (true, _) => [" rgb label", " 4 4", " F U", " 1 1"],
        (false, true) => [" rgb", " 4", " F", " 1"],
        (false, false) => [""; 4],
    };
    let [more, size, kind, number] =
        if columns.of_images { [" intensity confidence", " 4 4", " F F", " 1 1"] } else { [""; 4] };
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n\
         FIELDS x y z{more}{fields}\nSIZE 4 4 4{size}{sizes}\nTYPE F F F{kind}{types}\n\
         COUNT 1 1 1{number}{counts}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\n\
         DATA binary\n"
    )
}

fn attributes(point: &CloudPoint, columns: Columns, out: &mut Vec<u8>) {
    if columns.of_images {
        out.extend(f32::from(point.intensity).to_le_bytes());
        out.extend(point.confidence.to_le_bytes());
    }
    if columns.colors() {
        // The bits of a float that are 0x00RRGGBB.
        let [red, green, blue] = columns.color(point);
        out.extend([blue, green, red, 0]);
    }
    if columns.agents {
        out.extend(u32::from(point.agent.0).to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_support::{colors, parted};
    use crate::test_support::{sample_map, united};

    #[test]
    fn the_header_announces_what_follows() {
        let map = sample_map(2);
        let mut bytes = Vec::new();
        let count = write_pcd(&mut bytes, &map, f32::INFINITY).unwrap();
        let (header, body) = parted(&bytes, "DATA binary\n");
        assert!(header.contains(&format!("\nPOINTS {count}\n")) && header.contains("confidence rgb\n"));
        assert_eq!(body.len(), count * 24);
        let last = map.cloud(f32::INFINITY).last().unwrap();
        let [confidence, color] = [&body[body.len() - 8..], &body[body.len() - 4..]];
        assert_eq!(f32::from_le_bytes(*confidence.first_chunk().unwrap()), last.confidence);
        assert_eq!(color, [last.intensity, last.intensity, last.intensity, 0]);
    }

    #[test]
    fn several_agents_have_a_colour_each() {
        let map = united();
        let mut bytes = Vec::new();
        let count = write_pcd(&mut bytes, &map, f32::INFINITY).unwrap();
        let (header, body) = parted(&bytes, "DATA binary\n");
        assert!(header.contains("confidence rgb label\nSIZE 4 4 4 4 4 4 4\nTYPE F F F F F F U\n"));
        assert_eq!(body.len(), count * 28);
        assert!(body.chunks(28).map(|point| [point[22], point[21], point[20]]).eq(colors(&map)));
        let last = map.agents.keys().next_back().unwrap().0;
        assert_eq!(*body.last_chunk().unwrap(), u32::from(last).to_le_bytes());
    }
}
