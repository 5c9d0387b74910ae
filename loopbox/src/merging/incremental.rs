//! Pairs of maps that met and have grown since: what they made of each other holds as long as the keyframes that it rests on are as
//! they were, and only the new ones are asked. So a new keyframe costs what it touches; in the end, when nothing comes any more, all
//! is looked at from the beginning once, so that it makes no difference how maps came to be what they are.

use super::{MergingParams, PairResult, Seconds};
use map::{KeyframeId, SemiDense};
use merge::prepared::PreparedMap;
use merge::verification::{EvaluatedClosure, Outcome, TestedPlace, follow_on};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use std::time::Instant;

/// Two maps as they were when they met, the target first.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Seen {
    /// The keyframes that had features and depth.
    pub keyframes: [BTreeSet<KeyframeId>; 2],
    /// Of those that were aligned, what their depths were.
    pub depths: [BTreeMap<KeyframeId, u64>; 2],
    /// Whether they have grown since they were looked at from the beginning.
    pub is_grown: bool,
}

impl Seen {
    /// Maps of which this came.
    pub fn new(maps: [&PreparedMap; 2], evaluated: &EvaluatedClosure) -> Self {
        Self::default().with(maps, &aligned(evaluated))
    }

    /// The same maps as they are by now, grown since, of which this came: depths that are known are as they were.
    fn grown(&self, maps: [&PreparedMap; 2], evaluated: &EvaluatedClosure) -> Self {
        Self { is_grown: true, ..self.clone().with(maps, &aligned(evaluated)) }
    }

    /// These maps, of which these keyframes, of the one and of the other, were aligned, beside those that are known.
    fn with(mut self, maps: [&PreparedMap; 2], aligned: &[[KeyframeId; 2]]) -> Self {
        self.keyframes = maps.map(|map| map.order().iter().copied().collect());
        for (side, depths) in self.depths.iter_mut().enumerate() {
            for id in aligned.iter().map(|ids| ids[side]) {
                if !depths.contains_key(&id) {
                    depths.extend(depth_of(maps[side], id).map(|depth| (id, depth)));
                }
            }
        }
        self
    }

    /// The keyframes that were not there; nothing where one that was aligned is gone or has other depths.
    fn fresh(&self, maps: [&PreparedMap; 2]) -> Option<[BTreeSet<KeyframeId>; 2]> {
        for (map, depths) in maps.iter().zip(&self.depths) {
            if !depths.iter().all(|(id, depth)| depth_of(map, *id) == Some(*depth)) {
                return None;
            }
        }
        let fresh = |side: usize| {
            let known = &self.keyframes[side];
            maps[side].order().iter().copied().filter(|id| !known.contains(id)).collect()
        };
        Some([fresh(0), fresh(1)])
    }
}

/// The keyframes that were aligned, of the target and of the source.
fn aligned(evaluated: &EvaluatedClosure) -> Vec<[KeyframeId; 2]> {
    let edges = evaluated.joined.iter().flat_map(|joined| joined.edges.iter().chain(&joined.rejected));
    let edges = edges.map(|edge| [edge.from, edge.to]);
    let pairs = evaluated.closure.pairs.iter().flatten().map(|pair| [pair.target, pair.source]);
    edges.chain(pairs).collect()
}

/// Stands for the depths of a keyframe that has features; nothing where there is none.
fn depth_of(map: &PreparedMap, id: KeyframeId) -> Option<u64> {
    let keyframe = map.map().keyframes.get(&id).filter(|_| map.has(id))?;
    let SemiDense { pixel, inverse_depth, .. } = &*keyframe.semi_dense;
    let mut hasher = DefaultHasher::new();
    pixel.hash(&mut hasher);
    inverse_depth.iter().for_each(|depth| depth.to_bits().hash(&mut hasher));
    Some(hasher.finish())
}

/// What two maps, the target first, make of each other that were merged `before` and have grown since; nothing where they have to be
/// looked at from the beginning.
pub(super) fn grown(
    before: &PairResult,
    maps: [&PreparedMap; 2],
    params: &MergingParams,
) -> Option<PairResult> {
    let start = Instant::now();
    let seen = before.seen.as_ref()?;
    let evaluated = before.accepted().filter(|_| params.method.baseline().is_none())?;
    let [of_target, of_source] = seen.fresh(maps)?;
    let fresh = [&of_source, &of_target];
    let evaluated =
        follow_on(maps[1], maps[0], evaluated, fresh, &params.verification.acceptance, &params.further)?;
    let joined = evaluated.joined.clone().map(Arc::new);
    let seen = seen.grown(maps, &evaluated);
    let mut evaluated = Some(evaluated);
    let tested =
        before.tested.iter().map(|tested| match tested.outcome.accepted().and_then(|_| evaluated.take()) {
            Some(evaluated) => {
                TestedPlace { outcome: Outcome::Evaluated(Box::new(evaluated)), ..tested.clone() }
            }
            None => tested.clone(),
        });
    let seconds = Seconds { verification: start.elapsed().as_secs_f64(), ..Seconds::default() };
    let (tested, seen) = (tested.collect(), Some(Arc::new(seen)));
    Some(PairResult { tested, joined, seconds, seen, ..before.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use features::Features;
    use geometry::{GrayImage, Pinhole, Sim3};
    use map::{Keyframe, Map};
    use merge::key_points::KeyPointParams;
    use place_recog::KeyframeFeatures;

    const CAMERA: Pinhole = Pinhole { width: 40, height: 30, fx: 30.0, fy: 30.0, cx: 19.5, cy: 14.5 };

    /// So many keyframes with a depth each, all of them with features.
    fn map(count: u32) -> (Map, KeyframeFeatures) {
        let mut map = Map::new(CAMERA);
        for id in (0..count).map(KeyframeId) {
            let image = Arc::new(GrayImage::filled(40, 30, 0));
            let mut keyframe = Keyframe::of_image(id, id.0.into(), id.0.into(), Sim3::identity(), image);
            let (pixel, inverse_depth, variance) = (vec![7].into(), vec![0.5].into(), vec![0.1].into());
            keyframe.semi_dense = SemiDense { pixel, inverse_depth, variance }.into();
            map.keyframes.insert(id, keyframe);
        }
        let features = (0..count).map(|id| (KeyframeId(id), Features::default())).collect();
        (map, features)
    }

    #[test]
    fn what_is_new_is_asked_as_long_as_what_was_aligned_is_as_it_was() {
        let params = KeyPointParams::default();
        let ((few, of_few), (many, of_many)) = (map(3), map(5));
        let [short, long] = [(&few, &of_few), (&many, &of_many)]
            .map(|(map, features)| PreparedMap::new(map, features, &params));
        let aligned = [[KeyframeId(0), KeyframeId(1)], [KeyframeId(2), KeyframeId(2)]];
        let seen = Seen::default().with([&short, &short], &aligned);
        assert_eq!(seen.fresh([&short, &short]), Some([BTreeSet::new(), BTreeSet::new()]));
        let fresh: BTreeSet<KeyframeId> = [3, 4].map(KeyframeId).into();
        assert_eq!(seen.fresh([&short, &long]), Some([BTreeSet::new(), fresh]));

        // The depth of one that was aligned changed in its last digit, or it is gone; of one that was not, it does not matter.
        let spoiled = |id: u32, spoil: fn(&mut Map, KeyframeId)| {
            let mut spoiled = many.clone();
            spoil(&mut spoiled, KeyframeId(id));
            let short = PreparedMap::new(&few, &of_few, &params);
            seen.fresh([&short, &PreparedMap::new(&spoiled, &of_many, &params)])
        };
        let deeper = |map: &mut Map, id: KeyframeId| {
            map.keyframes.get_mut(&id).unwrap().semi_dense.inverse_depth[0] = 0.5f32.next_up();
        };
        let gone = |map: &mut Map, id: KeyframeId| drop(map.keyframes.remove(&id));
        assert_eq!([spoiled(1, deeper), spoiled(2, deeper), spoiled(2, gone)], [None, None, None]);
        assert!(spoiled(0, deeper).is_some() && spoiled(0, gone).is_some());
    }
}
