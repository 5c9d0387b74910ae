//! The odometry in a room of boxes with the truth known.

use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::odometry::{Odometry, OdometryParams, TrackedSweep};
use geometry::Se3;
use loopbox_tests::lidar::{PERIOD, sweep, walk};
use loopbox_tests::lidar_paths::{Carried, Carrier};
use loopbox_tests::lidar_sensors::Sensor;
use loopbox_tests::lidar_sites::{hall, office};
use loopbox_tests::lidar_stairs::stairs;
use nalgebra::{Vector3, Vector6};
use scans::Scan;

/// Boxes by least and largest corner: the room, seen from inside, and what stands in it.
const BOXES: [([f64; 3], [f64; 3]); 4] = [
    ([-12.0, -8.0, -1.0], [12.0, 8.0, 4.0]),
    ([3.0, 2.0, -1.0], [4.0, 3.5, 2.0]),
    ([-5.0, -4.0, -1.0], [-4.2, -3.0, 4.0]),
    ([6.0, -5.0, -1.0], [8.0, -4.0, 1.0]),
];

/// Distance along a ray to the nearest box.
fn cast(origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
    let mut nearest = f64::INFINITY;
    for (least, most) in BOXES {
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..3 {
            let a = (least[axis] - origin[axis]) / direction[axis];
            let b = (most[axis] - origin[axis]) / direction[axis];
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        if enter <= leave && leave > 0.0 {
            nearest = nearest.min(if enter > 0.0 { enter } else { leave });
        }
    }
    nearest
}

/// The sensor drives and turns ever faster, up to 2 m/s and 60°/s within two seconds.
fn truth(time: f64) -> Se3 {
    let path = 0.5 * time * time;
    Se3::new(
        nalgebra::UnitQuaternion::from_scaled_axis(Vector3::z() * 0.25 * time * time),
        Vector3::new(path, 0.2 * path, 0.0),
    )
}

fn scan(index: usize) -> Scan {
    let mut scan = Scan { stamp: index as f64 * 0.1, ..Scan::default() };
    for column in 0..900 {
        let time = f64::from(column) / 9000.0;
        let pose = truth(scan.stamp + time);
        for ring in 0..16u16 {
            let (azimuth, elevation) =
                (-f64::from(column).to_radians() * 0.4, f64::from(2 * i32::from(ring) - 15).to_radians());
            let local = Vector3::new(
                azimuth.cos() * elevation.cos(),
                azimuth.sin() * elevation.cos(),
                elevation.sin(),
            );
            let range = cast(&pose.translation, &(pose.rotation * local));
            scan.points.push([0, 1, 2].map(|i| (local[i] * range) as f32));
            scan.times.push(time as f32);
            scan.rings.push(ring);
        }
    }
    scan
}

fn track(count: usize) -> Vec<TrackedSweep> {
    let mut odometry = Odometry::new(OdometryParams::default());
    (0..count).map(|i| odometry.track(&scan(i))).collect()
}

#[test]
fn a_robot_that_starts_and_turns_is_tracked_and_its_sweeps_are_undistorted() {
    let tracked = track(20);
    let world = truth(tracked[0].instant);
    for (i, sweep) in tracked.iter().enumerate() {
        let error = (world.inverse() * truth(sweep.instant)).inverse() * sweep.world_from_sensor;
        assert!(error.translation.norm() < 0.02, "sweep {i}: {:.4} m", error.translation.norm());
        assert!(
            error.rotation.angle().to_degrees() < 0.2,
            "sweep {i}: {:.3} deg",
            error.rotation.angle().to_degrees()
        );
        assert_eq!(sweep.conditioning.weak, 0);
    }
    // The last sweep moves by 0.2 m and turns by 5°; 95 % of its points come out within 3 cm of where they were.
    let (last, found) = (scan(19), tracked[19].motion);
    let sweep = Sweep::of(&last, (0.5, 100.0));
    let exact = |share: f64| world.inverse() * truth(last.stamp + share * f64::from(last.span().1));
    let off = |motion: &SweepMotion| -> f32 {
        let points = sweep.undistorted(&MotionTable::new(motion, &Se3::identity()));
        let mut errors: Vec<f32> = Vec::new();
        for (i, p) in points.iter().enumerate() {
            let q = sweep.points[i].map(f64::from);
            let q = exact(f64::from(sweep.shares[i])) * Vector3::from(q);
            errors.push((0..3).map(|k| (p[k] - q[k] as f32).powi(2)).sum::<f32>().sqrt());
        }
        errors.sort_by(f32::total_cmp);
        errors[errors.len() * 95 / 100]
    };
    assert!(off(&found) < 0.03, "{}", off(&found));
    assert!(off(&SweepMotion::resting(exact(0.5))) > 0.1, "the sweep is hardly distorted");
}

#[test]
fn the_same_scans_give_the_same_bits() {
    let bits = |tracked: Vec<TrackedSweep>| -> Vec<u64> {
        tracked.iter().flat_map(|s| s.world_from_sensor.to_tum().map(f64::to_bits)).collect()
    };
    assert_eq!(bits(track(6)), bits(track(6)));
}

#[test]
fn a_sensor_that_was_carried_away_is_lost_and_changes_nothing() {
    let mut odometry = Odometry::new(OdometryParams::default());
    assert!((0..8).all(|i| !odometry.track(&scan(i)).lost));
    let before = odometry.clone();
    // What no place of the room shows.
    let mut elsewhere = scan(8);
    elsewhere.points.iter_mut().for_each(|p| *p = [p[1] + 3.0, p[0] - 2.0, p[2] * 1.5]);
    assert!(odometry.track(&elsewhere).lost);
    assert_eq!(odometry.map().len(), before.map().len());
    let found = odometry.track(&scan(9));
    let expected = before.clone().track(&scan(9));
    assert!(!found.lost && found.world_from_sensor.to_tum() == expected.world_from_sensor.to_tum());
}

#[test]
fn a_sensor_that_turned_on_while_sweeps_are_missing_is_found() {
    let mut odometry = Odometry::new(OdometryParams::default());
    let tracked: Vec<TrackedSweep> = (0..10).map(|i| odometry.track(&scan(i))).collect();
    let found = odometry.track(&scan(19));
    let truth = truth(tracked[0].instant).inverse() * truth(found.instant);
    let off = truth.inverse() * found.world_from_sensor;
    assert!(!found.lost && off.translation.norm() < 0.05 && off.rotation.angle() < 0.01, "{off:?}");
}

#[test]
fn a_clock_that_was_set_ahead_moves_no_sensor() {
    for ahead in [5.0, 60.0, 3600.0] {
        let mut odometry = Odometry::new(OdometryParams::default());
        let scans =
            (0..20).map(|i| Scan { stamp: 0.1 * i as f64 + if i < 10 { 0.0 } else { ahead }, ..scan(i) });
        let tracked: Vec<TrackedSweep> = scans.map(|scan| odometry.track(&scan)).collect();
        for (i, found) in tracked.iter().enumerate() {
            let instant = found.instant - if i < 10 { 0.0 } else { ahead };
            let off =
                (truth(tracked[0].instant).inverse() * truth(instant)).inverse() * found.world_from_sensor;
            assert!(!found.lost && off.translation.norm() < 0.03, "{ahead} s, sweep {i}: {off:?}");
        }
    }
}

#[test]
fn a_start_at_speed_is_found() {
    // The same room at 12 m/s straight ahead: 1.2 m between the first two sweeps.
    let speed = Vector6::new(12.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let at = |time: f64| {
        Se3::new(nalgebra::UnitQuaternion::identity(), Vector3::new(-8.0, 0.0, 0.0))
            * Se3::exp(&(speed * time))
    };
    let mut odometry = Odometry::new(OdometryParams::default());
    for index in 0..4 {
        let mut moving = scan(0);
        moving.stamp = f64::from(index) * 0.1;
        for (point, time) in moving.points.iter_mut().zip(&moving.times) {
            let direction = Vector3::from(point.map(f64::from)).normalize();
            let pose = at(moving.stamp + f64::from(*time));
            let local = direction * cast(&pose.translation, &direction);
            *point = [0, 1, 2].map(|i| local[i] as f32);
        }
        let found = odometry.track(&moving);
        if index > 0 {
            let error = found.world_from_sensor.translation.x - 1.2 * f64::from(index);
            assert!(error.abs() < 0.05, "sweep {index}: {error:.3} m");
        }
    }
}

/// A corridor 2.2 m wide and a hall in which walls are far: each ring leaves one line on their floors at first, and what is
/// seen next lies beside it. Maps began here half a metre off and tilted by 6°, and 3 cm and 0.6°.
#[test]
fn a_floor_seen_by_a_few_rings_keeps_a_map_level_from_its_first_metre_on() {
    for (site, name) in [(office(200, 201), "corridor"), (hall(100), "hall")] {
        let (pose, _) = walk(&site.paths[0]);
        let mut odometry = Odometry::new(OdometryParams::default());
        let mut world = None;
        for stamp in (0..26).map(|index| f64::from(index) * PERIOD) {
            let returns = sweep(&site.boxes, &pose, stamp);
            let found = odometry.track(&Scan {
                stamp,
                points: returns.iter().map(|r| r.point).collect(),
                times: returns.iter().map(|r| r.time).collect(),
                rings: returns.iter().map(|r| u16::from(r.ring)).collect(),
                ..Scan::default()
            });
            let truth = pose(found.instant);
            let world = world.get_or_insert(truth * found.world_from_sensor.inverse());
            let error = (*world * found.world_from_sensor).inverse() * truth;
            let (off, turned) = (error.translation.norm(), error.rotation.angle().to_degrees());
            assert!(off < 0.015 && turned < 0.25, "{name}, {stamp:.1} s: {off:.3} m, {turned:.2} deg");
        }
    }
}

/// Errors of so many scans of a Mid-360 that is carried along a path through boxes: how far off, metres, how much turned, degrees; none is lost.
fn errors_of(boxes: &[[[f64; 3]; 2]], path: &Carried, scans: usize) -> Vec<(f64, f64)> {
    let mut odometry = Odometry::new(OdometryParams::default());
    let mut world = None;
    let error = |index: usize| {
        let stamp = index as f64 * PERIOD;
        let sensed = Sensor::Mid360.sweep(boxes, |time| path.at(time), stamp);
        let found = odometry.track(&Scan {
            stamp,
            points: sensed.iter().map(|s| s.point).collect(),
            times: sensed.iter().map(|s| s.time).collect(),
            ..Scan::default()
        });
        assert!(!found.lost, "{stamp:.1} s");
        let truth = path.at(found.instant);
        let world = world.get_or_insert(truth * found.world_from_sensor.inverse());
        let error = (*world * found.world_from_sensor).inverse() * truth;
        (error.translation.norm(), error.rotation.angle().to_degrees())
    };
    (0..scans).map(error).collect()
}

/// From a corridor onto the first landing: the ends of sweeps gape by what turning quickly bends them, more than 0.002 rad. Held
/// closer, the error of one end came back in the next with the other sign and twice as large, 29° after 6 s, and nothing was lost.
#[test]
fn a_person_who_turns_on_stairs_keeps_the_map() {
    let (boxes, corners) = stairs(101);
    let errors = errors_of(&boxes, &Carried::along(&corners, 0.9, Carrier::BackPack), 75);
    assert!(errors.iter().all(|&(off, turned)| off < 0.1 && turned < 1.5), "{errors:?}");
}

/// On the first flight the pitch that was predicted errs by 3° from one sweep to the next. One sweep stayed in the wrong place, 1.5° off, and led the
/// next one farther astray: 70° after 1.2 s, and all scans had a pose.
#[test]
fn a_sweep_that_stays_in_the_wrong_place_is_sought_elsewhere() {
    let (boxes, corners) = stairs(100);
    let errors = errors_of(&boxes, &Carried::along(&corners, 0.9, Carrier::Hand), 175);
    assert!(errors.iter().all(|&(off, turned)| off < 0.1 && turned < 5.0), "{errors:?}");
}
