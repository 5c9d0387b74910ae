//! Maps in the formats of other tools: point clouds (PLY, PCD) and trajectories (TUM, KITTI).
//!
//! Each format has a function that writes to any [`Write`] and one that makes a file which is either
//! whole or as it was before.

mod cloud;
mod color;
mod pcd;
mod ply;
mod trajectory;

pub use cloud::{CloudPoint, DEFAULT_MAX_RELATIVE_VARIANCE};
pub use color::agent_color;
pub use pcd::{save_pcd, write_pcd};
pub use ply::{save_ply, write_ply};
pub use trajectory::{save_kitti, save_tum, write_kitti, write_tum};

use crate::{Keyframe, Map, MapError, SensorKind, atomic::write_atomically};
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
const MAX_POINT_BYTES: usize = 24;

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
}

impl CloudFormat {
    /// Writes the cloud of a map, agents told apart where there are several: the header, then of each point
    /// the position as three little-endian floats and its attributes. Returns the number of points.
    fn write(&self, out: &mut impl Write, map: &Map, max_relative_variance: f32) -> io::Result<usize> {
        let columns =
            Columns { of_images: map.sensor() != Some(SensorKind::Lidar), agents: map.agents.len() > 1 };
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let count = keyframes.par_iter().map(|keyframe| keyframe.cloud_size(max_relative_variance)).sum();
        out.write_all((self.header)(count, columns).as_bytes())?;
        for together in keyframes.chunks(KEYFRAMES_TOGETHER) {
            let points = |keyframe: &&Keyframe| self.points(keyframe, map, columns, max_relative_variance);
            for bytes in together.par_iter().map(points).collect::<Vec<_>>() {
                out.write_all(&bytes)?;
            }
        }
        Ok(count)
    }

    /// The points of one keyframe as they are written.
    fn points(
        &self,
        keyframe: &Keyframe,
        map: &Map,
        columns: Columns,
        max_relative_variance: f32,
    ) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(keyframe.semi_dense.len() * MAX_POINT_BYTES);
        for point in keyframe.world_cloud(map.camera_of(keyframe), max_relative_variance) {
            let [x, y, z] = point.position.map(|value| (value as f32).to_le_bytes()).into();
            bytes.extend_from_slice(&x);
            bytes.extend_from_slice(&y);
            bytes.extend_from_slice(&z);
            (self.attributes)(&point, columns, &mut bytes);
        }
        bytes
    }

    /// Makes a file of the cloud, see [`write`](Self::write).
    fn save(&self, path: &Path, map: &Map, max_relative_variance: f32) -> Result<usize, MapError> {
        save(path, |out| self.write(out, map, max_relative_variance))
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
