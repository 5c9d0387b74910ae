//! A map, cut into several.

use crate::unite::{renamed, renamed_edge, renamed_frame};
use crate::{AgentId, KeyframeId, Map};

impl Map {
    /// The map of one agent in parts, each with the keyframes up to one of `ends` (ascending) and the last with the rest. Keyframes of
    /// a part have ids from 0 on; what joins parts (edges, and observations of points that another part hosts) is left out.
    pub fn cut_behind(self, ends: &[KeyframeId]) -> Vec<Map> {
        if ends.is_empty() {
            return vec![self];
        }
        let begins = std::iter::once(0).chain(ends.iter().map(|end| end.0 + 1));
        let ends = ends.iter().map(|end| end.0 + 1).chain([u32::MAX]);
        begins.zip(ends).map(|(begin, end)| self.part(begin, end)).collect()
    }

    /// The same behind one keyframe: what comes up to it, and what comes after it.
    pub fn cut_in_two(&self, end: KeyframeId) -> [Map; 2] {
        let begin = end.0 + 1;
        [self.part(0, begin), self.part(begin, u32::MAX)]
    }

    /// The part with the keyframes whose ids are within a range.
    fn part(&self, begin: u32, end: u32) -> Map {
        let is_in = |id: KeyframeId| (begin..end).contains(&id.0);
        Map { agents: self.agents.clone(), ..self.renamed_part(is_in, begin) }
    }

    /// The keyframes that are `is_in` as those of one agent, which is still to be named, the first of which has the id `first` here and 0 there; with
    /// the edges between them, their frames, and what they observe of each other's points.
    pub(crate) fn renamed_part(&self, is_in: impl Fn(KeyframeId) -> bool, first: u32) -> Map {
        let rename = |id: KeyframeId| KeyframeId(id.0 - first);
        let keyframes = self.keyframes.iter().filter(|(id, _)| is_in(**id)).map(|(id, keyframe)| {
            let mut keyframe = keyframe.clone();
            keyframe.points.iter_mut().for_each(|point| point.observations.retain(|o| is_in(o.keyframe)));
            (rename(*id), renamed(keyframe, AgentId::default(), rename))
        });
        let edges = self.edges.iter().filter(|edge| is_in(edge.from) && is_in(edge.to));
        let frames = self.frames.iter().filter(|frame| is_in(frame.reference));
        Map {
            keyframes: keyframes.collect(),
            edges: edges.map(|edge| renamed_edge(edge.clone(), rename)).collect(),
            frames: frames.map(|frame| renamed_frame(*frame, rename)).collect(),
            ..Map::without_agents()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Edge, EdgeKind, FramePose, Keyframe, Observation, Point};
    use geometry::{GrayImage, Pinhole, Se3, Sim3};
    use nalgebra::SMatrix;
    use std::sync::Arc;

    /// Four keyframes in a row, each with a point that all others see, and a frame.
    fn row() -> Map {
        let mut map = Map::new(Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 });
        for id in (0..4).map(KeyframeId) {
            let image = Arc::new(GrayImage::filled(8, 6, 90));
            let mut keyframe =
                Keyframe::of_image(id, f64::from(id.0), u64::from(id.0), Sim3::identity(), image);
            let others = (0..4).map(KeyframeId).filter(|other| *other != id);
            let seen = |keyframe| Observation { keyframe, pixel: [1.0, 2.0], information: [1.0, 0.0, 1.0] };
            let observations = others.map(seen).collect();
            keyframe.points =
                vec![Point { pixel: [1.0, 2.0], inverse_depth: 1.0, variance: 0.1, observations }];
            map.keyframes.insert(id, keyframe);
            let (timestamp, frame_index) = (f64::from(id.0), u64::from(id.0));
            map.frames.push(FramePose {
                timestamp,
                frame_index,
                reference: id,
                keyframe_from_frame: Se3::identity(),
            });
        }
        let (from_from_to, information) = (Sim3::identity(), SMatrix::identity());
        let edge = |i| Edge {
            from: KeyframeId(i),
            to: KeyframeId(i + 1),
            from_from_to,
            information,
            kind: EdgeKind::Odometry,
        };
        map.edges = (0..3).map(edge).collect();
        map
    }

    #[test]
    fn each_part_is_a_map_of_its_own() {
        let whole = row();
        let parts = whole.clone().cut_behind(&[KeyframeId(0), KeyframeId(2)]);
        assert_eq!(parts.iter().map(|part| part.keyframes.len()).collect::<Vec<_>>(), [1, 2, 1]);
        let middle = &parts[1];
        assert_eq!(middle.keyframes.keys().copied().collect::<Vec<_>>(), [KeyframeId(0), KeyframeId(1)]);
        assert_eq!(middle.keyframes[&KeyframeId(1)].id, KeyframeId(1));
        assert_eq!(middle.keyframes[&KeyframeId(1)].frame_index, 2);
        let seen = &middle.keyframes[&KeyframeId(0)].points[0].observations;
        assert_eq!(seen.iter().map(|o| o.keyframe).collect::<Vec<_>>(), [KeyframeId(1)]);
        assert_eq!(middle.edges.len(), 1);
        assert_eq!(
            middle.frames.iter().map(|frame| (frame.frame_index, frame.reference.0)).collect::<Vec<_>>(),
            [(1, 0), (2, 1)]
        );
        assert_eq!(middle.agents, whole.agents);
        assert!(whole.clone().cut_behind(&[KeyframeId(1)]) == whole.cut_in_two(KeyframeId(1)));
        assert!(whole.clone().cut_behind(&[]) == [whole]);
    }
}
