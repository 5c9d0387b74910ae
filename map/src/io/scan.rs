//! Scans of LiDAR keyframes: a topic of their own, written once a keyframe as images are.

use crate::{KeyframeId, Scan};
use geometry::limits::MAX_SCAN_POINTS;

/// Where scans lie in a file that has a LiDAR agent.
pub(super) const SCAN_TOPIC: &str = "/loopbox/scan";
/// Name of the message's schema.
pub(super) const SCAN_SCHEMA: &str = "loopbox.Scan";

/// A keyframe's scan.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ScanMessage {
    /// The keyframe's name in the map.
    #[prost(uint32, tag = "1")]
    pub id: u32,
    /// The first cell, then each one's distance from the one before: three bytes for most.
    #[prost(uint64, repeated, tag = "2")]
    pub cell_step: Vec<u64>,
}

/// The message of a keyframe's scan.
pub(super) fn to_message(id: KeyframeId, scan: &Scan) -> ScanMessage {
    let mut previous = 0;
    let step = scan.cells().map(|cell| cell - std::mem::replace(&mut previous, cell));
    ScanMessage { id: id.0, cell_step: step.collect() }
}

/// The scan of a message; says what is wrong with it.
pub(super) fn from_message(message: ScanMessage) -> Result<(KeyframeId, Scan), String> {
    let wrong = || format!("the scan of keyframe {}: a point lies outside of its grid", message.id);
    let count = message.cell_step.len();
    if count > MAX_SCAN_POINTS {
        let (id, most) = (message.id, MAX_SCAN_POINTS);
        return Err(format!(
            "the scan of keyframe {id} has {count} points, more than the {most} that one may have"
        ));
    }
    let mut cells = message.cell_step;
    let mut previous = 0u64;
    for step in &mut cells {
        previous = previous.checked_add(*step).ok_or_else(wrong)?;
        *step = previous;
    }
    let scan = Scan::from_cells(&cells).ok_or_else(wrong)?;
    Ok((KeyframeId(message.id), scan))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::Numbers;
    use prost::Message;

    /// A room's walls seen by 16 rings, thinned as a keyframe's scan is: about one point in each cube of 15 cm.
    fn room() -> Scan {
        let numbers = &mut Numbers::new(4);
        let mut points = Vec::new();
        for i in 0..100 {
            for k in 0..60 {
                let mut noise = || 0.15 * numbers.next() as f32;
                let (along, up) = (0.15 * i as f32 - 7.5, 0.15 * k as f32 - 1.5);
                points.push([along + noise(), 5.0 + 0.2 * noise(), up + noise()]);
                points.push([-7.5 + 0.2 * noise(), along + noise(), up + noise()]);
            }
        }
        Scan::new(points)
    }

    #[test]
    fn a_point_takes_less_than_four_bytes() {
        let scan = room();
        let message = to_message(KeyframeId(3), &scan);
        let bytes = message.encoded_len();
        assert!(bytes < 4 * scan.len(), "{bytes} bytes for {} points", scan.len());
        assert_eq!(from_message(message), Ok((KeyframeId(3), scan)));
    }

    #[test]
    fn steps_out_of_the_grid_are_refused() {
        for cell_step in [vec![5, 0], vec![1, u64::MAX], vec![u64::MAX]] {
            let error = from_message(ScanMessage { id: 9, cell_step }).unwrap_err();
            assert!(error.contains("keyframe 9"), "{error}");
        }
    }

    #[test]
    fn scans_of_more_points_than_any_lidar_has_are_refused() {
        let scan = |points: usize| from_message(ScanMessage { id: 9, cell_step: vec![1; points] });
        assert!(scan(MAX_SCAN_POINTS).is_ok());
        assert!(scan(MAX_SCAN_POINTS + 1).unwrap_err().contains("2000001 points"));
    }
}
