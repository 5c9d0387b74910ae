//! Whether a camera that was found is where it was found, told as for maps that are merged.

use backend::sim3_align::KeyframeView;
use geometry::Pyramid;
use map::{Keyframe, Map, rectified};
use merge::key_points::KeyPointParams;
use merge::place_verdict::{Answer, PlaceParams, Prior, SeenFrame, frames_verdict};
use merge::prepared::PreparedMap;
use place_recog::KeyframeFeatures;
use slam_direct::{ClaimedPlace, JudgePlace, PlacedView};

/// Pyramid levels of a frame: cells are compared on one of the finest.
const LEVELS: usize = 5;

/// Probability that anything in the place may have changed. For maps of one day it is a tenth of that ([`Prior::rearranged`]); here nobody
/// says how long ago the map was made, and who covers a camera may move what it sees. What looks otherwise then never says more against
/// the place than that, so that wear that agrees outweighs it; without wear it stays open.
const REARRANGED: f64 = 0.2;

/// Share of the things from which on what differs is no noise of recordings of one place: as of merges
/// ([`AcceptanceParams::min_undecided_change`](merge::acceptance::AcceptanceParams)), whose right pairs have 0.084 at most. Where more differs
/// the place must be told even though hardly anything is expected to have changed.
const MUCH: f64 = 0.1;

/// What is believed of changes and doubles where a camera comes back: within the reach of one run hardly a place is a copy of another.
pub(crate) fn prior() -> Prior {
    Prior { rearranged: REARRANGED, rearranged_up_to: MUCH, copied: 0.0, ..Prior::default() }
}

/// Judges by all that frames and keyframes see of each surface.
pub struct SurfaceJudge;

impl JudgePlace for SurfaceJudge {
    fn judge(&self, claim: &ClaimedPlace) -> Answer {
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
        let params = PlaceParams { prior: prior(), ..PlaceParams::default() };
        frames_verdict(&prepared, &frames, &params).weighed.answer
    }
}

/// What an ideal camera would have taken.
fn ideal(view: &PlacedView, claim: &ClaimedPlace) -> Keyframe {
    let found = rectified(&view.keyframe, &claim.sensor, &view.motion);
    found.map_or_else(|| view.keyframe.clone(), |rectified| rectified.keyframe)
}

#[cfg(test)]
mod tests {
    use super::*;
    use backend::verdict::weigh;
    use merge::place_verdict::{Piece, PieceKind};

    /// Pieces of one thing each: so many whose look agrees, whose look differs, whose wear agrees.
    fn says(looks: usize, others: usize, wear: usize) -> Answer {
        let piece =
            |kind, ln_agreement| Piece { kind, share: 0.01, things: 1.0, occurrences: 1.0, ln_agreement };
        let all = [
            vec![piece(PieceKind::Look, 20.0); looks],
            vec![piece(PieceKind::Look, -30.0); others],
            vec![piece(PieceKind::Wear, 12.0); wear],
        ];
        weigh(&all.concat(), &prior()).answer
    }

    /// A few things that differ are outweighed by wear, and nothing else; many are not.
    #[test]
    fn wear_outweighs_little_that_differs() {
        assert_eq!(says(40, 0, 0), Answer::Same);
        assert_eq!(says(40, 3, 6), Answer::SameChanged);
        assert_eq!(says(40, 3, 0), Answer::CannotTell);
        assert_eq!(says(40, 15, 6), Answer::CannotTell);
    }
}
