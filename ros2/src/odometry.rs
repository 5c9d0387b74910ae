//! Poses as `nav_msgs/msg/Odometry`, and the frame `odom` that is never corrected.

use crate::frames::pose;
use crate::messages::{
    Covariance, Header, Odometry, PoseWithCovariance, Time, Twist, TwistWithCovariance, Vector3,
};
use geometry::Se3;
use nalgebra::{Matrix6, UnitQuaternion};

/// A pose and the velocity there, as a message, of which nothing says how certain they are.
pub fn odometry(frame: &str, child: &str, stamp: Time, frame_from_child: &Se3, twist: Twist) -> Odometry {
    Odometry {
        header: Header { stamp, frame_id: frame.into() },
        child_frame_id: child.into(),
        pose: PoseWithCovariance { pose: pose(frame_from_child), covariance: Covariance::UNKNOWN },
        twist: TwistWithCovariance { twist, covariance: Covariance::UNKNOWN },
    }
}

impl Odometry {
    /// The same, with what is known of how certain it is.
    pub fn known_to(mut self, certainty: &Certainty) -> Self {
        (self.pose.covariance, self.twist.covariance) = (certainty.pose, certainty.twist);
        self
    }
}

/// How certain a pose and a velocity are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certainty {
    /// Of the pose, in the axes of the frame that it is in.
    pub pose: Covariance,
    /// Of the velocity, in the axes of the body.
    pub twist: Covariance,
}

impl Certainty {
    /// Nothing says so.
    pub const UNKNOWN: Self = Self { pose: Covariance::UNKNOWN, twist: Covariance::UNKNOWN };
}

/// A covariance of `(υ, ω)` in axes that `rotation` maps these to: `Ad P Adᵀ`.
pub fn rotated(covariance: &Matrix6<f64>, rotation: &UnitQuaternion<f64>) -> Matrix6<f64> {
    let adjoint = Se3::new(*rotation, Default::default()).adjoint();
    adjoint * covariance * adjoint.transpose()
}

impl From<&Matrix6<f64>> for Covariance {
    /// It is symmetric, so that rows are columns.
    fn from(covariance: &Matrix6<f64>) -> Self {
        Self(std::array::from_fn(|i| covariance[i]))
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
    /// Covariance of the pose then, in the axes of the body.
    last_covariance: Option<Matrix6<f64>>,
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
    /// How certain the pose is against what is in view, and the velocity. What the motions add up to err is not in it.
    pub certainty: Certainty,
}

/// Where a body is.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Its pose in the map.
    pub map_from_body: Se3,
    /// Covariance of that, in the axes of the body; `None` where it is not known.
    pub covariance: Option<Matrix6<f64>>,
}

impl Odometer {
    /// Takes in where a body is at a time in seconds, and where it was at the time of the call before as it is known now,
    /// both in the map. Without the latter nothing is known of the motion, and there is none. At first it is where the
    /// map has it.
    pub fn advance(&mut self, time: f64, place: &Place, map_from_before: Option<&Se3>) -> Reading {
        let Place { map_from_body, covariance } = place;
        let certainty_of_twist = self.twist_covariance(time, place, map_from_before);
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
        self.last_covariance = *covariance;
        let in_odom = covariance.map(|covariance| rotated(&covariance, &odom_from_body.rotation));
        let stated =
            |known: Option<Matrix6<f64>>| known.as_ref().map_or(Covariance::UNKNOWN, Covariance::from);
        let certainty = Certainty { pose: stated(in_odom), twist: stated(certainty_of_twist) };
        Reading { odom_from_body, map_from_odom: *map_from_body * odom_from_body.inverse(), twist, certainty }
    }

    /// Covariance of the velocity since the call before: both poses err for themselves.
    fn twist_covariance(
        &self,
        time: f64,
        place: &Place,
        map_from_before: Option<&Se3>,
    ) -> Option<Matrix6<f64>> {
        let (before, now) = (self.last_covariance?, place.covariance?);
        let seconds = time - self.last?.0;
        let now_from_before = place.map_from_body.rotation.inverse() * map_from_before?.rotation;
        (seconds > 0.0).then(|| (now + rotated(&before, &now_from_before)) / (seconds * seconds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    fn apart(a: &Se3, b: &Se3) -> f64 {
        (a.inverse() * *b).log().norm()
    }

    fn at(map_from_body: Se3) -> Place {
        Place { map_from_body, covariance: None }
    }

    /// A body that faces along y of the frame, and is uncertain along its own x, is so along the frame's y.
    #[test]
    fn covariances_are_in_the_axes_of_their_frames() {
        let quarter = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2));
        let own = Matrix6::from_diagonal(&Vector6::new(4.0, 1.0, 2.0, 0.04, 0.01, 0.02));
        let mut odometer = Odometer::default();
        let first = odometer.advance(1.0, &Place { map_from_body: quarter, covariance: Some(own) }, None);
        let diagonal = |covariance: &Covariance| [0, 1, 2, 3, 4, 5].map(|i| covariance.0[7 * i]);
        let close = |found: [f64; 6], wanted: [f64; 6]| {
            assert!(
                found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12),
                "{found:?}, not {wanted:?}"
            );
        };
        close(diagonal(&first.certainty.pose), [1.0, 4.0, 2.0, 0.01, 0.04, 0.02]);
        assert_eq!(first.certainty.twist, Covariance::UNKNOWN);
        // It turned back by a quarter in half a second: its x is where its y was.
        let now = Place { map_from_body: Se3::identity(), covariance: Some(own) };
        let second = odometer.advance(1.5, &now, Some(&quarter));
        let expected =
            [4.0 + 1.0, 1.0 + 4.0, 2.0 + 2.0, 0.04 + 0.01, 0.01 + 0.04, 0.02 + 0.02].map(|v| v / 0.25);
        close(diagonal(&second.certainty.twist), expected);
        assert_eq!(odometer.advance(2.0, &at(quarter), Some(&quarter)).certainty, Certainty::UNKNOWN);
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
        let first = odometer.advance(10.0, &at(pose), None);
        assert!(apart(&first.odom_from_body, &pose) < 1e-12);
        assert!(apart(&first.map_from_odom, &Se3::identity()) < 1e-12);
        let mut before = first;
        for i in 1..20 {
            // What was before is known otherwise from the tenth on.
            let map_from_before = if i == 10 { correction * pose } else { pose };
            pose = map_from_before * step;
            let reading = odometer.advance(10.0 + 0.1 * f64::from(i), &at(pose), Some(&map_from_before));
            assert!(apart(&(before.odom_from_body * step), &reading.odom_from_body) < 1e-9);
            assert!(apart(&(reading.map_from_odom * reading.odom_from_body), &pose) < 1e-9);
            let expected = if i < 10 { Se3::identity() } else { correction };
            assert!(apart(&reading.map_from_odom, &expected) < 1e-9);
            before = reading;
        }
        // Another map of which nothing is known: the body stays.
        let other = Se3::identity();
        let reading = odometer.advance(13.0, &at(other), None);
        assert!(apart(&reading.odom_from_body, &before.odom_from_body) < 1e-12);
        assert!(apart(&(reading.map_from_odom * reading.odom_from_body), &other) < 1e-12);
        assert_eq!(reading.twist, Twist::default());
    }
}
