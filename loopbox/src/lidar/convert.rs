//! Between [`map::Map`] and what [`slam_lidar`] works on.

use geometry::{GrayImage, Se3, Sim3};
use map::{AgentId, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Map, Scan};
use nalgebra::{Matrix3, Matrix6, SMatrix, SVector};
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

/// An edge of the odometry, which errs by a right increment (υ, ω) with `covariance`, m² and rad².
pub(super) fn odometry_edge(ends: [KeyframeId; 2], from_from_to: &Se3, covariance: &Matrix6<f64>) -> Edge {
    let deviation = |k: usize| covariance[(k, k)].sqrt();
    let mut edge = edge(ends, from_from_to, (deviation(0), deviation(3)), EdgeKind::Odometry);
    let translation = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    if translation == Matrix3::from_diagonal_element(covariance[(0, 0)]) {
        return edge;
    }
    // As a left increment: in the axes of the earlier keyframe.
    let rotation = from_from_to.rotation_matrix();
    if let Some(information) = (rotation * translation * rotation.transpose()).try_inverse() {
        edge.information.fixed_view_mut::<3, 3>(0, 0).copy_from(&information);
    }
    edge
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn an_edge_bears_what_was_guessed_of_it_in_the_axes_of_the_earlier_keyframe() {
        let quarter = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2);
        let step = Se3::new(quarter, Vector3::new(1.0, 0.0, 0.0));
        let ends = [id(0), id(1)];
        let mut covariance = Matrix6::from_diagonal_element(1e-4);
        let known = odometry_edge(ends, &step, &covariance);
        assert_eq!(known.information, edge(ends, &step, (0.01, 0.01), EdgeKind::Odometry).information);
        // Along the later one's x, which is the earlier one's y.
        covariance[(0, 0)] += 4.0;
        let guessed = odometry_edge(ends, &step, &covariance).information;
        let deviation = |k: usize| guessed[(k, k)].powf(-0.5);
        assert!((deviation(0) - 0.01).abs() < 1e-6 && (deviation(1) - 2.0).abs() < 1e-3, "{guessed}");
        assert!(guessed[(0, 1)].abs() < 1e-6 && (deviation(3) - 0.01).abs() < 1e-9, "{guessed}");
    }
}
