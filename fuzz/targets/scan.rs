//! Scans of LiDARs: files by their kinds, and messages.
#![no_main]

use scans::{Encoding, MessageKind, read_kitti, read_pcd, read_ply};

libfuzzer_sys::fuzz_target!(|input: (u8, &[u8])| {
    let (kind, data) = input;
    let message = |kind: MessageKind, encoding| drop(kind.read(encoding, data, "scan"));
    match kind % 8 {
        0 => drop(read_kitti(data, "scan")),
        1 => drop(read_pcd(data, 1.0, "scan")),
        2 => drop(read_ply(data, 1.0, "scan")),
        3 => message(MessageKind::PointCloud2, Encoding::Cdr),
        4 => message(MessageKind::PointCloud2, Encoding::Ros1),
        5 => message(MessageKind::Foxglove, Encoding::Protobuf),
        6 => message(MessageKind::Livox, Encoding::Cdr),
        _ => message(MessageKind::Livox, Encoding::Ros1),
    }
});
