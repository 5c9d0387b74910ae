//! Points as named columns of numbers: what PCD and PLY have in common.

use crate::sweep_times::{SWEEP, interval};
use crate::{Scan, ScanError, is_return};

/// The type of a column's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Signed integers of so many bytes.
    Signed(usize),
    /// Unsigned integers of so many bytes.
    Unsigned(usize),
    /// Floating point of 4 or 8 bytes.
    Float(usize),
}

impl Kind {
    /// Bytes of a number.
    pub fn size(self) -> usize {
        match self {
            Self::Signed(n) | Self::Unsigned(n) | Self::Float(n) => n,
        }
    }

    /// The number at the start of `bytes`, which holds at least [`size`](Self::size).
    pub fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut raw = [0u8; 8];
        let n = self.size();
        for (i, slot) in raw[..n].iter_mut().enumerate() {
            *slot = bytes[if big_endian { n - 1 - i } else { i }];
        }
        let bits = u64::from_le_bytes(raw);
        match self {
            Self::Unsigned(_) => bits as f64,
            Self::Signed(n) => (((bits << (64 - 8 * n)) as i64) >> (64 - 8 * n)) as f64,
            Self::Float(4) => f32::from_bits(bits as u32) as f64,
            Self::Float(_) => f64::from_bits(bits),
        }
    }
}

/// A named column.
#[derive(Clone, Debug)]
pub(crate) struct Column {
    /// Its name in the file.
    pub name: String,
    /// Type of its numbers.
    pub kind: Kind,
    /// Numbers per point; only the first is read.
    pub count: usize,
}

/// Where in a point the numbers lie that make a scan.
pub(crate) struct Roles {
    position: [usize; 3],
    time: Option<usize>,
    ring: Option<usize>,
}

/// Names of the time of a point among sensors' drivers: Velodyne, Ouster, Hesai and Robosense, Livox.
const TIME_NAMES: [&str; 7] =
    ["time", "t", "timestamp", "offset_time", "time_offset", "timeoffset", "timestamp_ns"];
/// Names of the ring of a point.
const RING_NAMES: [&str; 5] = ["ring", "channel", "line", "laser_id", "row"];

impl Roles {
    /// Columns by their places.
    pub fn at(position: [usize; 3], time: Option<usize>, ring: Option<usize>) -> Self {
        Self { position, time, ring }
    }

    /// Finds the columns by their names.
    pub fn find(columns: &[Column], name: &str) -> Result<Self, ScanError> {
        let find = |names: &[&str]| {
            columns.iter().position(|c| names.iter().any(|n| c.name.eq_ignore_ascii_case(n)))
        };
        let axis = |axis: &str| {
            find(&[axis])
                .ok_or_else(|| ScanError::format(name, format!("there is no column `{axis}` of positions")))
        };
        Ok(Self {
            position: [axis("x")?, axis("y")?, axis("z")?],
            time: find(&TIME_NAMES),
            ring: find(&RING_NAMES),
        })
    }
}

/// A scan that grows point by point.
pub(crate) struct Gathering {
    roles: Roles,
    scan: Scan,
    times: Vec<f64>,
}

impl Gathering {
    pub fn new(roles: Roles) -> Self {
        Self { roles, scan: Scan::default(), times: Vec::new() }
    }

    /// Adds a point whose numbers `value` gives by column.
    pub fn push(&mut self, value: impl Fn(usize) -> f64) {
        self.scan.points.push(self.roles.position.map(|c| value(c) as f32));
        if let Some(c) = self.roles.time {
            self.times.push(value(c));
        }
        if let Some(c) = self.roles.ring {
            self.scan.rings.push(value(c).clamp(0.0, f64::from(u16::MAX)) as u16);
        }
    }

    /// The scan, its times in seconds after `stamp`; times of no known unit are dropped.
    pub fn finish(mut self, stamp: f64) -> Scan {
        self.scan.stamp = stamp;
        self.scan.times = seconds(&self.times, &self.scan.points, stamp).unwrap_or_default();
        self.scan
    }
}

/// Times of any unit as seconds after `stamp`.
///
/// The unit is the one that makes a sweep last as long as sweeps do. Times that are larger than a sweep are those of
/// a clock: the stamp's if they lie near it, otherwise they count from the first. Points that are none, and single times far from
/// all others, have no say in it.
fn seconds(times: &[f64], points: &[[f32; 3]], stamp: f64) -> Option<Vec<f32>> {
    let of_point = |(time, point): (&f64, &[f32; 3])| if is_return(point) { *time } else { f64::NAN };
    let ([early, late], length) = interval(times.iter().zip(points).map(of_point))?;
    let unit = [1.0, 1e-3, 1e-6, 1e-9].into_iter().find(|u| (SWEEP.0..=SWEEP.1).contains(&(length * u)))?;
    let of_sweep =
        times.iter().zip(points).filter(|(time, point)| (early..=late).contains(*time) && is_return(point));
    let first = of_sweep.map(|(time, _)| *time).fold(f64::INFINITY, f64::min);
    let offset = match first * unit {
        start if start.abs() <= SWEEP.1 => 0.0,
        start if (start - stamp).abs() <= SWEEP.1 => stamp / unit,
        _ => first,
    };
    Some(times.iter().map(|t| ((t - offset) * unit) as f32).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_known_by_the_length_of_a_sweep() {
        let check = |times: [f64; 3], stamp: f64, expected: [f32; 3]| {
            let found = seconds(&times, &[[1.0; 3]; 3], stamp).unwrap();
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{times:?}: {found:?}");
        };
        check([0.0, 0.05, 0.1], 12.0, [0.0, 0.05, 0.1]);
        check([-0.1, -0.05, 0.0], 12.0, [-0.1, -0.05, 0.0]);
        check([0.0, 5e4, 1e5], 12.0, [0.0, 0.05, 0.1]);
        check([0.0, 5e7, 1e8], 12.0, [0.0, 0.05, 0.1]);
        check([1.7e9, 1.7e9 + 0.05, 1.7e9 + 0.1], 1.7e9 + 0.1, [-0.1, -0.05, 0.0]);
        check([7e8, 7e8 + 0.05, 7e8 + 0.1], 12.0, [0.0, 0.05, 0.1]);
        assert_eq!(seconds(&[0.0, 0.0], &[[1.0; 3]; 2], 1.0), None);
    }

    #[test]
    fn a_stale_time_and_points_that_are_none_leave_the_others_theirs() {
        let mut times: Vec<f64> = (0..4000).map(|i| 1.7e9 + 0.1 * f64::from(i) / 4000.0).collect();
        let mut points = vec![[3.0f32, 4.0, 0.5]; 4000];
        times[17] = 0.0;
        times[1800..2000].fill(0.0);
        points[1800..2000].fill([0.0; 3]);
        points[5] = [f32::NAN; 3];
        times[5] = 9e18;
        let found = seconds(&times, &points, 1.7e9).unwrap();
        assert!((found[3999] - 0.1).abs() < 1e-3 && found[0].abs() < 1e-6, "{} {}", found[0], found[3999]);
        // A sweep whose first packet still has the time of the sweep before, in nanoseconds.
        let mut times: Vec<f64> = (0..4000).map(|i| 2.5e4 * f64::from(i)).collect();
        times[..40].fill(-1e8);
        let found = seconds(&times, &[[1.0; 3]; 4000], 12.0).unwrap();
        assert!(
            (found[3999] - 0.1).abs() < 1e-3 && (found[40] - 0.001).abs() < 1e-4,
            "{} {}",
            found[40],
            found[3999]
        );
    }

    #[test]
    fn numbers_are_read_in_either_order() {
        assert_eq!(Kind::Signed(2).read(&(-7i16).to_le_bytes(), false), -7.0);
        assert_eq!(Kind::Unsigned(4).read(&9u32.to_be_bytes(), true), 9.0);
        assert_eq!(Kind::Float(4).read(&1.5f32.to_le_bytes(), false), 1.5);
        assert_eq!(Kind::Float(8).read(&(-2.5f64).to_be_bytes(), true), -2.5);
    }
}
