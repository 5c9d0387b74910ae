use super::*;
use proptest::prelude::*;

fn bag(words: &[u32]) -> WordBag {
    WordBag::new(words.iter().map(|&w| WordId(w)))
}

/// An index that scores so many keyframes in full.
fn index(scored: usize) -> BowIndex {
    BowIndex::new(Vocabulary::shipped(), BowParams { scored, ..BowParams::default() })
}

fn ids(found: &[PlaceCandidate]) -> Vec<u32> {
    found.iter().map(|c| c.keyframe.0).collect()
}

fn stored(slot: &Slot) -> WordBag {
    WordBag::new(slot.words.iter().flat_map(|(word, count)| std::iter::repeat_n(word, count as usize)))
}

/// Scores by the definition, one keyframe at a time.
fn brute_force(index: &BowIndex, query: &WordBag, count: usize) -> Vec<(u32, f32)> {
    let query = index.weighted(query);
    let mut all: Vec<(u32, f32)> = index
        .slots
        .iter()
        .map(|slot| {
            let (id, words) = (slot.keyframe, &index.weighted(&stored(slot)));
            let weight = |list: &WeightedWords, word| list.iter().find(|w| w.0 == word).map_or(0.0, |w| w.1);
            let distance: f32 =
                (0..2200).map(|w| (weight(&query, WordId(w)) - weight(words, WordId(w))).abs()).sum();
            (id.0, 1.0 - 0.5 * distance)
        })
        .filter(|&(_, score)| score >= index.params.min_score)
        .collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    all.truncate(count);
    all
}

#[test]
fn weights_are_counts_times_rarity_and_sum_to_one() {
    let index = index(1000);
    let vocabulary = Vocabulary::shipped();
    let weighted = index.weighted(&bag(&[5, 9, 5, 5]));
    let (a, b) = (3.0 * vocabulary.weight(WordId(5)), vocabulary.weight(WordId(9)));
    assert_eq!(weighted.len(), 2);
    assert!((weighted[0].1 - a / (a + b)).abs() < 1e-6 && (weighted[1].1 - b / (a + b)).abs() < 1e-6);
}

#[test]
fn the_same_words_score_one_and_none_are_not_found() {
    let mut index = index(1000);
    index.add(KeyframeId(3), &bag(&[1, 2, 3]));
    index.add(KeyframeId(4), &bag(&[3, 4, 5, 6, 7]));
    index.add(KeyframeId(9), &bag(&[100, 200]));
    index.add(KeyframeId(10), &bag(&[]));
    let found = index.query(&bag(&[1, 2, 3]), 9);
    assert_eq!(ids(&found), [3, 4]);
    assert!((found[0].score - 1.0).abs() < 1e-6 && found[1].score < 0.4);
    assert!(index.query(&bag(&[]), 9).is_empty());
    assert!(index.query(&bag(&[1, 2, 3]), 0).is_empty());
}

#[test]
fn a_keyframe_added_again_has_its_new_words_only() {
    let mut index = index(1000);
    index.add(KeyframeId(3), &bag(&[1, 2, 3]));
    index.add(KeyframeId(3), &bag(&[7, 8]));
    assert_eq!(index.len(), 1);
    assert!(index.query(&bag(&[1, 2, 3]), 5).is_empty());
    assert_eq!(ids(&index.query(&bag(&[7, 8]), 5)), [3]);
    PlaceIndex::<WordBag>::clear(&mut index);
    assert!(index.is_empty() && index.query(&bag(&[7, 8]), 5).is_empty());
}

#[test]
fn own_recent_keyframes_are_left_out() {
    let mut index = index(1000);
    for id in 0..10 {
        index.add(KeyframeId(id), &bag(&[1, 2, 3, 50 + id]));
    }
    let older = index.query_among(&bag(&[1, 2, 3, 59]), 3, &|id| id.0 < 6);
    assert_eq!(older.len(), 3);
    assert!(older.iter().all(|c| c.keyframe.0 < 6));
}

#[test]
fn each_map_in_one_index_has_its_own_best() {
    // Three maps of 200 keyframes; of the query's words the first has most and the last fewest.
    let mut index = index(64);
    let place =
        |id: u32| (0..60).map(move |i| 100 + (id.wrapping_mul(2_654_435_761) ^ (i * 40_503)) % 20_000);
    let shared = |map: u32| (0..30 - 10 * map).map(|i| 21_000 + i);
    for id in 0..600 {
        let words: Vec<u32> =
            if id % 200 == 77 { place(id).chain(shared(id / 200)).collect() } else { place(id).collect() };
        index.add(KeyframeId(id), &bag(&words));
    }
    let query = bag(&(21_000..21_060).collect::<Vec<_>>());
    let of_map = |id: KeyframeId| (id.0 >= 200).then(|| id.0 as usize / 200 - 1);
    assert_eq!(ids(&index.query_each(&query, 1, 2, &of_map)), [277, 477]);
    assert_eq!(ids(&index.query(&query, 3)), [77, 277, 477]);
    let mut fab_map = crate::FabMap::new(Vocabulary::shipped(), crate::FabMapParams::default());
    for id in [77, 277, 278, 477] {
        PlaceIndex::<WordBag>::add(
            &mut fab_map,
            KeyframeId(id),
            &bag(&shared(id / 200).chain(1..100).collect::<Vec<_>>()),
        );
    }
    let found = PlaceIndex::<WordBag>::query_each(&fab_map, &query, 1, 2, &of_map);
    assert_eq!(found.len(), 2, "one of each: {found:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_query_gives_what_comparing_with_every_keyframe_gives(
        bags in prop::collection::vec(prop::collection::vec(0u32..300, 1..40), 1..40),
        query in prop::collection::vec(0u32..300, 1..40),
    ) {
        let mut index = index(1_000_000);
        for (id, words) in bags.iter().enumerate() {
            index.add(KeyframeId(id as u32), &bag(words));
        }
        let found = index.query(&bag(&query), 100);
        let expected = brute_force(&index, &bag(&query), 100);
        prop_assert_eq!(found.len(), expected.len());
        for (candidate, (id, score)) in found.iter().zip(&expected) {
            prop_assert!((candidate.score - score).abs() < 1e-4);
            // Scores that differ by rounding only may change places.
            let at = expected.iter().find(|e| e.0 == candidate.keyframe.0);
            prop_assert!(*id == candidate.keyframe.0 || at.is_some_and(|e| (e.1 - score).abs() < 1e-4));
        }
    }

    #[test]
    fn a_place_is_found_even_when_only_few_are_scored(seed in 0u32..1000) {
        let mut index = index(4);
        let word = |place: u32, i: u32| (place.wrapping_mul(2_654_435_761) ^ i.wrapping_mul(40_503)).wrapping_mul(97) >> 7;
        let place = |p: u32| -> Vec<u32> {
            (0..60).map(|i| if i < 20 { i } else { 100 + word(p, i) % 2000 }).collect()
        };
        for p in 0..200 {
            index.add(KeyframeId(p), &bag(&place(p)));
        }
        let asked = seed % 200;
        let found = index.query(&bag(&place(asked)[10..50]), 1);
        prop_assert_eq!(ids(&found), vec![asked]);
        // Scored in full, also by the words whose lists were not read.
        let exact = brute_force(&index, &bag(&place(asked)[10..50]), 1);
        prop_assert!((found[0].score - exact[0].1).abs() < 1e-4);
    }
}
