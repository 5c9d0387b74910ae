//! Maps merged with default parameters, step after step, as a program does it.

use crate::yard::{first, opposite, second};
use map::{KeyframeId, Map};
use merge::closure::Closure;
use merge::common_map::{Address, Addresses, CommonMap, Fused, FusionParams, Link};
use merge::estimate::Estimate;
use merge::further::{FurtherParams, Joined};
use merge::key_points::KeyPointParams;
use merge::prepared::PreparedMap;
use merge::verification::{Outcome, Place, TestedPlace, VerificationParams, meet};
use place_recog::features::{SiftParams, sift};
use place_recog::{
    DirectIndex, Directed, FeatureWords, KeyframeFeatures, ProposeParams, RankParams, Vocabulary, WordBag,
    propose, ranked,
};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// The features of all keyframes of a map.
pub fn features(map: &Map) -> KeyframeFeatures {
    let find = |(id, keyframe): (&KeyframeId, &map::Keyframe)| {
        (*id, sift(&keyframe.image, &SiftParams { halvings: 0, ..SiftParams::default() }).expect("an image"))
    };
    map.keyframes.iter().map(find).collect()
}

/// What two maps made of each other.
pub struct PairResult {
    pub tested: Vec<TestedPlace>,
    pub joined: Option<Joined>,
}

impl PairResult {
    /// The accepted closure.
    pub fn closure(&self) -> Option<&Closure> {
        self.tested.iter().find_map(|tested| Some(&tested.outcome.accepted()?.closure))
    }
}

/// Looks where the source met the target, at places that place recognition proposes.
pub fn pair_result(target: &Map, source: &Map) -> PairResult {
    pair_result_after(target, source, 0.0)
}

/// The same of maps that so many days lie between.
pub fn pair_result_after(target: &Map, source: &Map, days: f64) -> PairResult {
    let (of_target, of_source) = (features(target), features(source));
    let vocabulary = Vocabulary::shipped();
    let words_of =
        |features: &KeyframeFeatures, id| FeatureWords::of(&features.get(id).expect("its own"), &vocabulary);
    let words = |features: &KeyframeFeatures| -> BTreeMap<KeyframeId, WordBag> {
        features.keyframes().map(|id| (id, words_of(features, id).bag())).collect()
    };
    let index = |features: &KeyframeFeatures| -> BTreeMap<KeyframeId, DirectIndex> {
        features.keyframes().map(|id| (id, DirectIndex::new(&words_of(features, id), &vocabulary))).collect()
    };
    let proposals = propose(&words(&of_target), &words(&of_source), &vocabulary, &ProposeParams::default());
    let proposals = ranked(
        proposals,
        Directed { features: &of_target, index: &index(&of_target) },
        Directed { features: &of_source, index: &index(&of_source) },
        &RankParams::default(),
    );
    let places: Vec<Place> =
        proposals.iter().map(|p| Place { source: p.query, target: p.keyframe }).collect();
    look_at([target, source], [&of_target, &of_source], &places, days)
}

/// Looks at every pair of keyframes, whatever place recognition would say.
pub fn pair_result_everywhere(target: &Map, source: &Map) -> PairResult {
    let ids = |map: &Map| map.keyframes.keys().copied().collect::<Vec<_>>();
    let (targets, sources) = (ids(target), ids(source));
    let pair = |&source: &KeyframeId| targets.iter().map(move |&target| Place { source, target });
    let places: Vec<Place> = sources.iter().flat_map(pair).collect();
    look_at([target, source], [&features(target), &features(source)], &places, 0.0)
}

fn look_at(
    [target, source]: [&Map; 2],
    [of_target, of_source]: [&KeyframeFeatures; 2],
    places: &[Place],
    days: f64,
) -> PairResult {
    let key_points = KeyPointParams::default();
    let source = PreparedMap::new(source, of_source, &key_points);
    let target = PreparedMap::new(target, of_target, &key_points);
    let params = VerificationParams { rounds: places.len().max(1), ..VerificationParams::default() };
    let mut further = FurtherParams::default();
    further.place.prior.days_apart = days;
    let tested = meet(&source, &target, places, &params, &further);
    let joined = tested.iter().find_map(|tested| tested.outcome.accepted()?.joined.clone());
    PairResult { tested, joined }
}

/// Adds the closures of an encounter of two maps of one agent each; returns how many.
pub fn link(common: &mut CommonMap, [target, source]: [&Addresses; 2], pair_result: &PairResult) -> usize {
    let edges = pair_result.joined.iter().flat_map(|joined| &joined.edges);
    let links = edges.map(|edge| {
        let address =
            |of: &Addresses, keyframe| Address { agent: of.agents().next().expect("an agent"), keyframe };
        Link {
            from: address(target, edge.from),
            to: address(source, edge.to),
            from_from_to: Estimate { a_from_b: edge.from_from_to, information: edge.information },
        }
    });
    links.filter(|&new| common.link(new)).count()
}

/// The maps' common map after those of `met` did, `[target, source]`; fails where two did not.
pub fn merged(maps: &[&Map], met: &[([usize; 2], &PairResult)]) -> (CommonMap, Vec<Addresses>) {
    let (mut common, addresses) = CommonMap::from_maps(maps).expect("the maps go together");
    for ([target, source], pair_result) in met {
        let count = link(&mut common, [&addresses[*target], &addresses[*source]], pair_result);
        assert!(count >= 2, "{target} and {source} did not meet: {:?}", reasons(pair_result));
    }
    (common, addresses)
}

/// The first drive, and the second one looked for in it, on the way.
pub fn halfway() -> &'static PairResult {
    static MET: LazyLock<PairResult> = LazyLock::new(|| pair_result(&first().early, &second().early));
    &MET
}

/// The same at the end.
pub fn first_and_second() -> &'static PairResult {
    static MET: LazyLock<PairResult> = LazyLock::new(|| pair_result(&first().end, &second().end));
    &MET
}

/// The second drive, and the first one looked for in it.
pub fn second_and_first() -> &'static PairResult {
    static MET: LazyLock<PairResult> = LazyLock::new(|| pair_result(&second().end, &first().end));
    &MET
}

/// The first drive, and the opposite one looked for in it.
pub fn first_and_opposite() -> &'static PairResult {
    static MET: LazyLock<PairResult> = LazyLock::new(|| pair_result(&first().end, &opposite().end));
    &MET
}

/// Why no place was accepted.
pub fn reasons(pair_result: &PairResult) -> Vec<String> {
    let reason = |tested: &TestedPlace| match &tested.outcome {
        Outcome::NotMatched(refusal) => refusal.to_string(),
        Outcome::NotFollowed => "not followed".into(),
        Outcome::NotClosed(refusal) => refusal.to_string(),
        Outcome::Broken(error) => error.to_string(),
        Outcome::Evaluated(evaluated) => evaluated
            .verdict
            .doubt()
            .map_or("accepted".into(), |doubt| format!("{doubt}: {:?}", evaluated.verdict)),
    };
    pair_result.tested.iter().map(|tested| format!("γ {}: {}", tested.match_count, reason(tested))).collect()
}

/// The one map that all agents hang together in.
pub fn fused(common: &CommonMap) -> Fused {
    let mut all = common.fuse(&FusionParams::default()).expect("the closures make a map");
    assert_eq!(all.len(), 1, "all agents hang together");
    all.remove(0)
}
