//! PCD, the format of the Point Cloud Library.

use super::{CloudFormat, CloudPoint, Columns};
use crate::{Map, MapError, agent_color};
use std::io::{self, Write};
use std::path::Path;

const PCD: CloudFormat = CloudFormat { header, attributes };

/// Writes the cloud as binary PCD 0.7: `x y z intensity confidence`, all float as the library's own
/// point types have them, of LiDARs alone `x y z`; of several agents also `rgb`, the agent's colour as the library packs it, and
/// `label` unsigned, its id. See [`Map::cloud`] for the bound. Returns the number of points.
pub fn write_pcd(out: &mut impl Write, map: &Map, max_relative_variance: f32) -> io::Result<usize> {
    PCD.write(out, map, max_relative_variance)
}

/// Makes a PCD file, see [`write_pcd`].
pub fn save_pcd(path: impl AsRef<Path>, map: &Map, max_relative_variance: f32) -> Result<usize, MapError> {
    PCD.save(path.as_ref(), map, max_relative_variance)
}

fn header(count: usize, columns: Columns) -> String {
    let [fields, sizes, types, counts] =
        if columns.agents { [" rgb label", " 4 4", " F U", " 1 1"] } else { [""; 4] };
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
    if columns.agents {
        // The bits of a float that are 0x00RRGGBB.
        let [red, green, blue] = agent_color(point.agent);
        out.extend([blue, green, red, 0]);
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
        assert!(header.contains(&format!("\nPOINTS {count}\n")) && header.contains("confidence\n"));
        assert_eq!(body.len(), count * 20);
        let last = map.cloud(f32::INFINITY).last().unwrap();
        let tail = f32::from_le_bytes(*bytes.last_chunk().unwrap());
        assert_eq!(tail, last.confidence);
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
