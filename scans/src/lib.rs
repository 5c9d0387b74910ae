//! Scans of spinning LiDARs: what a sweep is, how it is read from files, and how the time and the ring of each
//! point are found where a file does not say.
//!
//! Read in this order: [`Scan`] (here), [`folder`](Folder) (which files make a recording), [`ScanSource`] (scans in order, wherever they lie), `kitti`, `pcd` and
//! `ply` (one format each, all through `columns`), [`MessageKind`] (messages of recordings), `timing` (times and rings that are derived); [`tables`] of times and names.
//!
//! The frame is the sensor's: x forward, y left, z up, metres; times are seconds.

mod bin_layout;
mod columns;
mod contents;
mod error;
mod folder;
mod kitti;
mod lzf;
mod messages;
mod pcd;
mod ply;
mod source;
mod sweep_times;
pub mod tables;
mod timing;

pub use bin_layout::{BinLayout, Sample, layout_of};
pub use contents::{FolderContents, folder_contents};
pub use error::ScanError;
pub use folder::{Folder, FolderOptions, ScanFile};
pub use kitti::{read_bin, read_kitti};
pub use messages::{Encoding, MessageKind};
pub use pcd::read_pcd;
pub use ply::read_ply;
pub use source::{FolderSource, NextScan, ScanInfo, ScanSource};
pub use timing::{ScanTiming, Spin, StampAt, SweepTiming, rings_of};

use sweep_times::interval;

/// One sweep of a LiDAR, points in the order of the sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// The scan's stamp on the recording's clock, seconds.
    pub stamp: f64,
    /// Points in the sensor's frame at the time of each point, metres; finite.
    pub points: Vec<[f32; 3]>,
    /// Time of each point, seconds after [`stamp`](Self::stamp); may be negative. As long as `points`, or empty where
    /// it is not known.
    pub times: Vec<f32>,
    /// Ring (laser) of each point. As long as `points`, or empty where it is not known.
    pub rings: Vec<u16>,
    /// Points that were left out since their times are not of this sweep.
    pub stale: usize,
}

impl Scan {
    /// The instants of the first and the last point, seconds after the stamp; both 0 without times.
    pub fn span(&self) -> (f32, f32) {
        let ends =
            self.times.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), &t| (a.min(t), b.max(t)));
        if self.times.is_empty() { (0.0, 0.0) } else { ends }
    }

    /// The same scan with only the points for which `keep` holds, given by index.
    pub fn retain(&mut self, keep: impl Fn(&Self, usize) -> bool) {
        let kept: Vec<usize> = (0..self.points.len()).filter(|&i| keep(self, i)).collect();
        if kept.len() == self.points.len() {
            return;
        }
        self.points = kept.iter().map(|&i| self.points[i]).collect();
        if !self.times.is_empty() {
            self.times = kept.iter().map(|&i| self.times[i]).collect();
        }
        if !self.rings.is_empty() {
            self.rings = kept.iter().map(|&i| self.rings[i]).collect();
        }
    }

    /// Refuses a scan from which no pose can come, and drops points that are not finite, lie in the sensor, or have times that are
    /// not of the sweep; the last are counted.
    ///
    /// # Errors
    /// [`ScanError::TooFew`] and [`ScanError::Flat`] say why a scan is of no use.
    pub fn checked(mut self, name: &str) -> Result<Self, ScanError> {
        let read = self.points.len();
        self.retain(|scan, i| is_return(&scan.points[i]));
        self.drop_stale();
        if self.points.len() < LEAST_POINTS {
            return Err(ScanError::TooFew { name: name.into(), read, usable: self.points.len() });
        }
        if is_flat(&self.points) {
            return Err(ScanError::Flat { name: name.into() });
        }
        Ok(self)
    }
}

impl Scan {
    /// Drops points whose times are not of the sweep.
    fn drop_stale(&mut self) {
        let Some(([early, late], _)) = interval(self.times.iter().map(|time| f64::from(*time))) else {
            return;
        };
        let before = self.points.len();
        self.retain(|scan, i| {
            scan.times.get(i).is_none_or(|time| (early..=late).contains(&f64::from(*time)))
        });
        self.stale += before - self.points.len();
    }
}

/// Whether a point is one: finite, and not in the sensor.
pub(crate) fn is_return(point: &[f32; 3]) -> bool {
    let squared = point.iter().map(|v| v * v).sum::<f32>();
    squared.is_finite() && squared > LEAST_RANGE * LEAST_RANGE
}

/// Fewest usable points of a scan. A sixteenth of the returns of the sparsest common sensor, 16 rings of 400.
pub const LEAST_POINTS: usize = 400;
/// Returns nearer than this come from the sensor itself or are none, metres.
const LEAST_RANGE: f32 = 0.1;
/// Directions of a scan must spread by this sine of an angle out of every plane through the sensor: less is one ring.
const LEAST_SPREAD: f64 = 0.01;

/// Whether all directions lie in one plane: the scan of a single ring, which leaves pitch, roll and height open.
fn is_flat(points: &[[f32; 3]]) -> bool {
    let mut moments = nalgebra::Matrix3::<f64>::zeros();
    for p in points {
        let direction = nalgebra::Vector3::new(p[0] as f64, p[1] as f64, p[2] as f64).normalize();
        moments += direction * direction.transpose();
    }
    let least = moments.symmetric_eigenvalues().min().max(0.0);
    (least / points.len() as f64).sqrt() < LEAST_SPREAD
}
