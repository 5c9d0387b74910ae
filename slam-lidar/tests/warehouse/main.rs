//! The libraries on sweeps of the simulated warehouse, whose truth is exact.
//!
//! They lie in the folder that `LOOPBOX_DATA` names, by default `shared/data` beside the repository; without them the
//! tests say so and pass.

mod merging;
mod packed;

use geometry::umeyama;
use packed::Recording;
use slam_lidar::odometry::{Odometry, OdometryParams};

/// Eight seconds from rest, after rigid alignment. The whole recording errs by 6 mm (root mean square).
#[test]
fn odometry_stays_within_two_centimetres() {
    let Some(recording) = Recording::open("b") else { return };
    let mut odometry = Odometry::new(OdometryParams::default());
    let (mut tracked, mut truth) = (Vec::new(), Vec::new());
    for index in 0..80 {
        let sweep = odometry.track(&recording.scan(index));
        tracked.push(sweep.world_from_sensor.translation);
        truth.push(recording.truth_at(sweep.instant).translation);
    }
    let aligned = umeyama::se3(&tracked, &truth).expect("the robot moves");
    for (index, (found, truth)) in tracked.iter().zip(&truth).enumerate() {
        let error = (aligned * *found - truth).norm();
        assert!(error < 0.02, "sweep {index}: {error:.4} m");
    }
    let path = (truth[79] - truth[0]).norm();
    assert!(path > 2.0, "the robot came no farther than {path:.1} m");
}
