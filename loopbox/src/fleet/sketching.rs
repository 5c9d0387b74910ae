//! Which keyframes are worth fetching first: by the features of all of them, which come before images and depths, the
//! places that two agents most likely share.

use features::{Features, codec};
use fleet::manifest::Kind;
use fleet::node::Heard;
use fleet::store::Store;
use map::{Identity, KeyframeId};
use place_recog::{
    DirectIndex, Directed, ProposeParams, RankParams, Vocabulary, WordBag, propose, ranked, words,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Places of a pair of agents that are fetched first: the first is the right one in most meetings, and a meeting that
/// follows a wrong one goes on with the next.
const PLACES: usize = 2;
/// Keyframes before and after a place that are fetched with it: a closure rests on three adjacent pairs.
const AROUND: usize = 2;

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

/// The keyframes of each agent that are worth fetching first. Agents of whom features are still to come are left out:
/// the likeliest places may be among these.
pub(super) fn likely(
    sketches: &BTreeMap<Identity, Sketch>,
    vocabulary: &Arc<Vocabulary>,
) -> BTreeMap<Identity, BTreeSet<KeyframeId>> {
    let mut wanted: BTreeMap<Identity, BTreeSet<KeyframeId>> = BTreeMap::new();
    let known: Vec<(&Identity, &Sketch)> =
        sketches.iter().filter(|(_, sketch)| sketch.missing == 0 && !sketch.words.is_empty()).collect();
    for (number, (one, of_one)) in known.iter().enumerate() {
        for (other, of_other) in &known[..number] {
            let proposals = propose(&of_one.words, &of_other.words, vocabulary, &ProposeParams::default());
            let proposals = ranked(proposals, of_one.directed(), of_other.directed(), &RankParams::default());
            for place in proposals.iter().take(PLACES) {
                wanted.entry(**one).or_default().extend(of_one.around(place.keyframe));
                wanted.entry(**other).or_default().extend(of_other.around(place.query));
            }
        }
    }
    wanted
}
