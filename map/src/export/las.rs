//! LAS and its compressed form LAZ, the formats of surveyors (ASPRS LAS 1.4, R15).

use super::{CloudPoint, CloudSelection, Columns, Extent, save};
use crate::{Map, MapError};
use las::point::Format;
use las::{Builder, Color, Header, Transform, Vector, Writer};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

/// The steps in which coordinates are written, of the map's extent: 2³⁰, a millimetre over a thousand kilometres.
const STEPS: f64 = (1u64 << 30) as f64;
/// No finer steps than these, units of the map: what LiDARs and cameras measure is coarser by far.
const FINEST_STEP: f64 = 1e-4;

/// Makes a LAS file, or a LAZ file if its name ends in `.laz`. Maps of cameras and of several agents have point
/// format 2 (with colours, as in [`save_ply`](super::save_ply)), others 0. `intensity` uses 16 bits, and
/// `point_source_id` is the agent's id plus one. Returns the number of points.
///
/// # Errors
/// When the file cannot be written.
pub fn save_las(
    path: impl AsRef<Path>,
    map: &Map,
    selection: impl Into<CloudSelection>,
) -> Result<usize, MapError> {
    let (path, selection) = (path.as_ref(), selection.into());
    let compressed = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("laz"));
    let columns = Columns::of(map);
    let points = || selection.points(map);
    let header = header(points(), columns, compressed);
    save(path, |out| write(out.get_ref(), header.map_err(io::Error::other)?, points(), columns))
}

/// What stands before the points: their format, and how coordinates become whole numbers.
fn header(
    points: impl Iterator<Item = CloudPoint>,
    columns: Columns,
    compressed: bool,
) -> las::Result<Header> {
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(if columns.colors() { 2 } else { 0 })?;
    builder.point_format.is_compressed = compressed;
    builder.generating_software = concat!("loopbox ", env!("CARGO_PKG_VERSION")).into();
    builder.system_identifier = if columns.metric { "metres" } else { "map units" }.into();
    let Extent { least, most, .. } = Extent::of(points.map(|point| point.position));
    let transform = |axis: usize| {
        let (low, high) = (least[axis], most[axis]);
        if low > high {
            return Transform { scale: FINEST_STEP, offset: 0.0 };
        }
        Transform { scale: ((high - low) / STEPS).max(FINEST_STEP), offset: low }
    };
    builder.transforms = Vector { x: transform(0), y: transform(1), z: transform(2) };
    builder.into_header()
}

/// Writes header and points to a file that is empty so far.
fn write(
    file: &File,
    header: Header,
    points: impl Iterator<Item = CloudPoint>,
    columns: Columns,
) -> io::Result<usize> {
    // The writer wants to own what it writes to; the file is the same.
    let mut writer = Writer::new(BufWriter::new(file.try_clone()?), header).map_err(io::Error::other)?;
    let mut count = 0;
    for point in points {
        let wide = |byte: u8| u16::from(byte) * 257;
        let [red, green, blue] = columns.color(&point).map(wide);
        let [x, y, z] = point.position.into();
        let point = las::Point {
            x,
            y,
            z,
            intensity: wide(point.intensity),
            return_number: 1,
            number_of_returns: 1,
            point_source_id: point.agent.0.saturating_add(1),
            color: columns.colors().then(|| Color::new(red, green, blue)),
            ..Default::default()
        };
        writer.write_point(point).map_err(io::Error::other)?;
        count += 1;
    }
    writer.close().map_err(io::Error::other)?;
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{lidar_map, sample_map, united};
    use las::Reader;
    use nalgebra::Vector3;

    #[test]
    fn points_come_back_where_they_are() {
        let folder = tempfile::tempdir().unwrap();
        for (map, name) in [(sample_map(2), "a.las"), (united(), "b.laz"), (lidar_map(1), "c.LAZ")] {
            let path = folder.path().join(name);
            let count = save_las(&path, &map, f32::INFINITY).unwrap();
            let columns = Columns::of(&map);
            let mut reader = Reader::from_path(&path).unwrap();
            assert_eq!(reader.header().number_of_points(), count as u64);
            let mut expected = map.cloud(f32::INFINITY);
            for found in reader.read_all().unwrap().points().map(Result::unwrap) {
                let expected = expected.next().unwrap();
                let off = Vector3::new(found.x, found.y, found.z) - expected.position;
                assert!(off.amax() <= 0.6 * FINEST_STEP, "{off}");
                assert_eq!(found.intensity >> 8, u16::from(expected.intensity));
                assert_eq!(found.point_source_id, expected.agent.0 + 1);
                let color = found.color.map(|c| [c.red, c.green, c.blue].map(|level| (level >> 8) as u8));
                assert_eq!(color, columns.colors().then(|| columns.color(&expected)));
            }
            assert!(count > 0 && expected.next().is_none(), "{name}");
        }
    }
}
