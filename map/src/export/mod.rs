//! Maps in the formats of other tools: point clouds (PLY, PCD) and trajectories (TUM, KITTI).
//!
//! Each format has a function that writes to any [`Write`] and one that makes a file which is either
//! whole or as it was before.

mod cloud;
mod pcd;
mod ply;
mod trajectory;

pub use cloud::{CloudPoint, DEFAULT_MAX_RELATIVE_VARIANCE};
pub use pcd::{save_pcd, write_pcd};
pub use ply::{save_ply, write_ply};
pub use trajectory::{save_kitti, save_tum, write_kitti, write_tum};

use crate::{MapError, atomic::write_atomically};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Makes the file `path` with `fill`, whole or not at all.
fn save<T>(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> Result<T, MapError> {
    write_atomically(path, fill).map_err(|source| MapError::write(path, source))
}

/// Writes a position as three little-endian floats.
fn write_position(out: &mut impl Write, point: &CloudPoint) -> io::Result<()> {
    for value in point.position.iter() {
        out.write_all(&(*value as f32).to_le_bytes())?;
    }
    Ok(())
}
