//! Maps merged with default parameters, step after step, as a program does it.

use crate::yard::{first, opposite, second};
use map::{KeyframeId, Map};
use merge::closure::Closure;
use merge::common_map::{Address, Addresses, CommonMap, Fused, FusionParams, Link};
use merge::estimate::Estimate;
use merge::further::{FurtherParams, Joined};
use merge::key_points::KeyPointParams;
use merge::meeting::{MeetingParams, Outcome, Place, Tried, meet};
use merge::prepared::PreparedMap;
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
pub struct Encounter {
    pub tried: Vec<Tried>,
    pub joined: Option<Joined>,
}

impl Encounter {
    /// The accepted closure.
    pub fn closure(&self) -> Option<&Closure> {
        self.tried.iter().find_map(|tried| Some(&tried.outcome.accepted()?.closure))
    }
}

/// Looks where the source met the target, at places that place recognition proposes.
pub fn encounter(target: &Map, source: &Map) -> Encounter {
    encounter_apart(target, source, 0.0)
}

/// The same of maps that so many days lie between.
pub fn encounter_apart(target: &Map, source: &Map, days: f64) -> Encounter {
    let (of_target, of_source) = (features(target), features(source));
    let vocabulary = Vocabulary::shipped();
    let words_of =
        |features: &KeyframeFeatures, id| FeatureWords::of(features.get(id).expect("its own"), &vocabulary);
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
pub fn encounter_everywhere(target: &Map, source: &Map) -> Encounter {
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
) -> Encounter {
    let key_points = KeyPointParams::default();
    let source = PreparedMap::new(source, of_source, &key_points);
    let target = PreparedMap::new(target, of_target, &key_points);
    let params = MeetingParams { rounds: places.len().max(1), ..MeetingParams::default() };
    let mut further = FurtherParams::default();
    further.place.prior.days_apart = days;
    let tried = meet(&source, &target, places, &params, &further);
    let joined = tried.iter().find_map(|tried| tried.outcome.accepted()?.joined.clone());
    Encounter { tried, joined }
}

/// Adds the closures of an encounter of two maps of one agent each; returns how many.
pub fn link(common: &mut CommonMap, [target, source]: [&Addresses; 2], encounter: &Encounter) -> usize {
    let edges = encounter.joined.iter().flat_map(|joined| &joined.edges);
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
pub fn merged(maps: &[&Map], met: &[([usize; 2], &Encounter)]) -> (CommonMap, Vec<Addresses>) {
    let (mut common, addresses) = CommonMap::from_maps(maps).expect("the maps go together");
    for ([target, source], encounter) in met {
        let count = link(&mut common, [&addresses[*target], &addresses[*source]], encounter);
        assert!(count >= 2, "{target} and {source} did not meet: {:?}", reasons(encounter));
    }
    (common, addresses)
}

/// The first drive, and the second one looked for in it, on the way.
pub fn on_the_way() -> &'static Encounter {
    static MET: LazyLock<Encounter> = LazyLock::new(|| encounter(&first().early, &second().early));
    &MET
}

/// The same at the end.
pub fn first_and_second() -> &'static Encounter {
    static MET: LazyLock<Encounter> = LazyLock::new(|| encounter(&first().end, &second().end));
    &MET
}

/// The second drive, and the first one looked for in it.
pub fn second_and_first() -> &'static Encounter {
    static MET: LazyLock<Encounter> = LazyLock::new(|| encounter(&second().end, &first().end));
    &MET
}

/// The first drive, and the opposite one looked for in it.
pub fn first_and_opposite() -> &'static Encounter {
    static MET: LazyLock<Encounter> = LazyLock::new(|| encounter(&first().end, &opposite().end));
    &MET
}

/// Why no place was accepted.
pub fn reasons(encounter: &Encounter) -> Vec<String> {
    let reason = |tried: &Tried| match &tried.outcome {
        Outcome::NotMatched(refusal) => refusal.to_string(),
        Outcome::NotFollowed => "not followed".into(),
        Outcome::NotClosed(refusal) => refusal.to_string(),
        Outcome::Broken(error) => error.to_string(),
        Outcome::Judged(judged) => {
            judged.verdict.doubt().map_or("accepted".into(), |doubt| format!("{doubt}: {:?}", judged.verdict))
        }
    };
    encounter.tried.iter().map(|tried| format!("γ {}: {}", tried.match_count, reason(tried))).collect()
}

/// The one map that all agents hang together in.
pub fn fused(common: &CommonMap) -> Fused {
    let mut all = common.fuse(&FusionParams::default()).expect("the closures make a map");
    assert_eq!(all.len(), 1, "all agents hang together");
    all.remove(0)
}
