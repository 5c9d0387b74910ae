//! The data for Foxglove: each part of a map in Foxglove's own schemas.

use super::KEYFRAME_FRAME;
use crate::{DEFAULT_MAX_RELATIVE_VARIANCE, Keyframe, KeyframeId, Map, Scan, StampedPose};
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, FrameTransforms, PackedElementField, PointCloud,
    Pose, PosesInFrame, Quaternion, Timestamp, Vector3,
};
use geometry::{Pinhole, Se3};

/// The world's coordinate frame.
const WORLD: &str = "world";
/// A keyframe's cloud is thinned to about this many points: enough to look at, a fraction of the
/// exact data's size.
const VIEW_POINTS: usize = 8192;
/// The clouds of all keyframes together: more than viewers draw, and of a large map more bytes than all that is exact.
const ALL_VIEW_POINTS: usize = 20_000_000;
/// Bytes of a point: x, y, z and confidence as floats, intensity as a byte.
const POINT_STRIDE: u32 = 17;
/// Bytes of a scan's point: x, y and z as floats.
const SCAN_STRIDE: u32 = 12;

/// Nanoseconds of a time stamp in seconds; times before 0 become 0.
pub(super) fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Foxglove's form of a time stamp in seconds.
fn timestamp(seconds: f64) -> Option<Timestamp> {
    let nanoseconds = nanoseconds(seconds);
    let sec = u32::try_from(nanoseconds / 1_000_000_000).unwrap_or(u32::MAX);
    Some(Timestamp::new(sec, (nanoseconds % 1_000_000_000) as u32))
}

/// The name of a keyframe's coordinate frame.
pub(super) fn keyframe_frame(id: KeyframeId) -> String {
    format!("{KEYFRAME_FRAME}{}", id.0)
}

/// The keyframe that a coordinate frame belongs to.
pub(super) fn keyframe_of_frame(name: &str) -> Option<KeyframeId> {
    name.strip_prefix(KEYFRAME_FRAME)?.parse().ok().map(KeyframeId)
}

/// The camera without distortion: the images are undistorted.
pub(super) fn calibration(camera: &Pinhole, frame: &str, time: f64) -> CameraCalibration {
    let Pinhole { fx, fy, cx, cy, .. } = *camera;
    CameraCalibration {
        timestamp: timestamp(time),
        frame_id: frame.into(),
        width: u32::try_from(camera.width).unwrap_or(u32::MAX),
        height: u32::try_from(camera.height).unwrap_or(u32::MAX),
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..Default::default()
    }
}

/// A keyframe's image; this one is also what the map is read back from.
pub(super) fn image(keyframe: &Keyframe, png: Vec<u8>) -> CompressedImage {
    CompressedImage {
        timestamp: timestamp(keyframe.timestamp),
        frame_id: keyframe_frame(keyframe.id),
        data: png.into(),
        format: "png".into(),
    }
}

/// How many points the cloud of each of so many keyframes has, at the most.
pub(super) fn points_each(keyframes: usize) -> usize {
    (ALL_VIEW_POINTS / keyframes.max(1)).clamp(1, VIEW_POINTS)
}

/// A keyframe's cloud, thinned to `most` points, in its coordinate frame. Foxglove's frames have no scale, so the
/// points are in map units.
pub(super) fn cloud(keyframe: &Keyframe, camera: &Pinhole, most: usize) -> PointCloud {
    let scale = keyframe.world_from_keyframe.scale;
    let mut data = Vec::with_capacity(most * POINT_STRIDE as usize);
    // To look at, the image as it is will do.
    for point in keyframe.sparse_cloud(camera, DEFAULT_MAX_RELATIVE_VARIANCE, most) {
        for value in point.position.iter() {
            data.extend(((value * scale) as f32).to_le_bytes());
        }
        data.extend(point.confidence.to_le_bytes());
        data.push(point.intensity);
    }
    PointCloud {
        timestamp: timestamp(keyframe.timestamp),
        frame_id: keyframe_frame(keyframe.id),
        pose: Some(pose(&Se3::identity())),
        point_stride: POINT_STRIDE,
        fields: vec![
            field("x", 0, NumericType::Float32),
            field("y", 4, NumericType::Float32),
            field("z", 8, NumericType::Float32),
            field("confidence", 12, NumericType::Float32),
            field("intensity", 16, NumericType::Uint8),
        ],
        data: data.into(),
    }
}

/// A LiDAR keyframe's scan, thinned to `most` points, in its coordinate frame.
pub(super) fn scan_cloud(keyframe: &Keyframe, scan: &Scan, most: usize) -> PointCloud {
    let step = scan.len().div_ceil(most).max(1);
    let scale = keyframe.world_from_keyframe.scale;
    let value = |value: f32| ((f64::from(value) * scale) as f32).to_le_bytes();
    let data: Vec<u8> = scan.points().step_by(step).flatten().flat_map(value).collect();
    PointCloud {
        timestamp: timestamp(keyframe.timestamp),
        frame_id: keyframe_frame(keyframe.id),
        pose: Some(pose(&Se3::identity())),
        point_stride: SCAN_STRIDE,
        fields: vec![
            field("x", 0, NumericType::Float32),
            field("y", 4, NumericType::Float32),
            field("z", 8, NumericType::Float32),
        ],
        data: data.into(),
    }
}

/// What a point has at an offset.
fn field(name: &str, offset: u32, kind: NumericType) -> PackedElementField {
    PackedElementField { name: name.into(), offset, r#type: kind as i32 }
}

/// Where all keyframes are in the world.
pub(super) fn keyframe_transforms(map: &Map, time: f64) -> FrameTransforms {
    let transform = |keyframe: &Keyframe| {
        transform(keyframe_frame(keyframe.id), &keyframe.world_from_keyframe.rigid(), time)
    };
    FrameTransforms { transforms: map.keyframes.values().map(transform).collect() }
}

/// Where a camera or LiDAR is in the world at a time.
pub(super) fn sensor_transform(frame: &str, world_from_sensor: &Se3, time: f64) -> FrameTransforms {
    FrameTransforms { transforms: vec![transform(frame.into(), world_from_sensor, time)] }
}

/// A whole trajectory.
pub(super) fn trajectory(trajectory: &[StampedPose], time: f64) -> PosesInFrame {
    let poses = trajectory.iter().map(|stamped| pose(&stamped.world_from_camera)).collect();
    PosesInFrame { timestamp: timestamp(time), frame_id: WORLD.into(), poses }
}

/// The transform from a coordinate frame to the world.
fn transform(child: String, world_from_child: &Se3, time: f64) -> FrameTransform {
    let Pose { position, orientation } = pose(world_from_child);
    FrameTransform {
        timestamp: timestamp(time),
        parent_frame_id: WORLD.into(),
        child_frame_id: child,
        translation: position,
        rotation: orientation,
    }
}

/// Foxglove's form of a rigid motion.
fn pose(motion: &Se3) -> Pose {
    let [x, y, z, qx, qy, qz, qw] = motion.to_tum();
    Pose { position: Some(Vector3 { x, y, z }), orientation: Some(Quaternion { x: qx, y: qy, z: qz, w: qw }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::sample_map;
    use geometry::sensor::Shift;

    #[test]
    fn cloud_and_transform_agree_with_the_map() {
        let map = sample_map(2);
        let (id, keyframe) = map.keyframes.iter().next_back().unwrap();
        let cloud = cloud(keyframe, map.camera(keyframe), VIEW_POINTS);
        let displayed = cloud.data.len() / POINT_STRIDE as usize;
        let camera = map.camera(keyframe);
        let expected: Vec<_> =
            keyframe.cloud(camera, Shift::none(*camera), DEFAULT_MAX_RELATIVE_VARIANCE).collect();
        assert_eq!(displayed, expected.len());
        let float = |at: usize| f64::from(f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap()));
        let local = nalgebra::Vector3::new(float(0), float(4), float(8));
        let world = keyframe.world_from_keyframe * expected[0].position;
        assert!((keyframe.world_from_keyframe.rigid() * local - world).norm() < 1e-5);
        assert_eq!(keyframe_of_frame(&cloud.frame_id), Some(*id));
    }

    #[test]
    fn clouds_of_many_keyframes_are_no_more_than_viewers_draw() {
        assert_eq!([0, 1, 2441].map(points_each), [VIEW_POINTS; 3]);
        assert_eq!(points_each(10_000), 2000);
        assert_eq!(points_each(usize::MAX), 1);
        let map = sample_map(1);
        let (_, keyframe) = map.keyframes.iter().next().unwrap();
        let points = cloud(keyframe, map.camera(keyframe), 3).data.len() / POINT_STRIDE as usize;
        assert!((1..=3).contains(&points), "{points}");
    }

    #[test]
    fn times_out_of_range_do_not_panic() {
        for time in [f64::NAN, f64::NEG_INFINITY, -1.0, 1e300] {
            let _ = timestamp(time);
        }
        assert_eq!(nanoseconds(1.5), 1_500_000_000);
        assert_eq!(nanoseconds(-1.5), 0);
    }
}
