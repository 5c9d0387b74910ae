//! Poses as `nav_msgs/msg/Odometry`, and the frame `odom` that is never corrected.

use crate::frames::pose;
use crate::messages::{
    Covariance, Header, Odometry, PoseWithCovariance, Time, Twist, TwistWithCovariance, Vector3,
};
use geometry::Se3;

/// A pose and the velocity there, as a message. How sure they are is not known.
pub fn odometry(frame: &str, child: &str, stamp: Time, frame_from_child: &Se3, twist: Twist) -> Odometry {
    Odometry {
        header: Header { stamp, frame_id: frame.into() },
        child_frame_id: child.into(),
        pose: PoseWithCovariance { pose: pose(frame_from_child), covariance: Covariance::UNKNOWN },
        twist: TwistWithCovariance { twist, covariance: Covariance::UNKNOWN },
    }
}

/// The velocity of a body that moved by `before_from_now` in so many seconds, in its own axes: constant, along a screw.
/// None where no time went by.
pub fn velocity(before_from_now: &Se3, seconds: f64) -> Twist {
    if seconds.is_nan() || seconds <= 0.0 {
        return Twist::default();
    }
    let twist = before_from_now.log() / seconds;
    let part = |first: usize| Vector3 { x: twist[first], y: twist[first + 1], z: twist[first + 2] };
    Twist { linear: part(0), angular: part(3) }
}

/// Where a body is by its motions alone (REP 105, `odom`): what is found out later about where it was, a loop that was
/// closed say, moves the map under it, not the body.
#[derive(Clone, Debug, Default)]
pub struct Odometer {
    last: Option<(f64, Se3)>,
}

/// Where a body is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Its pose by its motions.
    pub odom_from_body: Se3,
    /// What brings these to the map.
    pub map_from_odom: Se3,
    /// Its velocity in its own axes, units of length and radians a second.
    pub twist: Twist,
}

impl Odometer {
    /// Takes in where a body is at a time in seconds, and where it was at the time of the call before as it is known now,
    /// both in the map. Without the latter nothing is known of the motion, and there is none. At first it is where the
    /// map has it.
    pub fn advance(&mut self, time: f64, map_from_body: &Se3, map_from_before: Option<&Se3>) -> Reading {
        let (odom_from_body, twist) = match (&self.last, map_from_before) {
            (None, _) => (*map_from_body, Twist::default()),
            (Some((_, pose)), None) => (*pose, Twist::default()),
            (Some((before, pose)), Some(map_from_before)) => {
                let before_from_now = map_from_before.inverse() * *map_from_body;
                // Of products of thousands of rotations none is one any more.
                let moved = (*pose * before_from_now).renormalized();
                (moved, velocity(&before_from_now, time - before))
            }
        };
        self.last = Some((time, odom_from_body));
        Reading { odom_from_body, map_from_odom: *map_from_body * odom_from_body.inverse(), twist }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    fn apart(a: &Se3, b: &Se3) -> f64 {
        (a.inverse() * *b).log().norm()
    }

    #[test]
    fn a_velocity_is_a_motion_over_its_time() {
        let twist = Vector6::new(0.4, -0.2, 0.1, 0.3, 0.2, -0.5);
        let found = velocity(&Se3::exp(&(twist * 0.1)), 0.1);
        let numbers = [found.linear, found.angular].map(|v| [v.x, v.y, v.z]).concat();
        assert!(numbers.iter().zip(twist.iter()).all(|(a, b)| (a - b).abs() < 1e-12), "{numbers:?}");
        for seconds in [0.0, -1.0, f64::NAN] {
            assert_eq!(velocity(&Se3::exp(&twist), seconds), Twist::default());
        }
    }

    /// A loop moves all that was mapped: `map` jumps against `odom`, and the body does not.
    #[test]
    fn a_correction_moves_the_map_and_not_the_body() {
        let step = Se3::exp(&Vector6::new(0.1, 0.0, 0.02, 0.0, 0.01, 0.03));
        let correction = Se3::exp(&Vector6::new(-0.5, 0.3, 0.0, 0.0, 0.0, 0.4));
        let mut odometer = Odometer::default();
        let mut pose = Se3::exp(&Vector6::new(1.0, 2.0, 3.0, 0.1, 0.2, 0.3));
        let first = odometer.advance(10.0, &pose, None);
        assert!(apart(&first.odom_from_body, &pose) < 1e-12);
        assert!(apart(&first.map_from_odom, &Se3::identity()) < 1e-12);
        let mut before = first;
        for i in 1..20 {
            // What was before is known otherwise from the tenth on.
            let map_from_before = if i == 10 { correction * pose } else { pose };
            pose = map_from_before * step;
            let reading = odometer.advance(10.0 + 0.1 * f64::from(i), &pose, Some(&map_from_before));
            assert!(apart(&(before.odom_from_body * step), &reading.odom_from_body) < 1e-9);
            assert!(apart(&(reading.map_from_odom * reading.odom_from_body), &pose) < 1e-9);
            let expected = if i < 10 { Se3::identity() } else { correction };
            assert!(apart(&reading.map_from_odom, &expected) < 1e-9);
            before = reading;
        }
        // Another map of which nothing is known: the body stays.
        let other = Se3::identity();
        let reading = odometer.advance(13.0, &other, None);
        assert!(apart(&reading.odom_from_body, &before.odom_from_body) < 1e-12);
        assert!(apart(&(reading.map_from_odom * reading.odom_from_body), &other) < 1e-12);
        assert_eq!(reading.twist, Twist::default());
    }
}
