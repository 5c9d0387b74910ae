//! Points as `sensor_msgs/msg/PointCloud2`.

use crate::messages::{Header, PointCloud2, PointField, Time};
use nalgebra::Vector3;

/// Bytes of a number.
const NUMBER: u32 = 4;

/// Points in the frame `frame`, with `x`, `y`, `z` in its unit and, where `with_intensity`, the intensity (0–255) as
/// fourth, all as floats: what viewers show without being told anything.
pub fn cloud(
    frame: &str,
    stamp: Time,
    points: impl Iterator<Item = (Vector3<f64>, u8)>,
    with_intensity: bool,
) -> PointCloud2 {
    let names = if with_intensity { &["x", "y", "z", "intensity"][..] } else { &["x", "y", "z"] };
    let mut data = Vec::with_capacity(points.size_hint().0 * names.len() * NUMBER as usize);
    for (position, intensity) in points {
        position.iter().for_each(|value| data.extend((*value as f32).to_le_bytes()));
        if with_intensity {
            data.extend(f32::from(intensity).to_le_bytes());
        }
    }
    let field = |(name, offset): (&&str, u32)| PointField {
        name: (*name).into(),
        offset: offset * NUMBER,
        datatype: PointField::FLOAT32,
        count: 1,
    };
    let point_step = names.len() as u32 * NUMBER;
    PointCloud2 {
        header: Header { stamp, frame_id: frame.into() },
        height: 1,
        width: data.len() as u32 / point_step,
        fields: names.iter().zip(0..).map(field).collect(),
        is_bigendian: false,
        point_step,
        row_step: data.len() as u32,
        data,
        is_dense: true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_floats_one_after_another() {
        let points = || [(Vector3::new(1.0, -2.0, 0.5), 7), (Vector3::new(3.0, 4.0, 5.0), 255)].into_iter();
        let stamp = Time { sec: 1, nanosec: 2 };
        let found = cloud("yard/map", stamp, points(), true);
        assert_eq!((found.height, found.width, found.point_step, found.row_step), (1, 2, 16, 32));
        let numbers: Vec<f32> =
            found.data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        assert_eq!(numbers, [1.0, -2.0, 0.5, 7.0, 3.0, 4.0, 5.0, 255.0]);
        let offsets: Vec<_> = found.fields.iter().map(|field| (field.name.as_str(), field.offset)).collect();
        assert_eq!(offsets, [("x", 0), ("y", 4), ("z", 8), ("intensity", 12)]);
        let plain = cloud("yard/map", stamp, points(), false);
        assert_eq!((plain.width, plain.point_step, plain.fields.len(), plain.data.len()), (2, 12, 3, 24));
        assert_eq!(cloud("yard/map", stamp, points().take(0), true).width, 0);
    }
}
