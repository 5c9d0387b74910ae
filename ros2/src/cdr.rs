//! Messages as bytes.

use byteorder::LittleEndian;
use serde::Serialize;

/// What says how the rest is encoded: plain CDR, little-endian, no options (RTPS 2.3, §10.2).
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Encodes a message as ROS 2 has it on the wire and in bags: the four bytes of the encapsulation, then CDR (XCDR1),
/// aligned from behind these.
///
/// # Errors
/// When a text or list is longer than 4 GiB.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, cdr_encoding::Error> {
    let mut bytes = ENCAPSULATION.to_vec();
    cdr_encoding::to_writer::<T, LittleEndian, _>(&mut bytes, message)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::*;

    /// Bytes put together by the rules of CDR: a number begins at a multiple of its size.
    #[derive(Default)]
    struct Expected(Vec<u8>);

    impl Expected {
        fn aligned(mut self, bytes: &[u8]) -> Self {
            while !self.0.len().is_multiple_of(bytes.len()) {
                self.0.push(0);
            }
            self.0.extend(bytes);
            self
        }

        fn u32(self, value: u32) -> Self {
            self.aligned(&value.to_le_bytes())
        }

        fn f64s(self, values: &[f64]) -> Self {
            values.iter().fold(self, |own, value| own.aligned(&value.to_le_bytes()))
        }

        fn text(self, text: &str) -> Self {
            let mut own = self.u32(text.len() as u32 + 1);
            own.0.extend(text.bytes().chain([0]));
            own
        }

        fn bytes(mut self, bytes: &[u8]) -> Self {
            self.0.extend(bytes);
            self
        }

        fn header(self) -> Self {
            self.u32(7).u32(8).text("yard/map")
        }
    }

    fn header() -> Header {
        Header { stamp: Time { sec: 7, nanosec: 8 }, frame_id: "yard/map".into() }
    }

    fn transform() -> Transform {
        Transform {
            translation: Vector3 { x: 1.0, y: 2.0, z: 3.0 },
            rotation: Quaternion { x: 0.5, y: -0.5, z: 0.5, w: -0.5 },
        }
    }

    const NUMBERS: [f64; 7] = [1.0, 2.0, 3.0, 0.5, -0.5, 0.5, -0.5];

    #[test]
    fn diagnostics_are_a_list_of_levels_texts_and_values() {
        let values = vec![KeyValue { key: "times lost".into(), value: "2".into() }];
        let status = DiagnosticStatus {
            level: Level::Error,
            name: "tracking".into(),
            message: "lost".into(),
            hardware_id: "yard".into(),
            values,
        };
        let message = DiagnosticArray { header: header(), status: vec![status] };
        let expected = Expected::default().header().u32(1).bytes(&[2]);
        let expected = expected.text("tracking").text("lost").text("yard");
        let expected = expected.u32(1).text("times lost").text("2");
        assert_eq!(encode(&message).unwrap()[4..], expected.0);
    }

    #[test]
    fn transforms_are_a_list_of_frames_and_numbers() {
        let child = |name: &str| TransformStamped {
            header: header(),
            child_frame_id: name.into(),
            transform: transform(),
        };
        let message = TfMessage { transforms: vec![child("yard/odom"), child("c")] };
        let expected = Expected::default()
            .u32(2)
            .header()
            .text("yard/odom")
            .f64s(&NUMBERS)
            .header()
            .text("c")
            .f64s(&NUMBERS);
        assert_eq!(encode(&message).unwrap(), [&ENCAPSULATION[..], &expected.0].concat());
    }

    #[test]
    fn odometry_is_a_pose_and_a_velocity_with_arrays_of_covariances() {
        let covariance = Covariance(std::array::from_fn(|i| i as f64));
        let velocity =
            Twist { linear: Vector3 { x: 4.0, y: 5.0, z: 6.0 }, angular: Vector3 { x: 7.0, y: 8.0, z: 9.0 } };
        let message = Odometry {
            header: header(),
            child_frame_id: "yard/camera".into(),
            pose: PoseWithCovariance { pose: transform(), covariance },
            twist: TwistWithCovariance { twist: velocity, covariance: Covariance::UNKNOWN },
        };
        let expected = Expected::default()
            .header()
            .text("yard/camera")
            .f64s(&NUMBERS)
            .f64s(&covariance.0)
            .f64s(&[4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
            .f64s(&[0.0; 36]);
        assert_eq!(encode(&message).unwrap(), [&ENCAPSULATION[..], &expected.0].concat());
    }

    #[test]
    fn clouds_are_fields_and_bytes() {
        let field = |name: &str, offset| PointField {
            name: name.into(),
            offset,
            datatype: PointField::FLOAT32,
            count: 1,
        };
        let message = PointCloud2 {
            header: header(),
            height: 1,
            width: 2,
            fields: vec![field("x", 0), field("intensity", 12)],
            is_bigendian: false,
            point_step: 3,
            row_step: 6,
            data: vec![9, 8, 7, 6, 5, 4],
            is_dense: true,
        };
        let expected = Expected::default()
            .header()
            .u32(1)
            .u32(2)
            .u32(2)
            .text("x")
            .u32(0)
            .bytes(&[7])
            .u32(1)
            .text("intensity")
            .u32(12)
            .bytes(&[7])
            .u32(1)
            .bytes(&[0])
            .u32(3)
            .u32(6)
            .u32(6)
            .bytes(&[9, 8, 7, 6, 5, 4])
            .bytes(&[1]);
        assert_eq!(encode(&message).unwrap(), [&ENCAPSULATION[..], &expected.0].concat());
    }
}
