//! Between [`map::Map`] and what [`slam_lidar`] works on.

use geometry::{GrayImage, Se3, Sim3};
use map::{AgentId, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Map, Scan};
use nalgebra::{SMatrix, SVector};
use slam_lidar::keyframe;
use slam_lidar::mapping::TrackedFrame;
use std::sync::Arc;

/// A LiDAR measures metres: what an edge's scale may be off by, in the tangent.
const SCALE_DEVIATION: f64 = 1e-4;

/// The name of the keyframe number `index`.
pub(super) fn id(index: usize) -> KeyframeId {
    KeyframeId(u32::try_from(index).unwrap_or(u32::MAX))
}

/// A keyframe as the map keeps it.
pub(super) fn to_keyframe(index: usize, frame_index: u64, keyframe: &keyframe::Keyframe) -> Keyframe {
    Keyframe {
        id: id(index),
        agent: AgentId::default(),
        timestamp: keyframe.instant,
        frame_index,
        world_from_keyframe: Sim3::from(keyframe.world_from_sensor),
        image: Arc::new(GrayImage::filled(0, 0, 0)),
        color: None,
        scan: Some(Arc::new(Scan::new(keyframe.points.iter().copied()))),
        semi_dense: Default::default(),
        points: Vec::new(),
        features: None,
        words: None,
    }
}

/// The keyframes of a map that have scans, with their names.
pub(super) fn keyframes(map: &Map) -> (Vec<KeyframeId>, Vec<keyframe::Keyframe>) {
    let with_scan = map.keyframes.iter().filter_map(|(id, k)| Some((*id, k, k.scan.as_ref()?)));
    let keyframe = |(id, k, scan): (KeyframeId, &Keyframe, &Arc<Scan>)| {
        let points = scan.points().collect();
        (id, keyframe::Keyframe::new(k.timestamp, k.world_from_keyframe.rigid(), points))
    };
    with_scan.map(keyframe).unzip()
}

/// An edge between keyframes, with standard deviations in metres and radians.
pub(super) fn edge(
    [from, to]: [KeyframeId; 2],
    from_from_to: &Se3,
    (translation, rotation): (f64, f64),
    kind: EdgeKind,
) -> Edge {
    let (t, r, s) = (translation.powi(-2), rotation.powi(-2), SCALE_DEVIATION.powi(-2));
    let information = SMatrix::from_diagonal(&SVector::<f64, 7>::from([t, t, t, r, r, r, s]));
    Edge { from, to, from_from_to: Sim3::from(*from_from_to), information, kind }
}

/// A tracked sweep as the map keeps it.
pub(super) fn frame(frame_index: u64, sweep: &TrackedFrame) -> FramePose {
    FramePose {
        timestamp: sweep.instant,
        frame_index,
        reference: id(sweep.keyframe),
        keyframe_from_frame: sweep.keyframe_from_sensor,
    }
}
