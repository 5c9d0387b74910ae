//! PLY, the format most viewers of point clouds read.

use super::{CloudFormat, CloudPoint, CloudSelection, Columns};
use crate::{Map, MapError};
use std::io::{self, Write};
use std::path::Path;

const PLY: CloudFormat = CloudFormat { header, attributes };

/// Writes the cloud as binary little-endian PLY and returns the number of points. Properties are `x y z` float (map
/// units or metres; a comment says which), `intensity` uchar, `confidence` float, and `red green blue` uchar: the
/// colour of the pixel, or its intensity where the source was grey. LiDARs alone have only `x y z`. With several agents
/// `agent` ushort is the agent's id; where no keyframe has colours, `red green blue` is the agent's.
pub fn write_ply(out: &mut impl Write, map: &Map, selection: impl Into<CloudSelection>) -> io::Result<usize> {
    PLY.write(out, map, selection.into())
}

/// Makes a PLY file, see [`write_ply`].
pub fn save_ply(
    path: impl AsRef<Path>,
    map: &Map,
    selection: impl Into<CloudSelection>,
) -> Result<usize, MapError> {
    PLY.save(path.as_ref(), map, selection.into())
}

fn header(count: usize, columns: Columns) -> String {
    let unit = if columns.metric { "metres" } else { "map units" };
    let of_images =
        if columns.of_images { "property uchar intensity\nproperty float confidence\n" } else { "" };
    let colors =
        if columns.colors() { "property uchar red\nproperty uchar green\nproperty uchar blue\n" } else { "" };
    let of_agents = if columns.agents { "property ushort agent\n" } else { "" };
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment loopbox map, lengths in {unit}\n\
         element vertex {count}\nproperty float x\nproperty float y\nproperty float z\n\
         {of_images}{colors}{of_agents}end_header\n"
    )
}

fn attributes(point: &CloudPoint, columns: Columns, out: &mut Vec<u8>) {
    if columns.of_images {
        out.push(point.intensity);
        out.extend(point.confidence.to_le_bytes());
    }
    if columns.colors() {
        out.extend(columns.color(point));
    }
    if columns.agents {
        out.extend(point.agent.0.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_support::{colors, parted};
    use crate::test_support::{lidar_map, sample_map, united};

    #[test]
    fn a_lidars_cloud_is_positions_in_metres() {
        let map = lidar_map(1);
        let mut bytes = Vec::new();
        let count = write_ply(&mut bytes, &map, 0.01).unwrap();
        let (header, body) = parted(&bytes, "end_header\n");
        assert!(header.contains("metres") && !header.contains("intensity"), "{header}");
        assert_eq!((count, body.len()), (map.cloud(0.01).count(), count * 12));
    }

    #[test]
    fn the_header_announces_what_follows() {
        let map = sample_map(2);
        let mut bytes = Vec::new();
        let count = write_ply(&mut bytes, &map, f32::INFINITY).unwrap();
        assert_eq!(count, map.keyframes.values().map(|k| k.semi_dense.len()).sum::<usize>());
        let (header, body) = parted(&bytes, "end_header\n");
        assert!(header.contains(&format!("element vertex {count}\n")) && !header.contains("agent\n"));
        assert_eq!(body.len(), count * 20);
        let first = map.cloud(f32::INFINITY).next().unwrap();
        let float = |at: usize| f32::from_le_bytes(body[at..at + 4].try_into().unwrap());
        assert_eq!([float(0), float(4), float(8)], [0, 1, 2].map(|i| first.position[i] as f32));
        assert_eq!((body[12], float(13)), (first.intensity, first.confidence));
        assert!(header.contains("uchar red") && body[17..20] == [first.intensity; 3]);
    }

    #[test]
    fn several_agents_have_a_colour_each() {
        let map = united();
        let mut bytes = Vec::new();
        let count = write_ply(&mut bytes, &map, f32::INFINITY).unwrap();
        let (header, body) = parted(&bytes, "end_header\n");
        assert!(header.contains("blue\nproperty ushort agent\nend_header"));
        assert_eq!(body.len(), count * 22);
        assert!(body.chunks(22).map(|point| [point[17], point[18], point[19]]).eq(colors(&map)));
        let last = map.agents.keys().next_back().unwrap().0;
        assert_eq!(*body.last_chunk().unwrap(), last.to_le_bytes());
    }
}
