//! Maps in the formats of other tools: point clouds (PLY, PCD, LAS), scenes (glTF), trajectories (TUM, KITTI), and posed images with sparse
//! points (COLMAP, nerfstudio).
//!
//! Each format has a function that writes to any [`Write`] and one that makes a file which is either
//! whole or as it was before.

mod cloud;
mod colmap;
mod color;
mod glb;
mod las;
mod nerfstudio;
mod pcd;
mod ply;
mod posed_images;
mod trajectory;

pub use cloud::{CloudPoint, CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE};
pub use colmap::save_colmap;
pub use color::agent_color;
pub use glb::save_glb;
pub use las::save_las;
pub use nerfstudio::save_nerfstudio;
pub use pcd::{save_pcd, write_pcd};
pub use ply::{save_ply, write_ply};
pub use trajectory::{save_kitti, save_tum, write_kitti, write_tum};

use crate::{Keyframe, Map, MapError, SensorKind, atomic::write_atomically};
use cloud::Chosen;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Makes the file `path` with `fill`, whole or not at all.
fn save<T>(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> Result<T, MapError> {
    write_atomically(path, fill).map_err(|source| MapError::write(path, source))
}

/// Keyframes whose points are made at once: enough for all cores, and some tens of megabytes.
const KEYFRAMES_TOGETHER: usize = 16;
/// What a point takes at most.
const MAX_POINT_BYTES: usize = 28;

/// A file format for clouds of points: a header of text, then the points in binary.
struct CloudFormat {
    /// The header for a number of points.
    header: fn(count: usize, columns: Columns) -> String,
    /// Appends what follows a point's position.
    attributes: fn(point: &CloudPoint, columns: Columns, out: &mut Vec<u8>),
}

/// What a cloud's points have besides their positions.
#[derive(Clone, Copy)]
struct Columns {
    /// Intensity and confidence: where cameras are among the agents.
    of_images: bool,
    /// Their agent: where there are several.
    agents: bool,
    /// Whether any keyframe has colours.
    in_color: bool,
    /// Lengths are in metres.
    metric: bool,
}

impl Columns {
    fn of(map: &Map) -> Self {
        Self {
            of_images: map.sensor() != Some(SensorKind::Lidar),
            agents: map.agents.len() > 1,
            in_color: map.keyframes.values().any(|keyframe| keyframe.color.is_some()),
            metric: map.is_metric(),
        }
    }

    /// Whether points have a colour: LiDARs' have none unless agents are told apart by it.
    fn colors(self) -> bool {
        self.of_images || self.agents
    }

    /// The colour of a point, red, green, blue: that of its pixel, which is grey where its source was. In a map without
    /// colours that of its agent, where there are several.
    fn color(self, point: &CloudPoint) -> [u8; 3] {
        match point.color {
            Some(color) => color,
            None if self.agents && !self.in_color => agent_color(point.agent),
            None => [point.intensity; 3],
        }
    }
}

impl CloudFormat {
    /// Writes the cloud of a map, agents told apart where there are several: the header, then of each point
    /// the position as three little-endian floats and its attributes. Returns the number of points.
    fn write(&self, out: &mut impl Write, map: &Map, selection: CloudSelection) -> io::Result<usize> {
        let columns = Columns::of(map);
        let bound = selection.max_relative_variance;
        if let Some(voxel) = selection.voxel {
            let points: Vec<CloudPoint> = map.thinned_cloud(bound, voxel).collect();
            out.write_all((self.header)(points.len(), columns).as_bytes())?;
            out.write_all(&self.points(points.iter().copied(), columns))?;
            return Ok(points.len());
        }
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let Chosen { choice, count } = selection.chosen(map);
        out.write_all((self.header)(count, columns).as_bytes())?;
        for together in keyframes.chunks(KEYFRAMES_TOGETHER) {
            let points = |keyframe: &&Keyframe| {
                let points = self.points(keyframe.world_cloud(map, bound, choice), columns);
                keyframe.rest();
                points
            };
            for bytes in together.par_iter().map(points).collect::<Vec<_>>() {
                out.write_all(&bytes)?;
            }
        }
        Ok(count)
    }

    /// Points as they are written.
    fn points(&self, points: impl Iterator<Item = CloudPoint>, columns: Columns) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(points.size_hint().0 * MAX_POINT_BYTES);
        for point in points {
            let [x, y, z] = point.position.map(|value| (value as f32).to_le_bytes()).into();
            bytes.extend_from_slice(&x);
            bytes.extend_from_slice(&y);
            bytes.extend_from_slice(&z);
            (self.attributes)(&point, columns, &mut bytes);
        }
        bytes
    }

    /// Makes a file of the cloud, see [`write`](Self::write).
    fn save(&self, path: &Path, map: &Map, selection: CloudSelection) -> Result<usize, MapError> {
        save(path, |out| self.write(out, map, selection))
    }
}

/// How many positions there are, and the box around them; of none it is inside out.
struct Extent {
    count: usize,
    least: Vector3<f64>,
    most: Vector3<f64>,
}

impl Extent {
    fn of(positions: impl Iterator<Item = Vector3<f64>>) -> Self {
        let none = Self {
            count: 0,
            least: Vector3::repeat(f64::INFINITY),
            most: Vector3::repeat(f64::NEG_INFINITY),
        };
        positions.fold(none, |Self { count, least, most }, position| Self {
            count: count + 1,
            least: least.inf(&position),
            most: most.sup(&position),
        })
    }
}

/// What the tests of all formats of clouds need.
#[cfg(test)]
pub(crate) mod test_support {
    use crate::{Map, agent_color};

    /// The header and the body of a cloud's file, parted after the line `last`.
    pub(crate) fn parted<'a>(bytes: &'a [u8], last: &str) -> (&'a str, &'a [u8]) {
        let end = bytes.windows(last.len()).position(|w| w == last.as_bytes()).unwrap() + last.len();
        (std::str::from_utf8(&bytes[..end]).unwrap(), &bytes[end..])
    }

    /// The colours of a cloud's points in order.
    pub(crate) fn colors(map: &Map) -> impl Iterator<Item = [u8; 3]> + '_ {
        map.cloud(f32::INFINITY).map(|point| agent_color(point.agent))
    }
}
