//! What a map holds, in numbers.

use crate::{EdgeKind, Map};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// A map in numbers, for people (`Display`) and programs (`Serialize`).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Image width and height, pixels.
    pub image_size: [usize; 2],
    /// Number of keyframes.
    pub keyframes: usize,
    /// Sparse points, all keyframes together.
    pub points: usize,
    /// Observations of the sparse points.
    pub observations: usize,
    /// Pixels with inverse depth, all keyframes together.
    pub depth_pixels: usize,
    /// Mean share of a keyframe's pixels that have inverse depth, 0–1.
    pub density: f64,
    /// Edges that join successive keyframes.
    pub odometry_edges: usize,
    /// Edges between keyframes that share points.
    pub covisibility_edges: usize,
    /// Loops closed.
    pub loop_edges: usize,
    /// Meetings of agents.
    pub merge_edges: usize,
    /// Frames tracked.
    pub frames: usize,
    /// Seconds from the first to the last tracked frame.
    pub duration: f64,
    /// Length of the trajectory, map units.
    pub path_length: f64,
    /// Size of the file, bytes, where the map came from one.
    pub file_bytes: Option<u64>,
    /// Where the map came from.
    pub provenance: BTreeMap<String, String>,
}

impl Map {
    /// The map in numbers; `file_bytes` is the size of its file, if it has one.
    pub fn summary(&self, file_bytes: Option<u64>) -> Summary {
        let keyframes = self.keyframes.values();
        let points = keyframes.clone().flat_map(|keyframe| &keyframe.points);
        let depth_pixels = keyframes.map(|keyframe| keyframe.semi_dense.len()).sum();
        let all_pixels = self.keyframes.len() * self.camera.width * self.camera.height;
        let edges = |kind| self.edges.iter().filter(|edge| edge.kind == kind).count();
        let position = |index: usize| self.world_from_frame(&self.frames[index]).map(|pose| pose.translation);
        let positions: Vec<_> = (0..self.frames.len()).filter_map(position).collect();
        let times = self.frames.first().zip(self.frames.last());
        Summary {
            image_size: [self.camera.width, self.camera.height],
            keyframes: self.keyframes.len(),
            points: points.clone().count(),
            observations: points.map(|point| point.observations.len()).sum(),
            depth_pixels,
            density: depth_pixels as f64 / all_pixels.max(1) as f64,
            odometry_edges: edges(EdgeKind::Odometry),
            covisibility_edges: edges(EdgeKind::Covisibility),
            loop_edges: edges(EdgeKind::Loop),
            merge_edges: edges(EdgeKind::Merge),
            frames: self.frames.len(),
            duration: times.map_or(0.0, |(first, last)| last.timestamp - first.timestamp),
            // An empty `sum` would be −0.
            path_length: positions.windows(2).fold(0.0, |sum, pair| sum + (pair[1] - pair[0]).norm()),
            file_bytes,
            provenance: self.provenance.clone(),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = self.image_size;
        writeln!(f, "images       {width}×{height} pixels")?;
        writeln!(f, "keyframes    {}", self.keyframes)?;
        let share = 100.0 * self.density;
        writeln!(f, "depth        {} pixels ({share:.1} % of the keyframes' pixels)", self.depth_pixels)?;
        writeln!(f, "points       {} ({} observations)", self.points, self.observations)?;
        writeln!(
            f,
            "edges        {} odometry, {} covisibility, {} loop, {} merge",
            self.odometry_edges, self.covisibility_edges, self.loop_edges, self.merge_edges
        )?;
        writeln!(f, "frames       {} in {:.2} s", self.frames, self.duration)?;
        writeln!(f, "path         {:.3} map units", self.path_length)?;
        if let Some(bytes) = self.file_bytes {
            write!(f, "file         {:.2} MB", bytes as f64 / 1e6)?;
            match self.keyframes {
                0 => writeln!(f)?,
                count => writeln!(f, " ({:.0} kB a keyframe)", bytes as f64 / 1e3 / count as f64)?,
            }
        }
        for (key, value) in &self.provenance {
            let mut lines = value.lines();
            writeln!(f, "{key:<12} {}", lines.next().unwrap_or_default())?;
            for line in lines {
                writeln!(f, "             {line}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::test_support::sample_map;
    use crate::{FramePose, KeyframeId, Map};
    use geometry::{Se3, Sim3};
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn counts_add_up() {
        let summary = sample_map(5).summary(Some(2_000_000));
        assert_eq!((summary.keyframes, summary.frames, summary.points), (5, 25, 20));
        assert_eq!(summary.observations, 5 * (1 + 2 + 3));
        assert_eq!(
            [summary.odometry_edges, summary.covisibility_edges, summary.loop_edges, summary.merge_edges],
            [1, 1, 1, 1]
        );
        assert!((summary.duration - 24.0 / 30.0).abs() < 1e-6);
        let text = summary.to_string();
        assert!(text.contains("2.00 MB (400 kB a keyframe)"), "{text}");
        assert!(text.contains("\n             levels = 5\n"), "{text}");
    }

    #[test]
    fn the_path_is_measured_in_the_world() {
        let mut map: Map = sample_map(1);
        let keyframe = map.keyframes.values_mut().next().unwrap();
        keyframe.world_from_keyframe = Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), 2.0);
        let at = |x: f64| FramePose {
            timestamp: x,
            frame_index: x as u64,
            reference: KeyframeId(1),
            keyframe_from_frame: Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0)),
        };
        map.frames = [0.0, 1.0, 3.0].map(at).to_vec();
        assert!((map.summary(None).path_length - 6.0).abs() < 1e-12);
    }

    #[test]
    fn an_empty_map_has_no_nan() {
        let empty = Map::new(sample_map(0).camera).summary(None);
        assert_eq!((empty.density, empty.duration, empty.path_length), (0.0, 0.0, 0.0));
    }
}
