use super::*;
use crate::bow::BowIndex;

/// 900 words that depend on the place, fewer where looks miss some: about as many as an image has.
fn place(p: u32, looked: u32) -> WordBag {
    let hash = |a: u32, b: u32| {
        (a.wrapping_mul(0x9e37_79b1) ^ b.wrapping_mul(0x85eb_ca6b)).wrapping_mul(0xc2b2_ae35) >> 8
    };
    let words = Vocabulary::shipped().len() as u32;
    // Each look misses a word in three and adds some of its own.
    let kept = (0..900).filter(|&i| hash(looked + 1, i) % 3 != 0).map(|i| hash(p, i) % words);
    let own = (0..300).map(|i| hash(looked + 7777, i) % words);
    WordBag::new(kept.chain(own).map(WordId))
}

fn filled(places: u32, shortlist: usize) -> FabMap {
    let mut index = FabMap::new(Vocabulary::shipped(), FabMapParams { shortlist, ..FabMapParams::default() });
    (0..places).for_each(|p| index.add(KeyframeId(p), &place(p, 0)));
    index
}

fn sum(location: &Location) -> f64 {
    location.new_place + location.elsewhere + location.places.iter().map(|p| p.1).sum::<f64>()
}

#[test]
fn probabilities_sum_to_one() {
    for (places, shortlist) in [(0, 10), (1, 10), (30, 100), (200, 10)] {
        for query in [3, 5000] {
            let location = filled(places, shortlist).locate(&place(query, 1), &|_| true);
            assert!((sum(&location) - 1.0).abs() < 1e-9, "{places}: {location:?}");
            assert!(location.places.iter().all(|p| (0.0..=1.0).contains(&p.1)));
        }
    }
}

#[test]
fn a_revisited_place_is_probable_and_a_new_one_is_new() {
    let index = filled(50, 100);
    let again = index.locate(&place(17, 1), &|_| true);
    assert_eq!(again.places[0].0, KeyframeId(17));
    assert!(again.places[0].1 > 0.9 && again.new_place < 0.1, "{again:?}");
    let new = index.locate(&place(5000, 1), &|_| true);
    assert!(new.new_place > 0.8, "{new:?}");
    assert!(again.places[0].1 > 10.0 * new.places[0].1);
}

#[test]
fn an_empty_map_has_only_new_places() {
    let location = filled(0, 5).locate(&place(1, 1), &|_| true);
    assert_eq!(location, Location { new_place: 1.0, elsewhere: 0.0, places: Vec::new() });
}

#[test]
fn places_left_out_have_no_probability() {
    let location = filled(50, 100).locate(&place(17, 1), &|id| id.0 != 17);
    assert!(location.places.iter().all(|p| p.0 != KeyframeId(17)));
    assert!(location.new_place > 0.8 && (sum(&location) - 1.0).abs() < 1e-9);
}

#[test]
fn it_is_an_index_like_the_others() {
    let bags: Vec<WordBag> = (0..20).map(|p| place(p, 0)).collect();
    let mut indexes: Vec<Box<dyn PlaceIndex<WordBag>>> = vec![
        Box::new(FabMap::new(Vocabulary::shipped(), FabMapParams::default())),
        Box::new(BowIndex::new(Vocabulary::shipped(), BowParams::default())),
    ];
    for index in &mut indexes {
        bags.iter().zip(0..).for_each(|(bag, id)| index.add(KeyframeId(id), bag));
        assert_eq!(index.query(&place(7, 1), 1)[0].keyframe, KeyframeId(7));
        index.clear();
        assert!(index.query(&place(7, 1), 1).is_empty());
    }
}

#[test]
fn the_sparse_sum_is_the_product_over_all_words() {
    let vocabulary = Vocabulary::shipped();
    let params = FabMapParams::default();
    let model = Model::new(&vocabulary, &params);
    let words = |bag: &WordBag| -> Vec<WordId> { bag.counts().iter().map(|c| c.0).collect() };
    let (visible, seen) = (words(&place(1, 0)), words(&place(1, 1)));
    // By the definition: every word, with p(e | place) from one look, against p(e) for an average place.
    let (d, f) = (params.detection, params.false_detection);
    let richness = visible.len() as f64
        / (0..vocabulary.len() as u32).map(|w| vocabulary.probability(WordId(w))).sum::<f64>();
    let mut expected = 0.0;
    for word in (0..vocabulary.len() as u32).map(WordId) {
        let m = vocabulary.probability(word);
        let parent_seen = vocabulary.parent(word).is_some_and(|p| seen.contains(&p));
        let c = vocabulary.probability_given_parent(word, parent_seen);
        let z = seen.contains(&word);
        let likelihood = |exists: f64| {
            let given = |detected: f64| {
                let odds = detected * (1.0 - m) * c / ((1.0 - detected) * m * (1.0 - c));
                let p = odds / (1.0 + odds);
                if z { p } else { 1.0 - p }
            };
            exists * given(d) + (1.0 - exists) * given(f)
        };
        let exists = match visible.contains(&word) {
            true => d * m / (d * m + f * (1.0 - m)),
            false => (1.0 - d) * m / ((1.0 - d) * m + (1.0 - f) * (1.0 - m)),
        };
        let (s, h) =
            (d * m / (d * m + f * (1.0 - m)), (1.0 - d) * m / ((1.0 - d) * m + (1.0 - f) * (1.0 - m)));
        expected += likelihood(exists).ln() - likelihood(richness * m * s + (1.0 - richness * m) * h).ln();
    }
    let found = Observed::new(&model, &seen).log_ratio(&model, &visible);
    // The average place is interpolated.
    assert!((found - expected).abs() < 0.02 * expected.abs(), "{found} {expected}");
}
