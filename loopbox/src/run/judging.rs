//! Whether a camera that was found is where it was found, told as for maps that are merged.

use backend::sim3_align::KeyframeView;
use geometry::Pyramid;
use map::{Keyframe, Map, rectified};
use merge::key_points::KeyPointParams;
use merge::place_verdict::{Answer, PlaceParams, Prior, SeenFrame, frames_verdict};
use merge::prepared::PreparedMap;
use place_recog::KeyframeFeatures;
use slam_direct::{ClaimedPlace, JudgePlace, PlaceAnswer, PlacedView};

/// Pyramid levels of a frame: cells are compared on one of the finest.
const LEVELS: usize = 5;

/// Probability that anything in the place may have changed. For maps of one day it is a tenth of that ([`Prior::rearranged`]); here nobody
/// says how long ago the map was made, and who covers a camera may move what it sees. What looks otherwise then never says more against
/// the place than that, so that wear that agrees outweighs it; without wear it stays open.
const REARRANGED: f64 = 0.2;

/// Judges by all that frames and keyframes see of each surface.
pub struct SurfaceJudge;

impl JudgePlace for SurfaceJudge {
    fn judge(&self, claim: &ClaimedPlace) -> PlaceAnswer {
        let ideal = |view: &PlacedView| ideal(view, claim);
        let mut map = Map::new(claim.camera);
        map.keyframes = claim.keyframes.iter().map(ideal).map(|keyframe| (keyframe.id, keyframe)).collect();
        let features: KeyframeFeatures = map.keyframes.keys().map(|&id| (id, Default::default())).collect();
        let key_points = KeyPointParams::default();
        let prepared = PreparedMap::new(&map, &features, &key_points);
        let frame = |view: &PlacedView| {
            let keyframe = ideal(view);
            let pyramid = Pyramid::new(keyframe.image.as_ref().clone(), LEVELS);
            let view = KeyframeView::new(&pyramid, &keyframe.semi_dense, &claim.camera);
            SeenFrame { world_from_frame: keyframe.world_from_keyframe, view }
        };
        let frames: Vec<SeenFrame> = claim.frames.iter().map(frame).collect();
        let prior = Prior { rearranged: REARRANGED, ..Prior::default() };
        let params = PlaceParams { prior, ..PlaceParams::default() };
        let found = frames_verdict(&prepared, &frames, &params).weighed;
        match found.answer {
            Answer::Same | Answer::SameChanged => PlaceAnswer::Same,
            Answer::Different => PlaceAnswer::Different,
            Answer::CannotTell => PlaceAnswer::CannotTell,
        }
    }
}

/// What an ideal camera would have taken.
fn ideal(view: &PlacedView, claim: &ClaimedPlace) -> Keyframe {
    let found = rectified(&view.keyframe, &claim.sensor, &view.motion);
    found.map_or_else(|| view.keyframe.clone(), |rectified| rectified.keyframe)
}
