//! Times and rings of points, where the file does not say them.

use crate::Scan;
use std::f32::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

/// Which way a sensor turns, seen from above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spin {
    /// Azimuth falls with time: Velodyne and most others.
    Clockwise,
    /// Azimuth grows with time.
    CounterClockwise,
}

/// The instant of a sweep to which its stamp belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampAt {
    /// The first point.
    Start,
    /// The sensor faces the middle of its turn: KITTI.
    Middle,
    /// The last point.
    End,
}

/// How a sensor turns: enough to tell a point's time from its direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepTiming {
    /// Duration of a sweep, seconds.
    pub period: f32,
    /// Which way it turns.
    pub spin: Spin,
    /// What the stamp means.
    pub stamp_at: StampAt,
    /// Azimuth at which a sweep begins, radians from x towards y.
    pub start_azimuth: f32,
}

impl Default for SweepTiming {
    /// KITTI's Velodyne: ten clockwise turns a second that begin at the rear, the stamp when it faces forward.
    fn default() -> Self {
        Self { period: 0.1, spin: Spin::Clockwise, stamp_at: StampAt::Middle, start_azimuth: PI }
    }
}

impl SweepTiming {
    /// Time of a point, seconds after the stamp.
    pub fn time_of(&self, point: [f32; 3]) -> f32 {
        let azimuth = point[1].atan2(point[0]);
        let turned = match self.spin {
            Spin::Clockwise => self.start_azimuth - azimuth,
            Spin::CounterClockwise => azimuth - self.start_azimuth,
        };
        let before = match self.stamp_at {
            StampAt::Start => 0.0,
            StampAt::Middle => 0.5,
            StampAt::End => 1.0,
        };
        (turned.rem_euclid(TAU) / TAU - before) * self.period
    }

    /// Gives every point of a scan the time at which the sensor looked its way.
    pub fn apply(&self, scan: &mut Scan) {
        scan.times = scan.points.iter().map(|&p| self.time_of(p)).collect();
    }
}

/// How the times of points are told that their recording does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ScanTiming {
    /// By what fits the first seconds best.
    #[default]
    Found,
    /// There are none: scans are undistorted already.
    Rigid,
    /// As of KITTI's Velodyne.
    Kitti,
    /// By how the sensor turns; a sweep lasts as long as scans are apart.
    Turning {
        /// Which way.
        spin: Spin,
        /// Azimuth at which a sweep begins, radians from x towards y.
        start_azimuth: f32,
        /// What the stamp means.
        stamp_at: StampAt,
    },
}

/// What a word for it is.
const TIMING_FIX: &str = "give auto, rigid, kitti, or how the sensor turns: clockwise or counter-clockwise, where it begins in \
     degrees from x towards y, and whether the stamp is its begin, middle or end, as clockwise,180,middle";

impl FromStr for ScanTiming {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => return Ok(Self::Found),
            "rigid" => return Ok(Self::Rigid),
            "kitti" => return Ok(Self::Kitti),
            _ => {}
        }
        let mut words = text.split(',').map(str::trim);
        let spin = match words.next() {
            Some("clockwise" | "cw") => Spin::Clockwise,
            Some("counter-clockwise" | "ccw") => Spin::CounterClockwise,
            _ => return Err(TIMING_FIX.into()),
        };
        let degrees =
            words.next().and_then(|word| word.parse::<f32>().ok()).filter(|angle| angle.is_finite());
        let start_azimuth = degrees.ok_or(TIMING_FIX)?.to_radians();
        let stamp_at = match words.next() {
            None | Some("begin") => StampAt::Start,
            Some("middle") => StampAt::Middle,
            Some("end") => StampAt::End,
            Some(_) => return Err(TIMING_FIX.into()),
        };
        if words.next().is_some() {
            return Err(TIMING_FIX.into());
        }
        Ok(Self::Turning { spin, start_azimuth, stamp_at })
    }
}

impl fmt::Display for SweepTiming {
    /// `clockwise from 180°, 0.100 s, stamp in the middle`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let spin = match self.spin {
            Spin::Clockwise => "clockwise",
            Spin::CounterClockwise => "counter-clockwise",
        };
        let stamp = match self.stamp_at {
            StampAt::Start => "at the begin",
            StampAt::Middle => "in the middle",
            StampAt::End => "at the end",
        };
        let degrees = self.start_azimuth.to_degrees().rem_euclid(360.0);
        write!(f, "{spin} from {degrees:.0}°, {:.3} s, stamp {stamp}", self.period)
    }
}

/// Fewest and most rings that a derivation is believed to have found: the sensors there are.
const RINGS: std::ops::RangeInclusive<usize> = 4..=256;

/// The ring of each point of a scan that is stored ring by ring, as KITTI's are; empty when it is not.
///
/// A ring ends where the direction passes the azimuth at which rings begin, ahead or behind the sensor: the one of
/// the two where the elevation changes more. It must do so as often as sensors have rings; in a scan stored firing by
/// firing it does once.
pub fn rings_of(points: &[[f32; 3]]) -> Vec<u16> {
    let behind = cut_at(points, |p| p[1].atan2(p[0]));
    let ahead = cut_at(points, |p| (-p[1]).atan2(-p[0]));
    let (rings, _) = if ahead.1 > behind.1 { ahead } else { behind };
    let found = rings.last().map_or(0, |&ring| ring as usize + 1);
    if RINGS.contains(&found) && found * LEAST_POINTS_OF_A_RING <= points.len() { rings } else { Vec::new() }
}

/// Fewest points of a ring on average; less and the cuts are noise.
const LEAST_POINTS_OF_A_RING: usize = 64;

/// Rings that end where `azimuth` wraps, and the mean change of elevation there.
fn cut_at(points: &[[f32; 3]], azimuth: impl Fn(&[f32; 3]) -> f32) -> (Vec<u16>, f32) {
    let elevation = |p: &[f32; 3]| p[2].atan2(p[0].hypot(p[1]));
    let mut rings = Vec::with_capacity(points.len());
    let (mut ring, mut change) = (0u16, 0.0);
    for (i, p) in points.iter().enumerate() {
        if let Some(last) = i.checked_sub(1).map(|i| &points[i])
            && (azimuth(p) - azimuth(last)).abs() > PI
        {
            ring = ring.saturating_add(1);
            change += (elevation(p) - elevation(last)).abs();
        }
        rings.push(ring);
    }
    (rings, change / f32::from(ring.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kitti_faces_forward_at_its_stamp_and_left_before() {
        let timing = SweepTiming::default();
        assert!(timing.time_of([1.0, 0.0, 0.0]).abs() < 1e-6);
        assert!((timing.time_of([0.0, 1.0, 0.0]) + 0.025).abs() < 1e-6);
        assert!((timing.time_of([0.0, -1.0, 0.0]) - 0.025).abs() < 1e-6);
        let other = SweepTiming {
            spin: Spin::CounterClockwise,
            stamp_at: StampAt::Start,
            start_azimuth: 0.0,
            ..timing
        };
        assert!((other.time_of([0.0, 1.0, 0.0]) - 0.025).abs() < 1e-6);
    }

    #[test]
    fn the_sense_of_rotation_can_be_given() {
        let turning = |spin, degrees: f32, stamp_at| {
            Ok(ScanTiming::Turning { spin, start_azimuth: degrees.to_radians(), stamp_at })
        };
        assert_eq!("auto".parse(), Ok(ScanTiming::Found));
        assert_eq!("clockwise,180,middle".parse(), turning(Spin::Clockwise, 180.0, StampAt::Middle));
        assert_eq!("ccw, -90".parse(), turning(Spin::CounterClockwise, -90.0, StampAt::Start));
        assert_eq!("cw,0,end".parse(), turning(Spin::Clockwise, 0.0, StampAt::End));
        for text in ["", "clockwise", "cw,x", "cw,nan", "cw,1,half", "cw,1,end,2", "left,3"] {
            assert!(
                text.parse::<ScanTiming>().is_err_and(|error| error.contains("clockwise,180,middle")),
                "{text}"
            );
        }
        assert_eq!(SweepTiming::default().to_string(), "clockwise from 180°, 0.100 s, stamp in the middle");
    }

    /// Points on rings that begin at an azimuth, ring by ring or firing by firing, and their rings.
    fn sweep(by_ring: bool, start: f32) -> (Vec<[f32; 3]>, Vec<u16>) {
        let (rings, columns) = (8usize, 360usize);
        let point = |ring: usize, column: usize| {
            let azimuth = start - TAU * (column as f32 + 0.5) / columns as f32;
            ([azimuth.cos(), azimuth.sin(), 0.1 * ring as f32], ring as u16)
        };
        let all: Vec<_> = if by_ring {
            (0..rings).flat_map(|r| (0..columns).map(move |c| point(r, c))).collect()
        } else {
            (0..columns).flat_map(|c| (0..rings).map(move |r| point(r, c))).collect()
        };
        all.into_iter().unzip()
    }

    #[test]
    fn rings_are_found_where_points_lie_ring_by_ring() {
        for start in [0.0, PI] {
            let (points, rings) = sweep(true, start);
            assert_eq!(rings_of(&points), rings, "rings that begin at {start}");
            assert!(rings_of(&sweep(false, start).0).is_empty());
        }
    }
}
