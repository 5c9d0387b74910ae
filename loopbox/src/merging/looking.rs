//! What pairs of maps make of each other, looked at all at once or in batches.

use super::batches::{Groups, Known, Share, Waiting, next};
use super::incremental::{Seen, grown};
use super::places::{Appearances, Places, places};
use super::{Input, MergingParams, PairResult, PairResults, Seconds, pairs};
use anyhow::{Context, Result};
use geometry::Swap;
use map::Map;
use merge::further::Joined;
use merge::prepared::PreparedMap;
use merge::verification::{EvaluatedClosure, Place, meet};
use place_recog::{Vocabulary, ranked};
#[cfg(feature = "fleet")]
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// Bytes of the keyframes that stay ready for the next pair, of all maps: of 640 × 480 pixels each takes some 4 MB.
const READY: usize = 384 << 20;
/// Keyframes that are looked for in others' maps in one batch, each of them once for every map: at 15 µs a third of a second.
const QUERIES: usize = 20_000;
/// Pairs whose places are found at a time where all are looked at: of maps of 40 keyframes they take some 25 MB.
const PAIRS: usize = 10_000;

/// What is to be looked at.
pub(crate) struct Batch<'a> {
    /// What is known of a pair of inputs, the earlier first.
    pub known: &'a (dyn Fn([usize; 2]) -> Result<Option<Known>> + Sync),
    /// The pairs to look at and how likely each is; every pair, by their words, where nothing is said.
    pub wanted: Option<BTreeMap<[usize; 2], f32>>,
    /// Which inputs hang together by what else is known.
    pub groups: Groups,
    /// Places that were found before of pairs that were not looked at, by target and source.
    pub places: BTreeMap<[usize; 2], Places>,
    /// How much is looked at; everything, in the order of the inputs, where nothing is said.
    pub share: Option<Share>,
    /// Where what pairs made of each other rests; nothing where it stays in memory.
    pub swap: Option<Arc<dyn Swap>>,
    /// Keeps what two inputs made of each other, as soon as that is found.
    pub keep: &'a (dyn Fn(&PairResult) -> Result<()> + Sync),
    /// Whether something comes first that is more urgent than pairs whose agents have their places.
    pub is_awaited: &'a (dyn Fn() -> bool + Sync),
}

/// What came of it.
#[cfg_attr(not(feature = "fleet"), expect(dead_code, reason = "only a fleet is merged in goes"))]
pub(crate) struct Looked {
    /// What pairs made of each other, now or before, in the order of the inputs.
    pub pair_results: PairResults,
    /// Pairs that were looked at now.
    now: Vec<[usize; 2]>,
    /// Pairs that are still to be looked at.
    pub left: Vec<[usize; 2]>,
    /// Whether one of these may join agents that do not hang together, and was never looked at.
    pub may_join: bool,
    /// Whether now groups were joined, or a merge of before does not stand any more.
    pub has_changed: bool,
    /// Places of the pairs that are left, as far as they were found.
    pub places: BTreeMap<[usize; 2], Places>,
}

#[cfg(feature = "fleet")]
impl Looked {
    /// What the pairs that were looked at now made of each other.
    pub fn now(&self) -> impl Iterator<Item = Cow<'_, PairResult>> {
        self.now.iter().filter_map(|pair| self.pair_results.get(*pair))
    }
}

impl<'a> Batch<'a> {
    /// All pairs of which nothing is known.
    pub fn whole(
        known: &'a (dyn Fn([usize; 2]) -> Result<Option<Known>> + Sync),
        swap: Option<Arc<dyn Swap>>,
        keep: &'a (dyn Fn(&PairResult) -> Result<()> + Sync),
    ) -> Self {
        let (groups, places) = (Groups::new(0), BTreeMap::new());
        Self { known, wanted: None, groups, places, share: None, swap, keep, is_awaited: &|| false }
    }
}

/// Looks for meetings of pairs of inputs. `progress` is told what comes next, and ends it with an error of its own. What goes
/// wrong with one pair of maps is noted there, and the others are looked at.
///
/// # Errors
/// When the inputs cannot be in one map (two are of one run, say), or `progress` will not go on.
pub(crate) fn look<'a>(
    inputs: &'a [Input],
    vocabulary: &Arc<Vocabulary>,
    params: &'a MergingParams,
    go: Batch,
    progress: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Looked> {
    let maps: Vec<&Map> = inputs.iter().map(|input| &*input.map).collect();
    Map::can_unite(&maps).context("the maps cannot be merged")?;
    let names = |[a, b]: [usize; 2]| format!("{} and {}", inputs[a].name, inputs[b].name);
    let Batch { known, wanted, groups, places, share, swap, keep, is_awaited } = go;
    let mut pairs = PairsInWork::new(inputs, params, share.is_some());
    (pairs.groups, pairs.places) = (groups, places);
    pairs.pair_results = swap.map_or_else(PairResults::default, PairResults::resting);
    let mut waiting = pairs.take_known(known, wanted.as_ref())?;
    progress("looking for places that the maps share")?;
    let start = Instant::now();
    if share.is_some() {
        find_places(inputs, vocabulary, params, &waiting, Some(&pairs.groups), &mut pairs.places);
    }
    if wanted.is_none() {
        waiting.iter_mut().for_each(|one| one.similarity = similarity(one.pair, &pairs.places));
    }
    let (mut now, mut left) = (Vec::new(), Vec::new());
    if share.is_some() {
        (waiting, left) = waiting.into_iter().partition(|one| key(one.pair, &pairs.places).is_some());
    } else {
        // Taken from the end.
        waiting.reverse();
    }
    while !waiting.is_empty() {
        if let (None, Some(next)) = (share, waiting.last())
            && key(next.pair, &pairs.places).is_none()
        {
            let next = &waiting[waiting.len().saturating_sub(PAIRS)..];
            find_places(inputs, vocabulary, params, next, None, &mut pairs.places);
        }
        let may_end = |pair| !pairs.groups.are_one(pair) || !pairs.has_changed && !is_awaited();
        let one = match share {
            None => waiting.pop(),
            Some(share) if share.is_used_up(now.len(), start) => None,
            Some(_) => next(&waiting, &pairs.groups)
                .filter(|&index| now.is_empty() || may_end(waiting[index].pair))
                .map(|index| waiting.swap_remove(index)),
        };
        let Some(Waiting { pair, .. }) = one else { break };
        progress(&format!("looking where {} met", names(pair)))?;
        pairs.look_at(pair, keep)?;
        now.push(pair);
    }
    left.extend(waiting);
    let PairsInWork { pair_results, groups, places, has_changed, .. } = pairs;
    let may_join = share.is_some() && left.iter().any(|one| !one.is_again && !groups.are_one(one.pair));
    let left = left.into_iter().map(|one| one.pair).collect();
    Ok(Looked { pair_results, now, left, may_join, has_changed, places })
}

/// Pairs that are being looked at.
struct PairsInWork<'a> {
    inputs: &'a [Input],
    params: &'a MergingParams,
    /// Whether a share of them is looked at, and what else is known joins inputs.
    is_shared: bool,
    prepared: Vec<PreparedMap<'a>>,
    ready: Ready,
    groups: Groups,
    /// By target and source.
    places: BTreeMap<[usize; 2], Places>,
    pair_results: PairResults,
    /// Pairs whose maps may have grown since they were merged.
    may_grow: BTreeSet<[usize; 2]>,
    /// Whether groups were joined, or a merge of before does not stand any more.
    has_changed: bool,
}

impl<'a> PairsInWork<'a> {
    /// Those of inputs of which nothing is known yet.
    fn new(inputs: &'a [Input], params: &'a MergingParams, is_shared: bool) -> Self {
        let prepared = |input: &'a Input| PreparedMap::new(&input.map, &input.features, &params.key_points);
        Self {
            inputs,
            params,
            is_shared,
            prepared: inputs.iter().map(prepared).collect(),
            ready: Ready { most: READY, bytes: BTreeMap::new() },
            groups: Groups::new(0),
            places: BTreeMap::new(),
            pair_results: PairResults::default(),
            may_grow: BTreeSet::new(),
            has_changed: false,
        }
    }

    /// Takes in what is known of pairs; gives those that are to be looked at, of all or of the wanted.
    fn take_known(
        &mut self,
        known: &dyn Fn([usize; 2]) -> Result<Option<Known>>,
        wanted: Option<&BTreeMap<[usize; 2], f32>>,
    ) -> Result<Vec<Waiting>> {
        let mut waiting = Vec::new();
        for pair in pairs(self.inputs.len()) {
            let known = known(pair)?;
            let is_due = known.as_ref().is_none_or(|known| known.is_due);
            let similarity = wanted.map_or(Some(0.0), |wanted| wanted.get(&pair).copied());
            if let Some(similarity) = similarity.filter(|_| is_due) {
                waiting.push(Waiting { pair, similarity, is_again: known.is_some() });
            }
            if let Some(Known { pair_result, may_grow, .. }) = known {
                if pair_result.joined.is_some() && self.is_shared {
                    self.groups.join(pair);
                }
                if may_grow {
                    self.may_grow.insert(pair);
                }
                self.pair_results.insert(pair_result);
            }
        }
        Ok(waiting)
    }

    /// Looks at a pair; what comes of it is given to `keep`.
    fn look_at(&mut self, pair: [usize; 2], keep: &dyn Fn(&PairResult) -> Result<()>) -> Result<()> {
        let Self { inputs, params, is_shared, prepared, groups, places, pair_results, .. } = self;
        let found = key(pair, places).and_then(|key| Some((key, places.remove(&key)?)));
        let (directed, places) = found.unwrap_or((pair, Places::default()));
        let of = |before: &PairResult| [&prepared[before.target], &prepared[before.source]];
        let before = pair_results.get(pair).filter(|_| self.may_grow.contains(&pair));
        let followed = before.and_then(|before| grown(&before, of(&before), params));
        let pair_result = followed.unwrap_or_else(|| {
            let mut pair_result = pair_result(directed, places, inputs, prepared, params);
            let accepted = pair_result.accepted().filter(|_| *is_shared);
            pair_result.seen = accepted.map(|evaluated| Arc::new(Seen::new(of(&pair_result), evaluated)));
            pair_result
        });
        keep(&pair_result)?;
        self.ready.keep(pair, prepared);
        pair.iter().for_each(|&map| inputs[map].rest());
        if *is_shared {
            let is_joined = pair_result.joined.is_some();
            let was_joined = pair_results.get(pair).is_some_and(|before| before.joined.is_some());
            self.has_changed |= was_joined && !is_joined;
            self.has_changed |= is_joined && groups.join(pair);
        }
        pair_results.insert(pair_result);
        Ok(())
    }
}

/// What maps take whose keyframes stay ready, bytes.
struct Ready {
    /// At the most, of all together.
    most: usize,
    bytes: BTreeMap<usize, usize>,
}

impl Ready {
    /// Keeps the keyframes of a pair ready that was looked at, the earlier map first, as far as there is room. The later one meets
    /// others next, and those come in the order in which they came before: what is ready is asked for before what was just used.
    fn keep(&mut self, pair: [usize; 2], prepared: &mut [PreparedMap]) {
        pair.iter().for_each(|&map| _ = self.bytes.insert(map, prepared[map].bytes()));
        for map in pair {
            if self.bytes.values().sum::<usize>() > self.most {
                prepared[map].forget();
                self.bytes.remove(&map);
            }
        }
    }
}

/// By target and source, whichever of two inputs is which, where their places are known.
fn key([a, b]: [usize; 2], places: &BTreeMap<[usize; 2], Places>) -> Option<[usize; 2]> {
    [[a, b], [b, a]].into_iter().find(|key| places.contains_key(key))
}

/// How much two maps look alike by their best place, 0 where they have none.
fn similarity(pair: [usize; 2], places: &BTreeMap<[usize; 2], Places>) -> f32 {
    let places = key(pair, places).and_then(|key| places.get(&key));
    places.and_then(|places| places.proposals.first()).map_or(0.0, |best| best.score)
}

/// Finds the places of pairs that have none yet: of all, or where they are looked at in batches of as many as fit into one, those
/// that would join `groups` before all others.
fn find_places(
    inputs: &[Input],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    waiting: &[Waiting],
    groups: Option<&Groups>,
    shared: &mut BTreeMap<[usize; 2], Places>,
) {
    let joins = |one: &Waiting| groups.is_some_and(|groups| !groups.are_one(one.pair));
    let mut lacking: Vec<&Waiting> = waiting.iter().filter(|one| key(one.pair, shared).is_none()).collect();
    if lacking.iter().any(|one| joins(one)) {
        lacking.retain(|one| joins(one));
    }
    let mut queries = 0;
    let wanted: BTreeSet<[usize; 2]> = lacking
        .into_iter()
        .take_while(|one| {
            let is_in = groups.is_none() || queries < QUERIES;
            queries += one.pair.iter().map(|&input| inputs[input].words.len()).max().unwrap_or(0);
            is_in
        })
        .map(|one| one.pair)
        .collect();
    if !wanted.is_empty() {
        let maps: Vec<_> = inputs.iter().map(|input| Appearances::of(input, &params.places)).collect();
        shared.extend(places(&maps, vocabulary, params, &|pair| wanted.contains(&pair)));
    }
}

/// One pair of inputs.
fn pair_result(
    [target, source]: [usize; 2],
    places: Places,
    inputs: &[Input],
    prepared: &[PreparedMap],
    params: &MergingParams,
) -> PairResult {
    let start = Instant::now();
    let (of_target, of_source) = (&inputs[target], &inputs[source]);
    let proposals = ranked(places.proposals, of_target.directed(), of_source.directed(), &params.rank);
    let (places_s, places): (f64, Vec<Place>) =
        (places.seconds, proposals.iter().map(|p| Place { source: p.query, target: p.keyframe }).collect());
    let ranked = start.elapsed().as_secs_f64();
    let tested = meet(&prepared[source], &prepared[target], &places, &params.verification, &params.further);
    let met = start.elapsed().as_secs_f64();
    let accepted = tested.iter().find_map(|tested| tested.outcome.accepted());
    let joined = accepted.map(|evaluated| joined([&prepared[target], &prepared[source]], evaluated, params));
    let (joined, error) = match joined {
        None => (None, None),
        Some(Ok(joined)) => (joined, None),
        Some(Err(error)) => (None, Some(format!("{error:#}"))),
    };
    let seconds = Seconds {
        places: places_s + ranked,
        verification: met - ranked,
        method: start.elapsed().as_secs_f64() - met,
    };
    PairResult {
        target,
        source,
        proposed: places.len(),
        tested: tested.into(),
        joined: joined.map(Arc::new),
        error,
        seconds,
        seen: None,
    }
}

/// What joins two maps at an accepted closure, by the method asked for.
fn joined(
    [target, source]: [&PreparedMap; 2],
    evaluated: &EvaluatedClosure,
    params: &MergingParams,
) -> Result<Option<Joined>> {
    let Some(baseline) = params.method.baseline() else { return Ok(evaluated.joined.clone()) };
    let placement = baseline.place(source, target, &evaluated.closure, &params.baseline);
    let context = || format!("they met, but the method {} does not join them", params.method);
    Ok(Some(placement.with_context(context)?.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use features::{Features, Keypoint, codec};
    use geometry::{GrayImage, Pinhole, Sim3};
    use map::{Keyframe, KeyframeId, SemiDense};
    use merge::key_points::KeyPointParams;
    use place_recog::KeyframeFeatures;

    #[test]
    fn keyframes_stay_ready_within_bounds_and_those_of_a_pair_go_first() {
        let camera = Pinhole { width: 40, height: 30, fx: 30.0, fy: 30.0, cx: 19.5, cy: 14.5 };
        let mut map = Map::new(camera);
        let image = Arc::new(GrayImage::filled(40, 30, 0));
        let mut keyframe = Keyframe::of_image(KeyframeId(0), 0.0, 0, Sim3::identity(), image);
        let (pixel, inverse_depth, variance) = (vec![7].into(), vec![0.5].into(), vec![0.1].into());
        keyframe.semi_dense = SemiDense { pixel, inverse_depth, variance }.into();
        map.keyframes.insert(keyframe.id, keyframe);
        let keypoint = Keypoint { pixel: [3.0; 2], size: 4.0, angle: 0.0 };
        let found = Features { keypoints: vec![keypoint; 10], descriptors: vec![[9; 128]; 10] };
        let of_map = || {
            let mut features = KeyframeFeatures::default();
            features.insert_stored(KeyframeId(0), codec::encode(&found).into());
            features
        };
        let (features, params) = ([of_map(), of_map(), of_map()], KeyPointParams::default());
        let mut prepared: Vec<PreparedMap> =
            features.iter().map(|features| PreparedMap::new(&map, features, &params)).collect();
        let mut ready = Ready { most: 4000, bytes: BTreeMap::new() };
        let mut held = |pair: [usize; 2]| {
            for map in pair {
                let keyframe = prepared[map].get(KeyframeId(0)).unwrap();
                assert_eq!((keyframe.features.len(), keyframe.bearings().len()), (10, 10));
            }
            ready.keep(pair, &mut prepared);
            [0, 1, 2].map(|map| prepared[map].bytes())
        };
        // 10 × (144 bytes of the feature, 24 of its direction) each.
        assert_eq!(held([0, 1]), [1680, 1680, 0]);
        assert_eq!(held([0, 2]), [0, 1680, 1680]);
        assert_eq!(held([1, 2]), [0, 1680, 1680]);
        assert_eq!(held([0, 1]), [0, 1680, 1680]);
    }
}
