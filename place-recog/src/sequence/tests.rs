use super::*;

fn candidates(list: &[(u32, f32)]) -> Vec<PlaceCandidate> {
    list.iter().map(|&(id, score)| PlaceCandidate { keyframe: KeyframeId(id), score }).collect()
}

/// Ids with gaps, as keyframes that were removed leave them.
fn keyframes() -> Vec<KeyframeId> {
    (0..100).map(|i| KeyframeId(3 * i)).collect()
}

fn first(found: &[Vec<PlaceCandidate>]) -> Vec<u32> {
    found.iter().map(|query| query[0].keyframe.0).collect()
}

#[test]
fn a_chance_similarity_loses_to_a_place_that_is_passed() {
    // The third query looks most like keyframe 240, which nothing around it supports.
    let forward = [
        candidates(&[(30, 0.30)]),
        candidates(&[(33, 0.31), (200, 0.2)]),
        candidates(&[(240, 0.40), (36, 0.29)]),
        candidates(&[(39, 0.30), (150, 0.1)]),
        candidates(&[(45, 0.30)]),
    ];
    let found = supported(&forward, &keyframes(), &SequenceParams::default());
    assert_eq!(first(&found), [30, 33, 36, 39, 45]);
    assert!(found[2][0].score > 0.29 && found[2][1].score < 0.1, "{:?}", found[2]);
}

#[test]
fn the_direction_does_not_matter() {
    let forward: Vec<_> = (0..7).map(|i| candidates(&[(30 + 3 * i, 0.3), (210, 0.31)])).collect();
    let backward: Vec<_> = (0..7).map(|i| candidates(&[(60 - 3 * i, 0.3), (150, 0.1)])).collect();
    let scores = |queries: &[Vec<PlaceCandidate>], wanted: &dyn Fn(u32) -> u32| -> Vec<f32> {
        let found = supported(queries, &keyframes(), &SequenceParams::default());
        let of = |(i, q): (usize, &Vec<PlaceCandidate>)| {
            q.iter().find(|c| c.keyframe.0 == wanted(i as u32)).unwrap().score
        };
        found.iter().enumerate().map(of).collect()
    };
    assert_eq!(scores(&forward, &|i| 30 + 3 * i), scores(&backward, &|i| 60 - 3 * i));
}

#[test]
fn without_reach_scores_stay() {
    let queries = [candidates(&[(3, 0.5), (6, 0.4)]), candidates(&[(9, 0.2)]), vec![]];
    let params = SequenceParams { reach: 0, pace: 1 };
    assert_eq!(supported(&queries, &keyframes(), &params), queries);
}

#[test]
fn support_does_not_come_from_beyond_the_pace() {
    let queries = [candidates(&[(0, 0.6)]), candidates(&[(9, 0.6)])];
    let score = |pace| supported(&queries, &keyframes(), &SequenceParams { reach: 1, pace })[1][0].score;
    assert_eq!(score(2), 0.3);
    assert_eq!(score(3), 0.6);
}
