//! What `run.json` holds of each part of a run.

use crate::results::file_names::{MAP, TRAJECTORY, numbered};
use crate::run::scale_doubt::{ScaleDoubt, scale_doubts};
use crate::run::without_depth::{WithoutDepth, without_depth};
use serde::Serialize;
use slam_direct::ScaleBreak;
use std::collections::BTreeMap;
use std::ops::Range;

/// A part of the run that hangs together.
#[derive(Clone, Debug, Serialize)]
pub struct Fragment {
    /// Its trajectory, by the name relative to the folder of results.
    pub trajectory: String,
    /// Its map, likewise.
    pub map: String,
    /// Frames with a pose.
    pub frames: u64,
    /// The first of them.
    pub first_frame: u64,
    /// The last of them.
    pub last_frame: u64,
    /// Keyframes.
    pub keyframes: u64,
    /// Those of them whose images have hardly any depth: poses there are not to be relied on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_depth: Option<WithoutDepth>,
    /// Why it begins where another ends, if that one's scale is not carried on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_break: Option<ScaleBreak>,
    /// Where the scale that is carried on within it is known least; nothing is said of a map that was gone on with.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_deviation: Option<LeastKnownScale>,
    /// Where its scale may have changed, though nothing was lost.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub scale_doubts: Vec<ScaleDoubt>,
}

/// Where the scale of a fragment is known least.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeastKnownScale {
    /// The keyframe's frame, behind which it is.
    pub frame: u64,
    /// Standard deviation of the logarithm of the scale behind it over that before.
    pub deviation: f64,
}

impl Fragment {
    /// The fragment with this place in the order, from 0, by the breaks of the scale at the frames where fragments begin, and its `deviations`
    /// behind keyframes' frames.
    pub fn new(
        place: usize,
        map: &map::Map,
        breaks: &BTreeMap<u64, ScaleBreak>,
        deviations: &BTreeMap<u64, f64>,
    ) -> Self {
        let keyframe_frames = || map.keyframes.values().map(|keyframe| keyframe.frame_index);
        let first = keyframe_frames().next().and_then(|first| breaks.get(&first));
        let own =
            keyframe_frames().next().unwrap_or_default()..keyframe_frames().next_back().unwrap_or_default();
        let index = |frame: Option<&map::FramePose>| frame.map_or(0, |frame| frame.frame_index);
        Self {
            trajectory: numbered(TRAJECTORY, place),
            map: numbered(MAP, place),
            frames: map.frames.len() as u64,
            first_frame: index(map.frames.first()),
            last_frame: index(map.frames.last()),
            keyframes: map.keyframes.len() as u64,
            without_depth: without_depth(map),
            scale_break: first.copied(),
            scale_deviation: LeastKnownScale::among(own, deviations),
            scale_doubts: scale_doubts(map),
        }
    }

    /// What to say of a fragment that begins because the scale of the one before it was not carried on; nothing of others.
    pub fn not_carried(&self) -> Option<String> {
        let text = self.scale_break?.text();
        Some(format!(
            "the scale is not carried on at frame {}: {text}; what comes there is in {}, in a unit of its own\n\
             hint: keep part of what was seen in view where the camera turns, and move sideways there",
            self.first_frame, self.map
        ))
    }
}

impl LeastKnownScale {
    /// The largest of the deviations behind the keyframes of these frames.
    fn among(frames: Range<u64>, deviations: &BTreeMap<u64, f64>) -> Option<Self> {
        let known = deviations.range(frames).map(|(&frame, &deviation)| Self { frame, deviation });
        known.max_by(|a, b| a.deviation.total_cmp(&b.deviation))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fragment_tells_where_its_own_scale_is_known_least() {
        let deviations = BTreeMap::from([(3, 0.5), (10, 0.01), (20, 0.04), (30, 0.02), (40, 0.6)]);
        let found = LeastKnownScale::among(10..40, &deviations);
        assert_eq!(found, Some(LeastKnownScale { frame: 20, deviation: 0.04 }));
        assert_eq!(LeastKnownScale::among(11..20, &deviations), None);
    }
}
