//! Keyframes whose images have hardly any depth.

use map::{Keyframe, Map};
use serde::Serialize;
use slam_direct::has_hardly_any_depth;

/// The share of such keyframes from which a map is doubtful.
const MANY: f64 = 0.1;
/// Keyframes that are looked at: of more every n-th, for they are read from their files.
const LOOKED_AT: usize = 200;
/// The newest keyframes may have no depth yet.
const UNSETTLED: usize = 8;

/// The keyframes of a map without depth: their edges were found at no place that agrees with the poses, since these are wrong or since
/// the camera only turned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WithoutDepth {
    /// The share of the map's keyframes, 0–1.
    pub share: f64,
    /// The frame that the first of them was made of.
    pub first_frame: u64,
    /// The frame that the last of them was made of.
    pub last_frame: u64,
}

impl WithoutDepth {
    /// Whether they are so many that the map is doubtful.
    pub fn is_much(&self) -> bool {
        self.share >= MANY
    }
}

/// The keyframes whose edges have hardly any depth; nothing where there are none.
pub fn without_depth(map: &Map) -> Option<WithoutDepth> {
    let all: Vec<&Keyframe> = map.keyframes.values().filter(|keyframe| keyframe.scan.is_none()).collect();
    let unsettled = all.iter().rev().take(UNSETTLED).take_while(|k| k.semi_dense.is_empty()).count();
    let settled = &all[..all.len() - unsettled];
    let stride = settled.len().div_ceil(LOOKED_AT).max(1);
    let looked_at = settled.len().div_ceil(stride);
    let has_hardly_any =
        |keyframe: &&&Keyframe| has_hardly_any_depth(&keyframe.image, keyframe.semi_dense.len());
    let found: Vec<u64> =
        settled.iter().step_by(stride).filter(has_hardly_any).map(|keyframe| keyframe.frame_index).collect();
    let (first, last) = (found.iter().min()?, found.iter().max()?);
    let share = found.len() as f64 / looked_at as f64;
    Some(WithoutDepth { share, first_frame: *first, last_frame: *last })
}

/// What to say of a map of which many keyframes have no depth; nothing of others.
pub fn doubtful_depth(name: &str, without: Option<&WithoutDepth>) -> Option<String> {
    let WithoutDepth { share, first_frame, last_frame } = without.filter(|without| without.is_much())?;
    Some(format!(
        "{:.0} % of the keyframes of {name}, from frame {first_frame} to frame {last_frame}, have depth at hardly any edge of their \
         images: the camera only turned there, or their poses are wrong\nhint: look at the report before you rely on it; move \
         sideways in front of something textured that stands still and does not shine, and keep part of what was seen before in view",
        100.0 * share
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Sim3};
    use map::{AgentInfo, KeyframeId, SemiDense};
    use slam_direct::{DepthParams, candidate_pixels};
    use std::sync::Arc;

    fn pattern() -> GrayImage {
        let data = (0..64 * 48).map(|i| ((i * 31) % 251) as u8).collect();
        GrayImage::from_vec(64, 48, data).unwrap()
    }

    /// A map of one image over and over, with so many depths for each keyframe.
    fn depths(counts: &[usize]) -> Map {
        let camera = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
        let mut map = Map::of(AgentInfo::new("one", camera));
        let image = Arc::new(pattern());
        for (number, &count) in counts.iter().enumerate() {
            let (id, frame) = (KeyframeId(number as u32), 3 * number as u64);
            let mut keyframe =
                Keyframe::of_image(id, 0.1 * number as f64, frame, Sim3::identity(), Arc::clone(&image));
            let (pixel, depth) = ((0..count as u32).collect(), vec![0.5; count]);
            keyframe.semi_dense =
                SemiDense { pixel, inverse_depth: depth.clone().into(), variance: depth.into() }.into();
            map.keyframes.insert(id, keyframe);
        }
        map
    }

    #[test]
    fn a_map_is_doubtful_where_its_images_have_no_depth() {
        let edges = candidate_pixels(&pattern(), &DepthParams::default()).len();
        assert!(edges > 200);
        let (some, few) = (edges / 20, edges / 200);
        assert_eq!(without_depth(&depths(&[some; 30])), None);
        assert_eq!(without_depth(&depths(&[])), None);
        // What has none yet is not judged.
        let mut counts = vec![some; 20];
        counts.extend([0; 8]);
        assert_eq!(without_depth(&depths(&counts)), None);
        counts.extend([some; 2]);
        let found = without_depth(&depths(&counts)).expect("eight of thirty");
        assert_eq!((found.first_frame, found.last_frame), (60, 81));
        assert!((found.share - 8.0 / 30.0).abs() < 1e-9);
        assert!(
            doubtful_depth("map.mcap", Some(&found))
                .is_some_and(|text| text.contains("27 % of the keyframes of map.mcap"))
        );
        counts = vec![some; 24];
        counts[7] = few;
        let found = without_depth(&depths(&counts));
        assert!(found.is_some() && doubtful_depth("map.mcap", found.as_ref()).is_none());
        // Of many every n-th is looked at.
        let long: Vec<usize> = (0..1000).map(|i| if i < 500 { some } else { few }).collect();
        let found = without_depth(&depths(&long)).expect("half of them");
        assert!((found.share - 0.5).abs() < 0.01 && found.first_frame == 1500);
    }
}
