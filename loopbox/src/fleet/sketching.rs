//! Which keyframes are worth fetching first: by the features of all of them, which come before images and depths, the
//! places that two agents most likely share.

use features::{Features, codec};
use fleet::manifest::Kind;
use fleet::node::Heard;
use fleet::store::Store;
use map::{Identity, KeyframeId};
use place_recog::{
    DirectIndex, Directed, Proposal, ProposeParams, RankParams, Vocabulary, WordBag, propose, ranked, words,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes before and after a place that are fetched with it: a closure rests on three adjacent pairs.
const AROUND: usize = 1;

/// What is known of an agent's keyframes by their features alone.
#[derive(Default)]
pub(super) struct Sketch {
    features: BTreeMap<KeyframeId, Features>,
    words: BTreeMap<KeyframeId, WordBag>,
    index: BTreeMap<KeyframeId, DirectIndex>,
    /// Keyframes of the map whose features are not here.
    missing: usize,
}

impl Sketch {
    /// Takes in features that came since. Those of a keyframe are found once for good.
    pub fn take(&mut self, heard: &Heard, store: &dyn Store, vocabulary: &Vocabulary) {
        let described = heard.entries.iter().filter(|entry| entry.kind == Kind::Features);
        let (mut new, mut missing) = (BTreeMap::new(), 0);
        for entry in described {
            let id = KeyframeId(entry.number);
            if self.words.contains_key(&id) {
                continue;
            }
            match store.has(&entry.hash).then(|| store.get(&entry.hash)).flatten() {
                // What cannot be read is found again from the image.
                Some(bytes) => drop(codec::decode(&bytes).map(|features| new.insert(id, features))),
                None => missing += 1,
            }
        }
        let (words, index) = words(&new, vocabulary);
        self.words.extend(words);
        self.index.extend(index);
        self.features.extend(new);
        self.missing = missing;
    }

    fn directed(&self) -> Directed<'_> {
        Directed { features: &self.features, index: &self.index }
    }

    /// The keyframe and those around it.
    fn around(&self, id: KeyframeId) -> impl Iterator<Item = KeyframeId> + '_ {
        let before = self.words.range(..=id).rev().take(AROUND + 1);
        before.chain(self.words.range(id..).take(AROUND + 1)).map(|(id, _)| *id)
    }
}

/// The keyframes of each agent in the order in which they are worth fetching: those of the likeliest places of all pairs,
/// then of the next likely ones, which are also those that tell most about whether a motion is right. Agents of whom
/// features are still to come are left out: the likeliest places may be among these.
pub(super) fn likely(
    sketches: &BTreeMap<Identity, Sketch>,
    vocabulary: &Arc<Vocabulary>,
) -> BTreeMap<Identity, Vec<KeyframeId>> {
    let mut places: Vec<(usize, [(Identity, KeyframeId); 2])> = Vec::new();
    let known: Vec<(&Identity, &Sketch)> =
        sketches.iter().filter(|(_, sketch)| sketch.missing == 0 && !sketch.words.is_empty()).collect();
    for (number, (one, of_one)) in known.iter().enumerate() {
        for (other, of_other) in &known[..number] {
            let proposals = propose(&of_one.words, &of_other.words, vocabulary, &ProposeParams::default());
            let proposals = ranked(proposals, of_one.directed(), of_other.directed(), &RankParams::default());
            let pair = |place: &Proposal| [(**one, place.keyframe), (**other, place.query)];
            places.extend(proposals.iter().map(pair).enumerate());
        }
    }
    // Stable: of pairs of agents the first place of each, then the second.
    places.sort_by_key(|(place, _)| *place);
    let mut wanted: BTreeMap<Identity, Vec<KeyframeId>> = BTreeMap::new();
    for (agent, keyframe) in places.into_iter().flat_map(|(_, pair)| pair) {
        let of_agent = wanted.entry(agent).or_default();
        for near in sketches[&agent].around(keyframe) {
            if !of_agent.contains(&near) {
                of_agent.push(near);
            }
        }
    }
    wanted
}
