//! Messages as drivers write them.

use super::{Encoding, MessageKind};
use crate::Scan;

/// Bytes as ROS 1 or CDR put them.
struct Writer {
    bytes: Vec<u8>,
    encoding: Encoding,
}

impl Writer {
    fn new(encoding: Encoding) -> Self {
        let bytes = if encoding == Encoding::Cdr { vec![0, 1, 0, 0] } else { Vec::new() };
        Self { bytes, encoding }
    }

    fn put(&mut self, raw: &[u8]) -> &mut Self {
        if self.encoding == Encoding::Cdr {
            let at = (self.bytes.len() - 4).next_multiple_of(raw.len().max(1)) + 4;
            self.bytes.resize(at, 0);
        }
        self.bytes.extend(raw);
        self
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.put(&value.to_le_bytes())
    }

    fn string(&mut self, text: &str) -> &mut Self {
        let end: &[u8] = if self.encoding == Encoding::Cdr { &[0] } else { &[] };
        self.u32((text.len() + end.len()) as u32);
        self.bytes.extend(text.bytes().chain(end.iter().copied()));
        self
    }

    fn header(&mut self) -> &mut Self {
        if self.encoding == Encoding::Ros1 {
            self.u32(7);
        }
        self.u32(1_700_000_000).u32(500_000_000).string("lidar")
    }
}

/// A hall's points with times after the sweep's start and rings.
fn points() -> Vec<([f32; 3], f32, u16)> {
    let point = |i: u32| {
        let azimuth = (i / 8) as f32 * -0.06;
        (
            [6.0 * azimuth.cos(), 6.0 * azimuth.sin(), (i % 8) as f32 * 0.3 - 1.0],
            i as f32 * 1e-4,
            (i % 8) as u16,
        )
    };
    (0..800).map(point).collect()
}

/// A cloud whose fields beside the position are `time` and `ring`, each a name, a type and how its value is written.
fn cloud(
    encoding: Encoding,
    (time, time_kind): (&str, u8),
    in_time: impl Fn(f32) -> Vec<u8>,
    ring: &str,
) -> Vec<u8> {
    let size = in_time(0.0).len();
    let mut out = Writer::new(encoding);
    out.header().u32(1).u32(800);
    let (ring_at, time_at) = (16, 24);
    let fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), (ring, ring_at, 4), (time, time_at, time_kind)];
    out.u32(fields.len() as u32);
    for (name, offset, kind) in fields {
        out.string(name).u32(offset).put(&[kind]).u32(1);
    }
    let step = time_at + size as u32;
    out.put(&[0]).u32(step).u32(step * 800).u32(step * 800);
    for (p, t, r) in points() {
        let mut point = vec![0; step as usize];
        for (i, v) in p.iter().enumerate() {
            point[4 * i..4 * i + 4].copy_from_slice(&v.to_le_bytes());
        }
        point[ring_at as usize..ring_at as usize + 2].copy_from_slice(&r.to_le_bytes());
        point[time_at as usize..].copy_from_slice(&in_time(t));
        out.bytes.extend(point);
    }
    out.put(&[1]);
    out.bytes
}

#[track_caller]
fn assert_read(scan: &Scan) {
    assert!((scan.stamp - 1_700_000_000.5).abs() < 1e-6, "{}", scan.stamp);
    assert_eq!((scan.points.len(), scan.times.len(), scan.rings.len()), (800, 800, 800));
    for (i, (p, t, r)) in points().into_iter().enumerate() {
        assert_eq!((scan.points[i], scan.rings[i]), (p, r));
        assert!((scan.times[i] - t).abs() < 1e-5, "{i}: {} instead of {t}", scan.times[i]);
    }
}

#[test]
fn clouds_of_every_driver_read_the_same() {
    let stamp = 1_700_000_000.5f64;
    for encoding in [Encoding::Ros1, Encoding::Cdr] {
        let clouds = [
            // Velodyne, Ouster, Hesai and Robosense, Livox.
            cloud(encoding, ("time", 7), |t| t.to_le_bytes().into(), "ring"),
            cloud(encoding, ("t", 6), |t| ((f64::from(t) * 1e9).round() as u32).to_le_bytes().into(), "ring"),
            cloud(encoding, ("timestamp", 8), |t| (stamp + f64::from(t)).to_le_bytes().into(), "ring"),
            cloud(
                encoding,
                ("timestamp", 8),
                |t| ((stamp + f64::from(t)) * 1e9).to_le_bytes().into(),
                "line",
            ),
        ];
        for bytes in clouds {
            assert_read(&MessageKind::PointCloud2.read(encoding, &bytes, "test").unwrap());
            assert_eq!(MessageKind::PointCloud2.stamp(encoding, &bytes), Some(stamp));
        }
    }
}

#[test]
fn livox_points_have_times_and_lines() {
    for encoding in [Encoding::Ros1, Encoding::Cdr] {
        let mut out = Writer::new(encoding);
        out.header().put(&77u64.to_le_bytes()).u32(800).put(&[1]).put(&[0]).put(&[0]).put(&[0]).u32(800);
        for (p, t, r) in points() {
            out.u32((f64::from(t) * 1e9).round() as u32);
            for v in p {
                out.put(&v.to_le_bytes());
            }
            out.put(&[9]).put(&[0]).put(&[r as u8]);
        }
        assert_read(&MessageKind::Livox.read(encoding, &out.bytes, "test").unwrap());
    }
}

#[test]
fn foxglove_clouds_are_read() {
    fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
        let mut out = vec![number << 3 | 2];
        let mut length = bytes.len();
        while length >= 0x80 {
            out.push(length as u8 | 0x80);
            length >>= 7;
        }
        out.push(length as u8);
        out.extend(bytes);
        out
    }
    let element = |name: &str, offset: u32, kind: u8| {
        let offset = [&[2 << 3 | 5][..], &offset.to_le_bytes()].concat();
        field(5, &[field(1, name.as_bytes()), offset, vec![3 << 3, kind]].concat())
    };
    let stamp = [&[1 << 3][..], &[0x80, 0xe2, 0xcf, 0xaa, 0x06], &[2 << 3], &[0x80, 0xca, 0xb5, 0xee, 0x01]];
    let mut data = Vec::new();
    for (p, t, r) in points() {
        p.iter().for_each(|v| data.extend(v.to_le_bytes()));
        data.extend(t.to_le_bytes());
        data.extend(r.to_le_bytes());
    }
    let fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("time", 12, 7), ("ring", 16, 3)];
    let bytes = [
        field(1, &stamp.concat()),
        field(2, b"lidar"),
        [&[4 << 3 | 5][..], &18u32.to_le_bytes()].concat(),
        fields.iter().flat_map(|&(name, offset, kind)| element(name, offset, kind)).collect(),
        field(6, &data),
    ]
    .concat();
    assert_read(&MessageKind::Foxglove.read(Encoding::Protobuf, &bytes, "test").unwrap());
    assert!(MessageKind::Foxglove.stamp(Encoding::Protobuf, &bytes).is_some());
    for length in 0..bytes.len() - 1 {
        let _ = MessageKind::Foxglove.read(Encoding::Protobuf, &bytes[..length], "test");
    }
}

#[test]
fn cut_and_changed_messages_are_refused_or_read() {
    let bytes = cloud(Encoding::Cdr, ("time", 7), |t| t.to_le_bytes().into(), "ring");
    for length in 0..bytes.len() - 4 {
        let error = MessageKind::PointCloud2.read(Encoding::Cdr, &bytes[..length], "test");
        assert!(error.is_err(), "{length}");
    }
    for at in 0..400.min(bytes.len()) {
        for value in [0, 0x7f, 0xff] {
            let mut changed = bytes.clone();
            changed[at] = value;
            let _ = MessageKind::PointCloud2.read(Encoding::Cdr, &changed, "test");
            let _ = MessageKind::Livox.read(Encoding::Cdr, &changed, "test");
        }
    }
}
