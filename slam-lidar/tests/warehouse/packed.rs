//! Packed sweeps of the simulated warehouse, and where its robots truly were.
//!
//! A sweep is an xz stream: `LBRI`, rings and columns (`u32`), the unit in metres (`f32`), then the low and the high
//! bytes of zigzag-coded differences of `u16` ranges along the columns, ring by ring. 0 is no return.

use geometry::Se3;
use scans::Scan;
use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};

/// A recording.
pub struct Recording {
    folder: PathBuf,
    stamps: Vec<f64>,
    /// Time and `world_from_sensor`, ascending.
    truth: Vec<(f64, Se3)>,
    /// Elevation of each ring, radians.
    elevations: Vec<f64>,
}

/// Duration of a sweep, seconds.
const PERIOD: f64 = 0.1;

impl Recording {
    /// A recording of the folder that `LOOPBOX_DATA` names, by default `shared/data` beside the repository; none, with
    /// a line that says so, where it is missing.
    pub fn open(name: &str) -> Option<Self> {
        let default_folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
        let data =
            std::env::var_os("LOOPBOX_DATA").map_or_else(|| PathBuf::from(default_folder), PathBuf::from);
        let folder = data.join("lidar/sim_warehouse").join(name);
        if !folder.is_dir() {
            eprintln!(
                "SKIPPED: {} is not here; set LOOPBOX_DATA to the folder of the sequences",
                folder.display()
            );
            return None;
        }
        let sensor = fs::read_to_string(folder.join("sensor.txt")).expect("sensor.txt");
        let elevations =
            sensor.lines().find_map(|line| line.strip_prefix("elevations_deg:")).expect("elevations");
        Some(Self {
            stamps: rows(&folder.join("times.txt")).iter().map(|row| row[0]).collect(),
            truth: rows(&folder.join("groundtruth.txt"))
                .iter()
                .map(|v| (v[0], Se3::from_tum([v[1], v[2], v[3], v[4], v[5], v[6], v[7]])))
                .collect(),
            elevations: numbers(elevations).iter().map(|degrees| degrees.to_radians()).collect(),
            folder,
        })
    }

    /// A sweep, by index.
    pub fn scan(&self, index: usize) -> Scan {
        let packed = fs::read(self.folder.join(format!("ranges/{index:06}.xz"))).expect("a packed sweep");
        let mut bytes = Vec::new();
        lzma_rs::xz_decompress(&mut packed.as_slice(), &mut bytes).expect("an xz stream");
        assert_eq!(&bytes[..4], b"LBRI");
        let word = |at: usize| [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
        let (rings, columns) = (u32::from_le_bytes(word(4)) as usize, u32::from_le_bytes(word(8)) as usize);
        let (unit, planes) = (f64::from(f32::from_le_bytes(word(12))), &bytes[16..]);
        let mut ranges = vec![0u16; rings * columns];
        for ring in 0..rings {
            let mut range = 0u16;
            for i in ring * columns..(ring + 1) * columns {
                let coded = u16::from_le_bytes([planes[i], planes[rings * columns + i]]);
                range = range.wrapping_add((coded >> 1) ^ 0u16.wrapping_sub(coded & 1));
                ranges[i] = range;
            }
        }
        let mut scan = Scan { stamp: self.stamps[index], ..Scan::default() };
        for column in 0..columns {
            let share = column as f64 / columns as f64;
            let (sin, cos) = (-TAU * share).sin_cos();
            for (ring, elevation) in self.elevations.iter().enumerate() {
                let range = f64::from(ranges[ring * columns + column]) * unit;
                if range > 0.0 {
                    let flat = range * elevation.cos();
                    scan.points.push([flat * cos, flat * sin, range * elevation.sin()].map(|v| v as f32));
                    scan.times.push((share * PERIOD) as f32);
                    scan.rings.push(ring as u16);
                }
            }
        }
        scan
    }

    /// `world_from_sensor` at an instant of the recording.
    pub fn truth_at(&self, time: f64) -> Se3 {
        let after = self.truth.partition_point(|(t, _)| *t <= time).clamp(1, self.truth.len() - 1);
        let ((t0, a), (t1, b)) = (self.truth[after - 1], self.truth[after]);
        a * Se3::exp(&((a.inverse() * b).log() * ((time - t0) / (t1 - t0))))
    }
}

fn rows(path: &Path) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(path).expect("a file of the recording");
    text.lines().filter(|line| !line.starts_with('#')).map(numbers).filter(|row| !row.is_empty()).collect()
}

fn numbers(line: &str) -> Vec<f64> {
    line.split_whitespace().map_while(|word| word.parse().ok()).collect()
}
