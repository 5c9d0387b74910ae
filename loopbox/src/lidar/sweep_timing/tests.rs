use super::*;
use geometry::Se3;
use loopbox_tests::lidar::{HALL, PERIOD, SIXTEEN, Turning, sweep_turning, walk};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::PathBuf;

/// A recording of a sensor that turns so, without the times of its points.
struct Untimed<P> {
    info: ScanInfo,
    pose: P,
    turning: Turning,
    /// Whether other software has undistorted the scans.
    undistorted: bool,
    next: u64,
    count: u64,
}

fn untimed<P: Fn(f64) -> Se3>(pose: P, turning: Turning, count: u64) -> Untimed<P> {
    let info = ScanInfo {
        path: PathBuf::from("cast"),
        kind: "cast".into(),
        count: Some(count),
        duration: None,
        is_kitti: false,
        facts: Vec::new(),
    };
    Untimed { info, pose, turning, undistorted: false, next: 0, count }
}

impl<P: Fn(f64) -> Se3> ScanSource for Untimed<P> {
    fn info(&self) -> &ScanInfo {
        &self.info
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        let index = self.next;
        self.next += 1;
        let stamp = index as f64 * PERIOD;
        let pose = |time: f64| (self.pose)(if self.undistorted { stamp } else { time });
        let points =
            sweep_turning(&SIXTEEN, &HALL, pose, stamp, self.turning).iter().map(|r| r.point).collect();
        let scan = Ok(Scan { stamp, points, ..Scan::default() });
        (index < self.count).then_some(NextScan { index, stamp, scan })
    }
}

/// Around the hall's middle, as robots drive.
fn drive() -> impl Fn(f64) -> Se3 {
    walk(&[[-2.0, -6.0], [4.0, -6.0], [4.0, 4.0], [-14.0, 4.0]]).0
}

fn turning(counter_clockwise: bool, degrees: f64) -> Turning {
    Turning { counter_clockwise, start: degrees.to_radians() }
}

/// The rotation that is found is the sensor's, to 25° of where sweeps begin: of a sweep's points 7 % have the time of the other end then.
#[test]
fn rotations_are_found_from_the_first_seconds() {
    // A VLP-16's drivers, Ouster's, Hesai's and others', and one that begins nowhere in particular.
    let sensors = [(false, 0.0), (true, 180.0), (false, -90.0), (true, 33.0)];
    for (counter_clockwise, degrees) in sensors {
        let mut source = untimed(drive(), turning(counter_clockwise, degrees), 75);
        let found = point_times(&mut source, ScanTiming::Found);
        let PointTimes::Derived(timing, Why::Fits { share, other }) = found else {
            panic!("{counter_clockwise} {degrees}: {}", found.text())
        };
        let spin = if counter_clockwise { Spin::CounterClockwise } else { Spin::Clockwise };
        let off = (timing.start_azimuth.to_degrees() - degrees as f32 + 180.0).rem_euclid(360.0) - 180.0;
        eprintln!("{counter_clockwise} {degrees}: {} off {off:.0}", found.text());
        assert_eq!(timing.spin, spin, "{degrees}: {}", found.text());
        assert!(off.abs() < 25.0 && share > other, "{degrees}: {}", found.text());
    }
}

#[test]
fn what_the_scans_do_not_determine_is_reported() {
    let still = |_: f64| Se3::identity();
    let mut source = untimed(still, turning(false, 0.0), 60);
    assert_eq!(point_times(&mut source, ScanTiming::Found), PointTimes::Rigid(Why::AtRest));
    let mut source = Untimed { undistorted: true, ..untimed(drive(), turning(false, 0.0), 75) };
    let found = point_times(&mut source, ScanTiming::Found);
    assert!(matches!(found, PointTimes::Rigid(Why::Undistorted | Why::Unclear)), "{}", found.text());
    let mut source = untimed(still, turning(false, 0.0), 60);
    source.info.is_kitti = true;
    let found = point_times(&mut source, ScanTiming::Found);
    assert_eq!(found.timing(), Some(SweepTiming::default()), "{}", found.text());
    assert!(found.text().contains("KITTI"), "{}", found.text());
}

/// A folder that is laid out as KITTI's may hold another sensor's scans.
#[test]
fn a_layout_is_not_believed_against_the_scans() {
    let mut source = untimed(drive(), turning(true, 0.0), 75);
    source.info.is_kitti = true;
    let found = point_times(&mut source, ScanTiming::Found);
    assert_eq!(found.timing().map(|timing| timing.spin), Some(Spin::CounterClockwise), "{}", found.text());
    let mut source = untimed(drive(), turning(false, 180.0), 75);
    source.info.is_kitti = true;
    let found = point_times(&mut source, ScanTiming::Found);
    assert_eq!(found.timing(), Some(SweepTiming::default()), "{}", found.text());
}

#[test]
fn what_is_given_is_taken() {
    let mut source = untimed(|_| Se3::identity(), turning(false, 0.0), 60);
    let wanted = "ccw,90,end".parse().unwrap();
    let found = point_times(&mut source, wanted);
    let timing = found.timing().unwrap();
    assert_eq!((timing.spin, timing.stamp_at), (Spin::CounterClockwise, StampAt::End));
    source.next = 0;
    assert_eq!(point_times(&mut source, ScanTiming::Rigid), PointTimes::Rigid(Why::Given));
    // Once a turn of the head: rotation alone tells it as well.
    let motion = |time: f64| {
        Se3::new(
            UnitQuaternion::from_scaled_axis(Vector3::z() * (0.8 * time)),
            Vector3::new(-10.0, -6.0, 0.0),
        )
    };
    let mut source = untimed(motion, turning(true, 180.0), 60);
    let found = point_times(&mut source, ScanTiming::Found);
    assert_eq!(found.timing().map(|timing| timing.spin), Some(Spin::CounterClockwise), "{}", found.text());
}
