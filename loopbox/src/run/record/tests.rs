use super::*;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};
use slam_direct::TrackingState;

#[test]
fn poses_handed_out_are_those_of_one_world() {
    let row = |fragment: usize, second: u32, x: f64| FrameRow {
        index: u64::from(second),
        timestamp: f64::from(second),
        fragment,
        state: TrackingState::Tracking,
        ms: 1.0,
        latency_ms: None,
        inlier_share: 1.0,
        rmse: 1.0,
        matched_points: 100,
        keyframe: None,
        on_trial: false,
        loop_closed: None,
        handed_out: Some(Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0))),
    };
    let lost = FrameRow { handed_out: None, ..row(0, 2, 0.0) };
    let rows = [row(0, 0, 0.0), row(0, 1, 0.1), lost, row(1, 3, 7.0), row(0, 4, 0.4), row(1, 5, 7.1)];
    let times: Vec<f64> = handed_out(&rows).iter().map(|pose| pose.timestamp).collect();
    assert_eq!(times, [0.0, 1.0, 4.0]);
    assert_eq!(handed_out(&rows)[2].world_from_camera.translation.x, 0.4);
    assert!(handed_out(&[]).is_empty());
}

#[test]
fn what_is_not_used_is_reported_with_its_reason() {
    let text = |given, found| LeftOutRecord::new(LeftOut { given, found }).map(LeftOutRecord::text);
    assert_eq!(text(0.0, 0.0), None);
    let text_of = |given, found| text(given, found).unwrap_or_default();
    assert_eq!(text_of(0.1, 0.0), "10.0 % of the image is not used, by the mask");
    assert_eq!(text_of(0.0, 0.02), "2.0 % of the image is not used: it moves with the camera");
    assert_eq!(
        text_of(0.1, 0.02),
        "12.0 % of the image is not used: 2.0 % moves with the camera, the rest by the mask"
    );
}

#[test]
fn thousands_are_parted() {
    assert_eq!([0, 999, 1000, 21_918, 2_942_060].map(grouped), ["0", "999", "1,000", "21,918", "2,942,060"]);
}

#[test]
fn the_percentile_is_the_nearest_rank() {
    let cost = Cost::new((1..=200).map(f64::from).collect(), 10.0, None, None);
    assert_eq!((cost.p99_ms, cost.max_ms, cost.frames_per_s), (198.0, 200.0, 20.0));
    assert_eq!(cost.mean_ms, 100.5);
    assert_eq!(Cost::new(vec![5.0], 1.0, None, None).p99_ms, 5.0);
    assert_eq!(Cost::new(vec![], 0.0, None, None).p99_ms, 0.0);
    let latency = Latency::of((1..=200).rev().map(f64::from).collect()).unwrap();
    assert_eq!((latency.median, latency.p99, latency.max), (100.0, 198.0, 200.0));
    assert_eq!(Latency::of(vec![]), None);
}
